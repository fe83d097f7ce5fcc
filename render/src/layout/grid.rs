//! Grid of upright cells that records which parts of a scene are solid and which are free.

use glam::{DMat3, DVec3};
use scene::types::Splats;

use crate::geometry::level::{LevelEstimate, rotation};

/// Maximum number of cells along a horizontal side.
const SIDE: usize = 320;
/// Maximum number of cells along the vertical.
const STOREYS: usize = 160;
/// Number of cells per radius of the scene, if its splats are fine enough.
const FINE: f64 = 160.0;
/// Minimum sum of opacity times area over the splats of a solid cell, as a multiple of the area of one side of the
/// cell.
const SOLID: f32 = 0.25;
/// Minimum opacity of the splats that count. More transparent splats are ignored as fog.
const FAINT: f32 = 0.15;
/// Number of samples along each axis of a large splat.
const SAMPLES: i32 = 8;

/// Grid of upright cells around the middle of a scene.
#[derive(Debug)]
pub struct Grid {
    /// Axes of the grid as columns: across, along and up, as unit vectors of the world.
    pub axes: DMat3,
    /// Corner with the smallest coordinates, in the frame of `axes`, in world units.
    pub low: DVec3,
    /// Side of a cell, in world units.
    pub cell: f64,
    /// Number of cells across, along and up.
    pub size: [usize; 3],
    solid: Vec<bool>,
    /// For each column, the sum of the sizes of its splats, and the number of these splats.
    detail: Vec<[f32; 2]>,
}

impl Grid {
    /// Builds the grid of a scene whose up direction is known.
    pub fn new(splats: &Splats, stand: &LevelEstimate) -> Self {
        let up = DVec3::from_array(stand.up);
        let across = if up.x.abs() < 0.9 { DVec3::X } else { DVec3::Y };
        let along = up.cross(across).normalize();
        let axes = DMat3::from_cols(along.cross(up), along, up);
        let centre = axes.transpose() * DVec3::from_array(stand.centre);
        let inside = |i: usize| {
            splats.opacities[i] >= FAINT
                && (splats.mean(i) - DVec3::from_array(stand.centre)).length() < stand.radius
        };
        let mut sizes: Vec<f32> = (0..splats.len())
            .step_by((splats.len() / 50_000).max(1))
            .filter(|&i| inside(i))
            .map(|i| sorted(splats.scales[i])[1])
            .collect();
        sizes.sort_by(f32::total_cmp);
        let median = f64::from(sizes.get(sizes.len() / 2).copied().unwrap_or_default());
        let cell = (2.0 * median).max(stand.radius / FINE).max(1e-9);
        let side = ((2.0 * stand.radius / cell).ceil() as usize).clamp(8, SIDE);
        // The grid begins slightly below the floor.
        let storeys = ((1.2 * stand.radius / cell).ceil() as usize).clamp(8, STOREYS);
        let half = 0.5 * side as f64 * cell;
        let low = DVec3::new(centre.x - half, centre.y - half, stand.floor - 8.0 * cell);
        let size = [side, side, storeys];
        let mut grid = Self { axes, low, cell, size, solid: Vec::new(), detail: vec![[0.0; 2]; side * side] };
        let mut filled = vec![0.0_f32; side * side * storeys];
        for i in 0..splats.len() {
            if splats.opacities[i] >= FAINT {
                grid.fill(splats, i, &mut filled);
            }
        }
        grid.solid = filled.into_iter().map(|v| v >= SOLID).collect();
        grid
    }

    fn fill(&mut self, splats: &Splats, i: usize, filled: &mut [f32]) {
        let middle = self.axes.transpose() * splats.mean(i);
        let turn = self.axes.transpose() * rotation(splats.quats[i]);
        let scale = splats.scales[i].map(f64::from);
        let [_, middling, _] = sorted(splats.scales[i]);
        let thin = (1..3).fold(0, |best, k| if scale[k] < scale[best] { k } else { best });
        let [a, b] = [(thin + 1) % 3, (thin + 2) % 3];
        let (u, v) = (turn.col(a) * scale[a], turn.col(b) * scale[b]);
        if let Some([x, y, _]) = self.at(middle) {
            let detail = &mut self.detail[y * self.size[0] + x];
            detail[0] += middling;
            detail[1] += 1.0;
        }
        // As far as 1.5 standard deviations, in steps of at most a cell.
        let steps = |s: f64| (((3.0 * s / self.cell).ceil() as i32).clamp(1, 2 * SAMPLES), s);
        let ((nu, _), (nv, _)) = (steps(scale[a]), steps(scale[b]));
        let area = 9.0 * scale[a] * scale[b] / (self.cell * self.cell) / f64::from(nu * nv);
        let weight = splats.opacities[i] * (area.min(1.0) as f32);
        for j in 0..nu {
            for k in 0..nv {
                let place = |n: i32, of: i32| 1.5 * (f64::from(2 * n + 1) / f64::from(of) - 1.0);
                let at = self.at(middle + u * place(j, nu) + v * place(k, nv));
                if let Some([x, y, z]) = at {
                    filled[(z * self.size[1] + y) * self.size[0] + x] += weight;
                }
            }
        }
    }

    /// Cell that contains a point in the frame of `axes`. `None` if the point lies outside the grid.
    pub fn at(&self, p: DVec3) -> Option<[usize; 3]> {
        let v = (p - self.low) / self.cell;
        let inside = |v: f64, n: usize| v >= 0.0 && v < n as f64;
        let whole = inside(v.x, self.size[0]) && inside(v.y, self.size[1]) && inside(v.z, self.size[2]);
        if whole { Some([v.x as usize, v.y as usize, v.z as usize]) } else { None }
    }

    /// True if a cell is solid.
    pub fn is_solid(&self, [x, y, z]: [usize; 3]) -> bool {
        self.solid[(z * self.size[1] + y) * self.size[0] + x]
    }

    /// Middle of the top of a cell, in the frame of `axes`.
    pub fn top(&self, [x, y, z]: [usize; 3]) -> DVec3 {
        self.low + DVec3::new(x as f64 + 0.5, y as f64 + 0.5, z as f64 + 1.0) * self.cell
    }

    /// Mean size of the splats in and around a column, in world units. `None` if there are no splats.
    pub fn detail(&self, x: usize, y: usize) -> Option<f64> {
        let (mut sum, mut count) = (0.0, 0.0);
        for v in y.saturating_sub(2)..(y + 3).min(self.size[1]) {
            for u in x.saturating_sub(2)..(x + 3).min(self.size[0]) {
                let [s, n] = self.detail[v * self.size[0] + u];
                (sum, count) = (sum + f64::from(s), count + f64::from(n));
            }
        }
        (count > 0.0).then(|| sum / count)
    }

    /// Distance from `from` to the first solid cell along a ray, in world units and at most `most`. `from` and
    /// `direction` are in the frame of `axes`.
    pub fn free(&self, from: DVec3, direction: DVec3, most: f64) -> f64 {
        let step = 0.5 * self.cell;
        let count = (most / step).floor() as usize;
        for i in 0..count {
            let at = from + direction * (i as f64 * step);
            if self.at(at).is_some_and(|cell| self.is_solid(cell)) {
                return i as f64 * step;
            }
        }
        most
    }

    /// True if all cells within `radius` of a point are free. Space outside the grid is free.
    pub fn is_clear(&self, at: DVec3, radius: f64) -> bool {
        let n = (radius / self.cell).ceil() as i32;
        let around = |k: i32| f64::from(k) * self.cell;
        (-n..=n).all(|z| {
            (-n..=n).all(|y| {
                (-n..=n).all(|x| {
                    let by = DVec3::new(around(x), around(y), around(z));
                    by.length() > radius || !self.at(at + by).is_some_and(|cell| self.is_solid(cell))
                })
            })
        })
    }
}

fn sorted(mut scale: [f32; 3]) -> [f32; 3] {
    scale.sort_by(f32::total_cmp);
    scale
}
