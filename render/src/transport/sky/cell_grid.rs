//! Grid of cells into which the sky is divided for sampling, and the light of each cell for a cone of
//! normals.

use glam::{Vec3, Vec4};

use super::cone::{Cone, sine};

/// Number of cells that are evaluated at once.
const LANES: usize = 4;

/// Part of the sky.
#[derive(Debug, Clone, Copy)]
pub struct LightCell {
    /// Cone that contains the directions of the cell. If its cosine is negative, the directions are unknown.
    pub cone: Cone,
    /// Solid angle.
    pub area: f64,
    /// Luminance times solid angle.
    pub power: f64,
    /// Mean direction of the light of the cell. Its length is at most 1, and smaller for a wide cell.
    pub towards: Vec3,
}

/// Cells of the sky, row by row.
#[derive(Debug, Clone, Default)]
pub struct CellGrid {
    /// Number of cells per row.
    pub columns: usize,
    /// Two values for each cell: luminance times solid angle, and the solid angle.
    powers: Vec<[f64; 2]>,
    /// Directions of the cells, in groups of [`LANES`] cells of the same row. The last group of a row may have
    /// empty lanes.
    directions: Vec<Directions>,
}

/// Directions and mean light directions of a group of cells, one per lane.
#[derive(Debug, Clone, Copy, Default)]
struct Directions {
    axes: [Vec4; 3],
    cosines: Vec4,
    sines: Vec4,
    towards: [Vec4; 3],
}

/// Dot products of several vectors, one per lane, with an axis.
fn dot([x, y, z]: [Vec4; 3], axis: Vec3) -> Vec4 {
    x * axis.x + y * axis.y + z * axis.z
}

impl Directions {
    fn of(cells: &[LightCell]) -> Self {
        let mut all = Self::default();
        for (lane, cell) in cells.iter().enumerate() {
            for k in 0..3 {
                all.axes[k][lane] = cell.cone.axis[k];
                all.towards[k][lane] = cell.towards[k];
            }
            (all.cosines[lane], all.sines[lane]) = (cell.cone.cosine, sine(cell.cone.cosine));
        }
        all
    }

    /// For each cell, the share of the power of the cell that reaches a surface whose normal is the axis of
    /// `normals`. Half of an upper bound of this share over all normals in the cone is returned instead if it is
    /// larger. `sine` is the sine of the cone's angle.
    #[inline]
    fn shares(&self, normals: &Cone, sine: f32) -> Vec4 {
        let cosine = normals.cosine;
        // If the angles add up to more than a right angle, nothing can be excluded.
        let unknown = (self.cosines * cosine).cmple(self.sines * sine);
        let slack = Vec4::select(unknown, Vec4::splat(3.0), self.cosines * sine + self.sines * cosine);
        let most = (dot(self.axes, normals.axis) + slack) * 0.5;
        dot(self.towards, normals.axis).max(most).max(Vec4::ZERO)
    }

    /// 1 for each cell that shares a direction with the cone `to`, up to rounding, and 0 for other cells. The angle
    /// of the cone must be less than a right angle, and `sine` is its sine.
    #[inline]
    fn meet(&self, to: &Cone, sine: f32) -> Vec4 {
        let together = self.cosines * to.cosine - self.sines * sine;
        let meets = dot(self.axes, to.axis).cmpge(together - 1e-5) | self.cosines.cmple(Vec4::ZERO);
        Vec4::select(meets, Vec4::ONE, Vec4::ZERO)
    }
}

impl CellGrid {
    /// Builds the grid from cells, row by row, with `columns` cells per row.
    pub fn new(cells: &[LightCell], columns: usize) -> Self {
        let rows = cells.chunks_exact(columns);
        let directions = rows.flat_map(|row| row.chunks(LANES).map(Directions::of)).collect();
        Self { columns, powers: cells.iter().map(|cell| [cell.power, cell.area]).collect(), directions }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.powers.len() / self.columns.max(1)
    }

    /// Total power.
    pub fn power(&self) -> f64 {
        self.powers.iter().map(|[power, _]| power).sum()
    }

    /// Power of each cell, row by row.
    pub fn powers(&self) -> impl ExactSizeIterator<Item = f64> + '_ {
        self.powers.iter().map(|[power, _]| *power)
    }

    /// Writes to `weights` the contribution of each cell of a row to surfaces whose normals lie in the cone
    /// `normals`. `None` means surfaces that are lit from all sides. Cells that do not overlap the cone of
    /// directions `to` contribute 0. Returns the solid angle of the contributing cells.
    pub fn weigh(&self, row: usize, normals: Option<&Cone>, to: &Cone, weights: &mut [f64]) -> f64 {
        let each = self.columns.div_ceil(LANES);
        let directions = &self.directions[row * each..][..each];
        let powers = &self.powers[row * self.columns..][..self.columns];
        let sines = [normals.map_or(0.0, |normals| sine(normals.cosine)), sine(to.cosine)];
        let mut area = 0.0;
        for ((directions, powers), weights) in
            directions.iter().zip(powers.chunks(LANES)).zip(weights.chunks_mut(LANES))
        {
            let shares = normals.map_or(Vec4::ONE, |normals| directions.shares(normals, sines[0]));
            let met = if to.cosine > 0.0 { directions.meet(to, sines[1]) } else { Vec4::ONE };
            let shares = (shares * met).to_array();
            for ((weight, [power, own]), share) in weights.iter_mut().zip(powers).zip(shares) {
                *weight = power * f64::from(share);
                area += if *weight > 0.0 { *own } else { 0.0 };
            }
        }
        area
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sampling::{Points, circle, stream};

    fn direction(i: u32, pair: u32) -> Vec3 {
        let [u, v] = Points::new(stream(4, 0, 0), i).pair(pair);
        let (sin, cos) = circle(u);
        let z = 1.0 - 2.0 * v;
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * cos, r * sin, z)
    }

    fn cone(i: u32, pair: u32) -> Cone {
        let cosine = [-1.0, 0.0, 0.3, 0.9, 0.999, 1.0][i as usize % 6];
        Cone { axis: direction(i, pair), cosine }
    }

    /// Contribution of a single cell, for comparison.
    fn weight(cell: &LightCell, normals: Option<&Cone>, to: &Cone) -> f64 {
        if !to.meets(&cell.cone) {
            return 0.0;
        }
        let share = normals.map_or(1.0, |normals| {
            let (a, b) = (cell.cone.cosine, normals.cosine);
            let slack = if a * b <= sine(a) * sine(b) { 3.0 } else { sine(b) * a + b * sine(a) };
            let most = 0.5 * (cell.cone.axis.dot(normals.axis) + slack);
            cell.towards.dot(normals.axis).max(most).max(0.0)
        });
        cell.power * f64::from(share)
    }

    /// Weights computed for a whole row equal, bit for bit, the weights computed cell by cell.
    #[test]
    fn rows_are_weighed_as_their_cells_are() {
        for columns in [1, 5, 16, 70] {
            let cell = |i: u32| LightCell {
                cone: cone(i, 0),
                area: f64::from(i % 7 + 1),
                power: f64::from(i % 5) * 0.3,
                towards: direction(i, 1) * 0.9,
            };
            let cells: Vec<LightCell> = (0..3 * columns as u32).map(cell).collect();
            let grid = CellGrid::new(&cells, columns);
            assert_eq!(grid.rows(), 3);
            let mut weights = vec![0.0; columns];
            for i in 0..300 {
                let normals = (i % 9 > 0).then(|| cone(i, 2));
                let to = if i.is_multiple_of(4) { Cone::ALL } else { cone(i / 3, 3) };
                for (row, cells) in cells.chunks_exact(columns).enumerate() {
                    let area = grid.weigh(row, normals.as_ref(), &to, &mut weights);
                    let alone: Vec<f64> =
                        cells.iter().map(|cell| weight(cell, normals.as_ref(), &to)).collect();
                    assert_eq!(weights, alone);
                    let lit = cells.iter().zip(&alone).filter(|(_, weight)| **weight > 0.0);
                    assert_eq!(area, lit.map(|(cell, _)| cell.area).sum::<f64>());
                }
            }
        }
    }
}
