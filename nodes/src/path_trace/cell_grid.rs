//! The cells that the sky is cut into for sampling, and what each brings to some normals.

use glam::Vec3;

use super::light_distribution::{Cone, sine};

/// A part of the sky.
#[derive(Debug, Clone, Copy)]
pub struct LightCell {
    /// Its directions; with a cosine below 0 nothing is known of them.
    pub cone: Cone,
    /// Solid angle.
    pub area: f64,
    /// Luminance times solid angle.
    pub power: f64,
    /// Mean direction of its light, shorter than 1.
    pub towards: Vec3,
}

/// The cells of the sky, row by row. Numbers of one kind stand side by side, so that those of several cells are taken at
/// once.
#[derive(Debug, Clone, Default)]
pub struct CellGrid {
    /// Cells of a row.
    pub columns: usize,
    /// Solid angles.
    areas: Vec<f64>,
    /// Luminance times solid angle.
    powers: Vec<f64>,
    axes: [Vec<f32>; 3],
    cosines: Vec<f32>,
    sines: Vec<f32>,
    towards: [Vec<f32>; 3],
}

impl CellGrid {
    /// Of cells row by row, so many a row.
    pub fn new(cells: &[LightCell], columns: usize) -> Self {
        let axis = |k: usize| cells.iter().map(|cell| cell.cone.axis[k]).collect();
        let towards = |k: usize| cells.iter().map(|cell| cell.towards[k]).collect();
        Self {
            columns,
            areas: cells.iter().map(|cell| cell.area).collect(),
            powers: cells.iter().map(|cell| cell.power).collect(),
            axes: std::array::from_fn(axis),
            cosines: cells.iter().map(|cell| cell.cone.cosine).collect(),
            sines: cells.iter().map(|cell| sine(cell.cone.cosine)).collect(),
            towards: std::array::from_fn(towards),
        }
    }

    /// Rows of cells.
    pub fn rows(&self) -> usize {
        self.areas.len() / self.columns.max(1)
    }

    /// The light of all.
    pub fn power(&self) -> f64 {
        self.powers.iter().sum()
    }

    /// What each cell of a row brings to surfaces whose normals lie in a cone, if light from one side is all they take, of
    /// those that meet a cone of directions; gives the solid angle of those that bring any.
    pub fn weigh(&self, row: usize, normals: Option<&Cone>, to: &Cone, weights: &mut [f64]) -> f64 {
        let cells = row * self.columns..(row + 1) * self.columns;
        let shares = &mut [0.0; 64][..];
        let (areas, powers) = (&self.areas[cells.clone()], &self.powers[cells.clone()]);
        let mut area = 0.0;
        for start in (0..self.columns).step_by(shares.len()) {
            let end = self.columns.min(start + shares.len());
            let some = cells.start + start..cells.start + end;
            let shares = &mut shares[..end - start];
            match normals {
                Some(normals) => self.shares(some.clone(), normals, shares),
                None => shares.fill(1.0),
            }
            if to.cosine > 0.0 {
                self.leave_out(some, to, shares);
            }
            let own = weights[start..end].iter_mut().zip(&powers[start..end]).zip(&areas[start..end]);
            for (((weight, power), cell), share) in own.zip(shares.iter()) {
                *weight = power * f64::from(*share);
                area += if *weight > 0.0 { *cell } else { 0.0 };
            }
        }
        area
    }

    /// The share of its power that each cell brings to the middle of some normals, at least half of a bound of what it can
    /// bring to any of them.
    fn shares(&self, cells: std::ops::Range<usize>, normals: &Cone, shares: &mut [f32]) {
        let count = shares.len();
        let [x, y, z] = self.axes.each_ref().map(|axis| &axis[cells.clone()][..count]);
        let [u, v, w] = self.towards.each_ref().map(|towards| &towards[cells.clone()][..count]);
        let [cosines, sines] = [&self.cosines, &self.sines].map(|of| &of[cells.clone()][..count]);
        let (Vec3 { x: nx, y: ny, z: nz }, cosine) = (normals.axis, normals.cosine);
        let sine = sine(cosine);
        for i in 0..count {
            // Beyond a right angle together nothing can be ruled out.
            let unknown = cosines[i] * cosine <= sines[i] * sine;
            let slack = if unknown { 3.0 } else { sine * cosines[i] + cosine * sines[i] };
            let most = 0.5 * ((x[i] * nx + y[i] * ny + z[i] * nz) + slack);
            shares[i] = (u[i] * nx + v[i] * ny + w[i] * nz).max(most).max(0.0);
        }
    }

    /// Takes the shares of cells that do not meet a cone of less than a right angle: see [`Cone::meets`].
    fn leave_out(&self, cells: std::ops::Range<usize>, to: &Cone, shares: &mut [f32]) {
        let count = shares.len();
        let [x, y, z] = self.axes.each_ref().map(|axis| &axis[cells.clone()][..count]);
        let [cosines, sines] = [&self.cosines, &self.sines].map(|of| &of[cells.clone()][..count]);
        let (Vec3 { x: nx, y: ny, z: nz }, cosine, sine) = (to.axis, to.cosine, sine(to.cosine));
        for i in 0..count {
            let together = cosine * cosines[i] - sine * sines[i];
            let meets = nx * x[i] + ny * y[i] + nz * z[i] >= together - 1e-5;
            shares[i] = if meets | (cosines[i] <= 0.0) { shares[i] } else { 0.0 };
        }
    }
}
