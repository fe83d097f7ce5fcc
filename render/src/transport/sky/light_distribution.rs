//! Importance sampling of the sky for a surface: in proportion to light times cosine.
//!
//! The sky is divided into a grid of cells, narrow where it is bright. A distribution over the cells is made for a
//! cone of normals, and optionally for light from a cone of directions. The weight of a cell is the light that it
//! contributes to a surface whose normal is the axis of the cone. It is at least half of an upper bound of the
//! contribution for any normal in the cone, so that no light is ever missed. A table contains one distribution per
//! bin of the sphere of normals, made on demand.

use std::sync::OnceLock;

use fearless_simd::{f32x8, prelude::*};
use glam::Vec3;

use super::cell_grid::CellGrid;
use super::cone::Cone;

/// Usual number of bins of normals per side of the octahedral map. It is even, so that no bin crosses an edge of the
/// octahedron.
pub const FINE: usize = 24;

/// Number of entries that are compared at once.
const LANES: usize = 8;
/// Maximum number of entries of a list that is scanned linearly. Longer lists are bisected first.
const SCANNED: usize = 32;

/// Pads a list of cumulative probabilities for [`invert`], which may read a whole SIMD vector that starts at any
/// entry.
pub fn pad(cumulative: &mut Vec<f32>) {
    cumulative.extend([f32::INFINITY; LANES]);
}

/// Index of the first entry above `u` among the first `length` entries of a cumulative distribution, and the
/// relative position of `u` between the previous entry and this one, in [0, 1). The last entry must be 1, and `u`
/// less than 1. The entries must be padded; see [`pad`].
#[inline(always)]
pub fn invert<S: Simd>(simd: S, cumulative: &[f32], length: usize, u: f64) -> (usize, f64) {
    // Entries up to `u` are entries up to the largest f32 not above it.
    let nearest = u as f32;
    let single = if f64::from(nearest) > u { nearest.next_down() } else { nearest };
    let (mut index, mut left) = (0, length);
    while left > SCANNED {
        let half = left / 2;
        index += if cumulative[index + half - 1] <= single { half } else { 0 };
        left -= half;
    }
    let bound = f32x8::splat(simd, single);
    for entries in cumulative[index..].chunks_exact(LANES) {
        let above = f32x8::from_slice(simd, entries).simd_gt(bound).to_bitmask();
        if above != 0 {
            index += above.trailing_zeros() as usize;
            break;
        }
        index += LANES;
    }
    let index = index.min(length.saturating_sub(1));
    let low = if index > 0 { f64::from(cumulative[index - 1]) } else { 0.0 };
    let width = f64::from(cumulative[index]) - low;
    let within = if width > 0.0 { (u - low) / width } else { 0.5 };
    (index, within.clamp(0.0, 1.0 - f64::EPSILON))
}

/// Writes the cumulative probabilities of entries with the given weights to `out`. If all weights are 0, the
/// probabilities are uniform. Returns the sum of the weights.
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
    // Rounding must not give probability to entries after the last with weight.
    let last = weights.iter().rposition(|&w| w > 0.0).unwrap_or(n.saturating_sub(1));
    out[last..].fill(1.0);
    sum
}

/// Direction that corresponds to a point of the octahedral map. The coordinates of the point lie in [-1, 1].
fn unfold(x: f32, y: f32) -> Vec3 {
    let z = 1.0 - x.abs() - y.abs();
    let under = (-z).max(0.0);
    Vec3::new(x - under.copysign(x), y - under.copysign(y), z).normalize()
}

/// Index of the bin of a normal, of `side * side` bins. Surfaces lit from all sides have the bin after the last.
#[inline]
fn bin(normal: Option<Vec3>, side: usize) -> usize {
    let Some(normal) = normal else { return side * side };
    let n = normal / (normal.x.abs() + normal.y.abs() + normal.z.abs());
    let (mut x, mut y) = (n.x, n.y);
    if n.z < 0.0 {
        (x, y) = ((1.0 - n.y.abs()).copysign(n.x), (1.0 - n.x.abs()).copysign(n.y));
    }
    let index = |v: f32| (((v + 1.0) * (0.5 * side as f32)) as usize).min(side - 1);
    index(y) * side + index(x)
}

/// Cone of the normals of a bin.
fn normals(at: usize, side: usize) -> Cone {
    let edge = |i: usize| i as f32 * (2.0 / side as f32) - 1.0;
    let (x, y) = (at % side, at / side);
    Cone::around(
        [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].map(|(x, y)| unfold(edge(x), edge(y))).into_iter(),
    )
}

/// Distribution over the cells of the sky.
#[derive(Debug, Clone)]
pub struct LightDistribution {
    rows: usize,
    columns: usize,
    /// Cumulative probabilities of the rows, followed by the cumulative probabilities of the columns of each row.
    /// Each list is padded to whole vectors.
    cumulative: Vec<f32>,
    /// Index in `cumulative` at which the list of columns of the first row starts.
    starts: usize,
    /// Number of entries between the starts of the lists of two consecutive rows.
    stride: usize,
    /// Sum of the weights of all cells. If it is 0, all cells are equally likely.
    pub power: f64,
    /// Solid angle of the cells whose weight is above 0.
    pub area: f64,
}

impl LightDistribution {
    /// Computes the distribution for surfaces whose normals lie in the cone `normals`, over the cells that overlap
    /// the cone of directions `to`. `None` means surfaces that are lit from all sides.
    pub fn new(grid: &CellGrid, normals: Option<Cone>, to: &Cone) -> Self {
        Self::scaled(grid, normals, to, None)
    }

    /// Same as [`new`](Self::new), with the weight of each cell, row by row, multiplied by its factor.
    fn scaled(grid: &CellGrid, normals: Option<Cone>, to: &Cone, factors: Option<&[f32]>) -> Self {
        let (rows, columns) = (grid.rows(), grid.columns);
        let [starts, stride] = [rows, columns].map(|length| length.next_multiple_of(LANES));
        let cumulative = vec![f32::INFINITY; starts + rows * stride + LANES];
        let mut distribution = Self { rows, columns, cumulative, starts, stride, power: 0.0, area: 0.0 };
        let (to_rows, to_columns) = distribution.cumulative.split_at_mut(starts);
        let mut exact = vec![0.0; rows.max(columns)];
        let mut narrow = |weights: &[f64], to: &mut [f32]| {
            let sum = accumulate(weights, &mut exact[..weights.len()]);
            to.iter_mut().zip(&exact[..weights.len()]).for_each(|(to, from)| *to = *from as f32);
            sum
        };
        let (mut weights, mut of_rows) = (vec![0.0; columns], vec![0.0; rows]);
        for (row, of_row) in of_rows.iter_mut().enumerate() {
            distribution.area += grid.weigh(row, normals.as_ref(), to, &mut weights);
            if let Some(factors) = factors {
                let factors = &factors[row * columns..][..columns];
                weights.iter_mut().zip(factors).for_each(|(weight, factor)| *weight *= f64::from(*factor));
            }
            *of_row = narrow(&weights, &mut to_columns[row * stride..][..stride]);
        }
        distribution.power = narrow(&of_rows, to_rows);
        distribution
    }

    /// Chooses the row and column of a cell from two random numbers. Also returns the relative position of each
    /// number within the interval of its row or column; these positions can serve as new random numbers.
    #[inline(always)]
    pub fn choose<S: Simd>(&self, simd: S, point: [f64; 2]) -> (usize, usize, [f64; 2]) {
        let (row, v) = invert(simd, &self.cumulative, self.rows, point[0]);
        let (column, u) = invert(simd, &self.cumulative[self.start(row)..], self.columns, point[1]);
        (row, column, [v, u])
    }

    #[inline]
    fn start(&self, row: usize) -> usize {
        self.starts + row * self.stride
    }

    /// Probability of a cell.
    #[inline]
    pub fn probability(&self, row: usize, column: usize) -> f32 {
        let share = |c: &[f32], i: usize| c[i] - if i > 0 { c[i - 1] } else { 0.0 };
        share(&self.cumulative, row) * share(&self.cumulative[self.start(row)..], column)
    }
}

/// One distribution for each bin of normals, and one for surfaces lit from all sides. Each is made on first
/// use.
#[derive(Debug)]
pub struct LightTable {
    /// Number of bins per side of the octahedral map.
    side: usize,
    made: Vec<OnceLock<Box<LightDistribution>>>,
}

impl LightTable {
    /// Creates an empty table with `side * side` bins of normals. `side` must be even.
    pub fn new(side: usize) -> Self {
        Self { side, made: (0..=side * side).map(|_| OnceLock::new()).collect() }
    }

    /// Distribution over the cells of a grid, for surfaces with the given unit normal. If there are `factors`, the
    /// weight of each cell, row by row, is multiplied by its factor. Grid and factors must be the same in all calls.
    #[inline]
    pub fn of(&self, grid: &CellGrid, normal: Option<Vec3>, factors: Option<&[f32]>) -> &LightDistribution {
        let (side, at) = (self.side, bin(normal, self.side));
        self.made[at].get_or_init(|| {
            let normals = (at < side * side).then(|| normals(at, side));
            Box::new(LightDistribution::scaled(grid, normals, &Cone::ALL, factors))
        })
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::super::cell_grid::LightCell;
    use super::*;
    use crate::geometry::sampling::{Points, stream};

    fn direction(i: u32, pair: u32) -> Vec3 {
        testing::direction(Points::new(stream(8, 0, 0), i).pair(pair))
    }

    /// Inverts with every SIMD level and checks that all agree.
    fn inverted(cumulative: &[f64], u: f64) -> (usize, f64) {
        let mut single: Vec<f32> = cumulative.iter().map(|&c| c as f32).collect();
        pad(&mut single);
        let found = testing::levels()
            .into_iter()
            .map(|level| dispatch!(level, simd => invert(simd, &single, cumulative.len(), u)));
        found
            .reduce(|a, b| {
                assert_eq!(a, b);
                a
            })
            .expect("a level")
    }

    #[test]
    fn inversion_skips_what_has_no_weight() {
        let mut cumulative = [0.0; 5];
        assert_eq!(accumulate(&[0.0, 1.0, 0.0, 3.0, 0.0], &mut cumulative), 4.0);
        assert_eq!(inverted(&cumulative, 0.0).0, 1);
        assert_eq!(inverted(&cumulative, 0.25), (3, 0.0));
        assert_eq!(inverted(&cumulative, 0.25 - f64::EPSILON).0, 1, "no rounding of where it is asked");
        assert_eq!(inverted(&cumulative, 1.0 - f64::EPSILON).0, 3);
        assert_eq!(accumulate(&[0.0; 4], &mut cumulative[..4]), 0.0);
        assert_eq!(inverted(&cumulative[..4], 0.6).0, 2);
    }

    /// Inversion finds the first entry above `u`, for lines of any length, whatever follows them in memory. This
    /// test fails if `half - 1` in `invert` is replaced with `half - 2`.
    #[test]
    fn inversion_finds_the_first_entry_above() {
        for length in [1, 2, 7, 8, 9, 31, 32, 33, 64, 65, 100, 257] {
            let weights: Vec<f64> =
                (0..length).map(|i| f64::from(crate::geometry::sampling::mix(i) % 5)).collect();
            let mut cumulative = vec![0.0; weights.len()];
            accumulate(&weights, &mut cumulative);
            let single: Vec<f32> = cumulative.iter().map(|&c| c as f32).collect();
            let mut line = single.clone();
            line.extend([0.3, 0.9]);
            pad(&mut line);
            for i in 0..400 {
                let u = crate::geometry::sampling::fraction(crate::geometry::sampling::mix(i));
                // Values next to each entry are tested too.
                let entry = single[i as usize % single.len()];
                for u in [u, f64::from(entry), f64::from(entry) - 1e-12] {
                    if !(0.0..1.0).contains(&u) {
                        continue;
                    }
                    let first = single.iter().position(|&c| f64::from(c) > u);
                    for level in testing::levels() {
                        let (found, _) = dispatch!(level, simd => invert(simd, &line, single.len(), u));
                        assert_eq!(Some(found), first, "{length} {u}");
                    }
                }
            }
        }
    }

    // A normal lies within the radius of its bin, so the cone that the bound is computed for contains it.
    #[test]
    fn directions_fall_into_the_bin_that_shows_them() {
        for i in 0..20_000 {
            let normal = direction(i, 0);
            let at = bin(Some(normal), FINE);
            let centre = |i: usize| (i as f32 + 0.5) * (2.0 / FINE as f32) - 1.0;
            let middle = unfold(centre(at % FINE), centre(at / FINE));
            assert!(middle.dot(normal) > 0.985, "{normal} {middle}");
        }
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
            assert!(bin(Some(axis), FINE) < FINE * FINE);
        }
    }

    // If a direction of a cell is above the horizon of a normal, the cell has a probability of at least a third of
    // its share of power times cosine.
    #[test]
    fn no_light_is_left_out() {
        let tip = 0.15_f32;
        let cells: Vec<LightCell> = (0..64)
            .map(|i| {
                let axis = direction(i, 1);
                let cosine = scene::math::num::f32::cos(tip);
                LightCell { cone: Cone { axis, cosine }, area: 0.2, power: 1.0, towards: axis * 0.99 }
            })
            .collect();
        let (grid, table) = (CellGrid::new(&cells, 8), LightTable::new(FINE));
        for i in 0..4_000 {
            let normal = direction(i, 2);
            let distribution = table.of(&grid, Some(normal), None);
            let total: f32 = (0..64).map(|k| distribution.probability(k / 8, k % 8)).sum();
            assert!((total - 1.0).abs() < 1e-5);
            let ideal: f32 = cells.iter().map(|c| c.cone.axis.dot(normal).max(0.0)).sum();
            for (k, cell) in cells.iter().enumerate() {
                // The direction of the cell that is highest above the surface.
                let angle = scene::math::num::f32::acos(cell.cone.axis.dot(normal).clamp(-1.0, 1.0)) - tip;
                let highest = scene::math::num::f32::cos(angle.max(0.0));
                let probability = distribution.probability(k / 8, k % 8);
                assert!(
                    probability >= 0.3 * highest / ideal || highest <= 0.0,
                    "{probability} {highest} {ideal}"
                );
            }
        }
    }

    // The cone contains every direction from any point of one box to the other, and little more.
    #[test]
    fn cones_hold_every_way_between_two_boxes() {
        let from = [Vec3::new(-0.2, -0.3, 0.0), Vec3::new(0.3, 0.1, 0.05)];
        for to in
            [[Vec3::new(0.5, 1.0, 0.1), Vec3::new(0.9, 1.6, 2.0)], [Vec3::splat(-0.1), Vec3::splat(0.4)]]
        {
            let cone = Cone::between(from, to);
            assert_eq!(cone == Cone::ALL, to[0].x < 0.0);
            for i in 0..1_000 {
                let points = Points::new(3, i);
                let [[a, b], [c, d], [e, f]] = [0, 1, 2].map(|k| points.pair(k));
                let within = |b: [Vec3; 2], at: Vec3| b[0] + (b[1] - b[0]) * at;
                let way = within(to, Vec3::new(a, b, c)) - within(from, Vec3::new(d, e, f));
                assert!(way.normalize().dot(cone.axis) >= cone.cosine);
                let here = Cone { axis: way.normalize(), cosine: 0.999_9 };
                assert!(cone.meets(&here) && here.meets(&cone));
            }
        }
        let far = Cone { axis: Vec3::X, cosine: 0.9 };
        assert!(!far.meets(&Cone { axis: Vec3::Y, cosine: 0.9 }));
    }
}
