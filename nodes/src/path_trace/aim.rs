//! Which part of the sky to sample for a surface: in proportion to its light times the cosine.
//!
//! The sky is cut into a grid of cells and the sphere of normals into bins. For each bin stands a
//! distribution over the cells, by their power times a bound of the cosine that any normal of the bin and
//! any direction of the cell can have, so that no light is ever left out. What is far from the horizon is
//! sampled in proportion to power times cosine, and below the horizon nothing is.

use glam::Vec3;

/// Bins along a side of the octahedral map; even, so that no bin crosses an edge of the octahedron.
const SIDE: usize = 24;
/// The bin of surfaces that light may reach from all sides.
const ANY: usize = SIDE * SIDE;

/// A part of the sky.
#[derive(Debug, Clone, Copy)]
pub struct Cell {
    /// Middle of its directions, a unit vector.
    pub axis: Vec3,
    /// Cosine of the angle from the axis to its farthest direction; below 0 nothing is known of it.
    pub spread: f32,
    /// Luminance times solid angle.
    pub power: f64,
}

/// The distributions over the cells.
#[derive(Debug)]
pub struct Aim {
    columns: usize,
    rows: usize,
    /// For each bin, cumulative probability of the rows, then of the columns of each row.
    cumulative: Vec<f64>,
    /// For each bin, probability of each cell.
    odds: Vec<f32>,
}

/// Index of the first entry of a cumulative distribution above `u`, and where between its neighbours `u`
/// lies, in [0, 1). The last entry is 1 and `u` less than that.
#[inline]
pub fn invert<T: Copy + Into<f64> + PartialOrd>(cumulative: &[T], u: f64) -> (usize, f64) {
    let below = match cumulative.len() {
        // Few are counted faster than halved.
        0..=32 => cumulative.iter().map(|&c| u64::from(c.into() <= u)).sum::<u64>() as usize,
        _ => cumulative.partition_point(|&c| c.into() <= u),
    };
    let index = below.min(cumulative.len().saturating_sub(1));
    let low = if index > 0 { cumulative[index - 1].into() } else { 0.0 };
    let width = cumulative[index].into() - low;
    let within = if width > 0.0 { (u - low) / width } else { 0.5 };
    (index, within.clamp(0.0, 1.0 - f64::EPSILON))
}

/// Cumulative probabilities in proportion to weights, uniform where all are 0, and their sum.
pub fn accumulate(weights: &[f64], out: &mut [f64]) -> f64 {
    let mut sum = 0.0;
    for (to, weight) in out.iter_mut().zip(weights) {
        sum += weight;
        *to = sum;
    }
    let n = weights.len();
    if sum > 0.0 && sum.is_finite() {
        out.iter_mut().for_each(|c| *c /= sum);
    } else {
        out.iter_mut().enumerate().for_each(|(i, c)| *c = (i + 1) as f64 / n as f64);
    }
    // From the last that has a share: rounding must not give one to those after it.
    let last = weights.iter().rposition(|&w| w > 0.0).unwrap_or(n.saturating_sub(1));
    out[last..].fill(1.0);
    sum
}

/// The direction of a point of the octahedral map, from [-1, 1] squared.
fn unfold(x: f32, y: f32) -> Vec3 {
    let z = 1.0 - x.abs() - y.abs();
    let under = (-z).max(0.0);
    Vec3::new(x - under.copysign(x), y - under.copysign(y), z).normalize()
}

/// The bin of a normal.
#[inline]
fn bin(normal: Option<Vec3>) -> usize {
    let Some(normal) = normal else { return ANY };
    let n = normal / (normal.x.abs() + normal.y.abs() + normal.z.abs());
    let (mut x, mut y) = (n.x, n.y);
    if n.z < 0.0 {
        (x, y) = ((1.0 - n.y.abs()).copysign(n.x), (1.0 - n.x.abs()).copysign(n.y));
    }
    let index = |v: f32| (((v + 1.0) * (0.5 * SIDE as f32)) as usize).min(SIDE - 1);
    index(y) * SIDE + index(x)
}

/// Greatest share of its power that a cell can bring to a normal of a bin, less where it is above the
/// horizon as a whole; `cosine` between their middles, `slack` the sine of the sum of their radii.
fn bound(cosine: f32, slack: f32) -> f64 {
    f64::from(cosine.max(0.5 * (cosine + slack)).max(0.0))
}

impl Aim {
    /// Distributions over `columns` by `rows` cells.
    pub fn new(cells: &[Cell], columns: usize, rows: usize) -> Self {
        let stride = rows * (columns + 1);
        let mut aim = Self {
            columns,
            rows,
            cumulative: vec![0.0; (ANY + 1) * stride],
            odds: Vec::with_capacity((ANY + 1) * cells.len()),
        };
        let mut weights = vec![0.0; columns];
        let mut of_rows = vec![0.0; rows];
        let edge = |i: usize| i as f32 * (2.0 / SIDE as f32) - 1.0;
        for at in 0..=ANY {
            let (x, y) = (at % SIDE, at / SIDE);
            let corners =
                [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].map(|(x, y)| unfold(edge(x), edge(y)));
            let middle = (corners[0] + corners[1] + corners[2] + corners[3]).normalize();
            // A little more than the farthest corner, for the rounding of normals.
            let radius = corners.iter().map(|c| c.dot(middle)).fold(1.0, f32::min) - 1e-5;
            let sine = |cosine: f32| (1.0 - cosine * cosine).max(0.0).sqrt();
            let (to_rows, to_columns) = aim.cumulative[at * stride..(at + 1) * stride].split_at_mut(rows);
            for row in 0..rows {
                for (weight, cell) in weights.iter_mut().zip(&cells[row * columns..]) {
                    let slack = sine(radius) * cell.spread + radius * sine(cell.spread);
                    // Beyond a right angle together nothing can be ruled out.
                    let wide = radius * cell.spread <= sine(radius) * sine(cell.spread);
                    *weight = cell.power
                        * match at {
                            ANY => 1.0,
                            _ => bound(cell.axis.dot(middle), if wide { 3.0 } else { slack }),
                        };
                }
                of_rows[row] = accumulate(&weights, &mut to_columns[row * columns..(row + 1) * columns]);
            }
            accumulate(&of_rows, to_rows);
            for row in 0..rows {
                let share = |c: &[f64], i: usize| c[i] - if i > 0 { c[i - 1] } else { 0.0 };
                let columns_of = &to_columns[row * columns..(row + 1) * columns];
                let of_row = share(to_rows, row);
                aim.odds.extend((0..columns).map(|column| (of_row * share(columns_of, column)) as f32));
            }
        }
        aim
    }

    /// Row and column of a cell for a surface of the given unit normal, if light from one side is all it takes, and where the point of the unit
    /// square lies within the choice.
    #[inline]
    pub fn choose(&self, normal: Option<Vec3>, point: [f64; 2]) -> (usize, usize, [f64; 2]) {
        let stride = self.rows * (self.columns + 1);
        let (rows, columns) = self.cumulative[bin(normal) * stride..][..stride].split_at(self.rows);
        let (row, v) = invert(rows, point[0]);
        let (column, u) = invert(&columns[row * self.columns..(row + 1) * self.columns], point[1]);
        (row, column, [v, u])
    }

    /// Probability of a cell for a surface of the given unit normal.
    #[inline]
    pub fn odds(&self, normal: Option<Vec3>, row: usize, column: usize) -> f32 {
        self.odds[(bin(normal) * self.rows + row) * self.columns + column]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Points, circle, stream};

    fn direction(i: u32, pair: u32) -> Vec3 {
        let [u, v] = Points::new(stream(8, 0, 0), i).pair(pair);
        let z = 1.0 - 2.0 * v;
        let (sin, cos) = circle(u);
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * cos, r * sin, z)
    }

    #[test]
    fn inversion_skips_what_has_no_weight() {
        let mut cumulative = [0.0; 5];
        assert_eq!(accumulate(&[0.0, 1.0, 0.0, 3.0, 0.0], &mut cumulative), 4.0);
        assert_eq!(invert(&cumulative, 0.0).0, 1);
        assert_eq!(invert(&cumulative, 0.25), (3, 0.0));
        assert_eq!(invert(&cumulative, 1.0 - f64::EPSILON).0, 3);
        assert_eq!(accumulate(&[0.0; 4], &mut cumulative[..4]), 0.0);
        assert_eq!(invert(&cumulative[..4], 0.6).0, 2);
    }

    // A normal lies within the radius of its bin, so the cone that the bound is made for holds it.
    #[test]
    fn directions_fall_into_the_bin_that_shows_them() {
        for i in 0..20_000 {
            let normal = direction(i, 0);
            let at = bin(Some(normal));
            let centre = |i: usize| (i as f32 + 0.5) * (2.0 / SIDE as f32) - 1.0;
            let middle = unfold(centre(at % SIDE), centre(at / SIDE));
            assert!(middle.dot(normal) > 0.985, "{normal} {middle}");
        }
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
            assert!(bin(Some(axis)) < ANY);
        }
    }

    // The guarantee: where a direction of a cell is above the horizon of a normal, the cell has odds, and at
    // least a third of what power times cosine asks for.
    #[test]
    fn no_light_is_left_out() {
        let tip = 0.15_f32;
        let cells: Vec<Cell> = (0..64)
            .map(|i| {
                let axis = direction(i, 1);
                Cell { axis, spread: crate::num::f32::cos(tip), power: 1.0 }
            })
            .collect();
        let aim = Aim::new(&cells, 8, 8);
        for i in 0..4_000 {
            let normal = direction(i, 2);
            let total: f32 = (0..64).map(|k| aim.odds(Some(normal), k / 8, k % 8)).sum();
            assert!((total - 1.0).abs() < 1e-5);
            let ideal: f32 = cells.iter().map(|c| c.axis.dot(normal).max(0.0)).sum();
            for (k, cell) in cells.iter().enumerate() {
                // The direction of the cell that stands highest above the surface.
                let angle = crate::num::f32::acos(cell.axis.dot(normal).clamp(-1.0, 1.0)) - tip;
                let highest = crate::num::f32::cos(angle.max(0.0));
                let odds = aim.odds(Some(normal), k / 8, k % 8);
                assert!(odds >= 0.3 * highest / ideal || highest <= 0.0, "{odds} {highest} {ideal}");
            }
        }
    }
}
