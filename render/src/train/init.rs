//! Splats before the first iteration, from points or at random.

use glam::DVec3;
use scene::math::num;
use scene::types::{Camera, Point, Splats};

use super::random::{Purpose, uniform};
use super::step::extent;

/// Opacity of initial splats.
const OPACITY: f32 = 0.5;
/// Factor on the distance between neighbours that gives the standard deviation of initial splats.
const SIZE: f64 = 0.5;
/// Value of the basis function of degree 0.
const Y0: f64 = 0.282_094_791_773_878_1;
/// Number of neighbours whose distances are averaged.
const NEIGHBOURS: usize = 3;
/// Distance of random points from the middle of the cameras, in extents of the cameras.
const REACH: f64 = 3.0;

/// Grey points at random positions around the cameras, for photographs without points.
pub fn random_points(cameras: &[Camera], count: usize, seed: u64) -> Vec<Point> {
    let middle = cameras.iter().map(Camera::eye).sum::<DVec3>() / cameras.len().max(1) as f64;
    let reach = REACH * extent(cameras.iter());
    let point = |i: usize| {
        let of = |axis: u64| 2.0 * uniform(seed, Purpose::Start, axis, i as u64) - 1.0;
        let position = middle + DVec3::new(of(0), of(1), of(2)) * reach;
        Point { position: position.to_array().map(|c| c as f32), rgb: [0.5; 3] }
    };
    (0..count).map(point).collect()
}

/// At most `most` of the points, chosen at equal intervals of their indices.
pub fn thinned(points: &[Point], most: usize) -> Vec<Point> {
    if points.len() <= most {
        return points.to_vec();
    }
    let ratio = points.len() as f64 / most as f64;
    (0..most).map(|i| points[(i as f64 * ratio) as usize]).collect()
}

/// Round splats at the points, of degree 0. Their size follows from the distance to their neighbours.
pub fn splats_at(points: &[Point], antialiased: bool) -> Splats {
    let distances = spacings(points);
    let finite = |v: f64| if v.is_finite() && v > 0.0 { v } else { 1e-4 };
    Splats {
        means: points.iter().map(|point| point.position).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; points.len()],
        scales: distances.into_iter().map(|d| [(SIZE * finite(d)) as f32; 3]).collect(),
        opacities: vec![OPACITY; points.len()],
        sh: points.iter().map(|point| point.rgb.map(|c| ((f64::from(c) - 0.5) / Y0) as f32)).collect(),
        antialiased,
        ..Splats::empty()
    }
}

/// Root of the mean squared distance of each point to its nearest neighbours; 0 for a single point.
///
/// The points are sorted into cells of a grid with about two points per cell, and cells are searched in shells of
/// growing distance.
fn spacings(points: &[Point]) -> Vec<f64> {
    let place = |i: usize| DVec3::from(points[i].position.map(f64::from));
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for i in 0..points.len() {
        (low, high) = (low.min(place(i)), high.max(place(i)));
    }
    let sides = (high - low).max(DVec3::splat(1e-9));
    // Outliers make most cells empty, so the cells are finer than two points per cell on average.
    let count = (points.len() as f64).max(1.0);
    let each = sides.x * sides.y * sides.z / count;
    let cell = num::pow(each, 1.0 / 3.0).max(sides.max_element() / 512.0);
    let cells = (sides / cell).ceil().max(DVec3::ONE).min(DVec3::splat(513.0));
    let size = cells.to_array().map(|n| n as usize);
    let of = |i: usize| {
        let at = ((place(i) - low) / cell).to_array();
        std::array::from_fn::<usize, 3, _>(|axis| (at[axis] as usize).min(size[axis] - 1))
    };
    let number = |[x, y, z]: [usize; 3]| (z * size[1] + y) * size[0] + x;
    let mut order: Vec<(usize, u32)> = (0..points.len()).map(|i| (number(of(i)), i as u32)).collect();
    order.sort_unstable();
    let within = |cell: usize| {
        let start = order.partition_point(|entry| entry.0 < cell);
        order[start..].iter().take_while(move |entry| entry.0 == cell).map(|entry| entry.1 as usize)
    };
    let one = |i: usize| {
        let (here, home) = (place(i), of(i));
        let mut nearest = [f64::INFINITY; NEIGHBOURS];
        for shell in 0..=size[0].max(size[1]).max(size[2]) {
            let range =
                |axis: usize| home[axis].saturating_sub(shell)..=(home[axis] + shell).min(size[axis] - 1);
            for z in range(2) {
                for y in range(1) {
                    for x in range(0) {
                        let off = [x, y, z].iter().zip(home).map(|(a, b)| a.abs_diff(b)).max();
                        if off != Some(shell) {
                            continue;
                        }
                        for other in within(number([x, y, z])).filter(|other| *other != i) {
                            let d = (place(other) - here).length_squared();
                            if d < nearest[NEIGHBOURS - 1] {
                                nearest[NEIGHBOURS - 1] = d;
                                nearest.sort_by(f64::total_cmp);
                            }
                        }
                    }
                }
            }
            // Points in farther shells are at least this far away.
            let sure = shell as f64 * cell;
            if nearest[NEIGHBOURS - 1] <= sure * sure {
                break;
            }
        }
        let found = nearest.iter().filter(|d| d.is_finite());
        (found.clone().sum::<f64>() / found.count().max(1) as f64).sqrt()
    };
    (0..points.len()).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Spacings equal those found by comparing all pairs, for clusters, outliers and few points.
    #[test]
    fn spacings_are_those_of_all_pairs() {
        for count in [1, 2, 3, 4, 200] {
            let point = |i: u64| {
                let of = |axis| uniform(5, Purpose::Start, axis, i);
                let size = if i.is_multiple_of(50) { 100.0 } else { 1.0 };
                let position = [of(0) * size, of(1) * 0.3, of(2) * of(3)].map(|v| v as f32);
                Point { position, rgb: [0.0; 3] }
            };
            let points: Vec<Point> = (0..count).map(point).collect();
            for (i, found) in spacings(&points).into_iter().enumerate() {
                let at = |i: usize| DVec3::from(points[i].position.map(f64::from));
                let mut all: Vec<f64> =
                    (0..points.len()).filter(|j| *j != i).map(|j| (at(j) - at(i)).length_squared()).collect();
                all.sort_by(f64::total_cmp);
                all.truncate(NEIGHBOURS);
                let expected = (all.iter().sum::<f64>() / all.len().max(1) as f64).sqrt();
                assert!((found - expected).abs() < 1e-12, "{count} {i} {found} {expected}");
            }
        }
    }
}
