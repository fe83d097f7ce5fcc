//! Searches for the transform that brings a mesh into agreement with the splats. Rotations by quarter turns, scale
//! factors and shifts are tried, and the best combinations are refined.

use glam::{DMat3, DVec3};
use scene::types::frame::Similarity;

use super::cloud::{Cloud, Placed};
use super::spots::Spots;
use super::surfaces::{Both, Surfaces};

/// Ratio between consecutive scale factors that are tried: the cube root of 2.
const RATIO: f64 = 1.259_921_049_894_873_2;
/// Number of scale factors that are tried.
const FACTORS: i32 = 21;
/// Approximate number of points for the first comparison of transforms.
const COARSE: usize = 240;
/// Approximate number of points of the splats, and of the mesh, for the first comparison of surfaces.
const SPARSE: usize = 120;
/// Number of transforms that are refined by the agreement of surfaces.
const STARTED: usize = 10;
/// Approximate number of points for fits.
const FITTED: usize = 700;
/// Approximate number of points for the last comparison of transforms.
const FINE: usize = 2000;
/// Factor by which the tolerances are multiplied in the first comparison.
const SLACK: f64 = 2.2;
/// Distance between consecutive shifts that are tried, as a share of the median distance of the points from the
/// eye.
const SHIFT: f64 = 0.125;
/// Number of shifts that are tried along each axis.
const SHIFTS: u32 = 9;
/// Number of shifts that are refined.
const STARTS: usize = 5;
/// Length of the shifts that are applied to a fitted mesh to look for a better fit, as a share of the median
/// distance of the points from the eye.
const ASIDE: f64 = 0.07;
/// Maximum number of times that a fitted mesh is moved or scaled and then fitted again.
const CLIMBS: usize = 4;
/// Number of transforms that are refined.
const REFINED: usize = 8;
const BEST: usize = 5;
/// Minimum ratio of the agreement of a simpler transform to the agreement of the transform that it replaces.
const SIMPLER: f64 = 0.96;
/// Conversion factors between units of length, and other scale factors that are common in practice.
const UNITS: [f64; 13] =
    [1.0, 0.001, 0.01, 0.1, 0.5, 2.0, 10.0, 100.0, 1000.0, 0.3048, 1.0 / 0.3048, 0.0254, 1.0 / 0.0254];
/// Maximum relative difference of two scale factors that count as equal.
const SAME_FACTOR: f64 = 0.03;
/// Maximum angle, in radians, between the axes of two rotations that count as equal.
const SAME_TURN: f64 = 0.04;

/// The 24 rotations that map axes to axes; the first is the identity.
fn turns() -> Vec<DMat3> {
    let axes = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z];
    let across = |x: DVec3| axes.into_iter().filter(move |y| x.dot(*y) == 0.0);
    let mut all: Vec<DMat3> =
        axes.into_iter().flat_map(|x| across(x).map(move |y| DMat3::from_cols(x, y, x.cross(y)))).collect();
    all.sort_by_key(|turn| *turn != DMat3::IDENTITY);
    all
}

/// The 24 rotations and the 24 reflections that map axes to axes; the first is the identity.
fn all_turns() -> Vec<DMat3> {
    let mirror = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
    let proper = turns();
    let mirrored: Vec<DMat3> = proper.iter().map(|turn| *turn * mirror).collect();
    proper.into_iter().chain(mirrored).collect()
}

/// Rotations about an axis by multiples of 15 degrees, except by multiples of 90 degrees.
fn turns_about(axis: DVec3) -> Vec<DMat3> {
    // Sine and cosine of 15 degrees.
    let (sin, cos) = (0.258_819_045_102_520_76, 0.965_925_826_289_068_3);
    let cross = |v: DVec3| axis.cross(v) * sin + v * cos + axis * (axis.dot(v) * (1.0 - cos));
    let step = DMat3::from_cols(cross(DVec3::X), cross(DVec3::Y), cross(DVec3::Z));
    let all = std::iter::successors(Some(step), |turn| Some(step * *turn));
    all.take(23).enumerate().filter(|(i, _)| (i + 1) % 6 != 0).map(|(_, turn)| turn).collect()
}

fn step(spots: &Spots, count: usize) -> usize {
    // Odd, so that it is not a divisor of the width of a view.
    (spots.list.len() / count) | 1
}

/// Fits the mesh to the splats, starting at its own position and at shifts around it.
pub(super) fn nearby(cloud: &Cloud, spots: &Spots) -> Similarity {
    let coarse = |at: Similarity| Placed { cloud, at }.agreement(spots, step(spots, COARSE), SLACK);
    let mut starts: Vec<(f64, Similarity)> = Vec::new();
    for i in 0..SHIFTS * SHIFTS * SHIFTS {
        let steps = [i % SHIFTS, i / SHIFTS % SHIFTS, i / (SHIFTS * SHIFTS)];
        let steps = steps.map(|k| f64::from(k) - f64::from(SHIFTS / 2));
        let offset = DVec3::from_array(steps) * (SHIFT * spots.distance);
        let at = Similarity { offset, ..Similarity::IDENTITY };
        starts.push((coarse(at), at));
    }
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    starts.truncate(STARTS);
    starts.push((0.0, Similarity::IDENTITY));
    let fitted = starts.into_iter().map(|(_, at)| climbed(cloud, spots, at));
    let best = fitted.reduce(|best, other| if other.0 > best.0 { other } else { best });
    best.map_or(Similarity::IDENTITY, |(_, at)| simplest_of_views(cloud, spots, at))
}

/// The `count` transforms with the highest value of `fits`, at most one per rotation, in descending order. For each
/// rotation, all factors are tried with all shifts for them.
fn best_starts<const N: usize>(
    rotations: impl IntoIterator<Item = DMat3>,
    factors: &[f64],
    shifts: impl Fn(DMat3, f64) -> [DVec3; N],
    fits: impl Fn(Similarity) -> f64,
    count: usize,
) -> Vec<Similarity> {
    let mut found: Vec<(f64, Similarity)> = Vec::new();
    for rotation in rotations {
        let mut best: Option<(f64, Similarity)> = None;
        for &scale in factors {
            for offset in shifts(rotation, scale) {
                let at = Similarity { rotation, scale, offset };
                let fits = fits(at);
                if best.is_none_or(|(known, _)| fits > known) {
                    best = Some((fits, at));
                }
            }
        }
        found.extend(best);
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(count).map(|(_, at)| at).collect()
}

/// The transforms with which the mesh fits the splats best, in descending order of agreement. The search starts
/// from all rotations that map axes to axes, with many scale factors and two shifts each.
pub(super) fn anywhere(cloud: &Cloud, spots: &Spots) -> Vec<Similarity> {
    let about = spots.radius / cloud.radius;
    let (mut factors, mut up, mut down) = (vec![1.0, about], about, about);
    for _ in 0..FACTORS / 2 {
        (up, down) = (up * RATIO, down / RATIO);
        factors.extend([up, down]);
    }
    factors.extend(UNITS.into_iter().filter(|unit| *unit < up && *unit > down));
    factors.retain(|factor| factor.is_finite() && *factor > 0.0);
    let shifts = |rotation: DMat3, scale: f64| [DVec3::ZERO, spots.middle - rotation * cloud.middle * scale];
    let fits = |at| Placed { cloud, at }.agreement(spots, step(spots, COARSE), SLACK);
    let tried = best_starts(turns(), &factors, shifts, fits, REFINED);
    let mut refined: Vec<(f64, Similarity)> = tried.into_iter().map(|at| climbed(cloud, spots, at)).collect();
    refined.sort_by(|a, b| b.0.total_cmp(&a.0));
    refined.truncate(BEST);
    refined.into_iter().map(|(_, at)| simplest_of_views(cloud, spots, at)).collect()
}

/// Fits the mesh, starting from the transform `start`. Then moves or scales the fitted mesh and fits it again, as
/// long as the agreement increases. Returns the agreement and the transform. A single fit could stop where a wall
/// of the mesh is near the wrong wall of the splats.
fn climbed(cloud: &Cloud, spots: &Spots, start: Similarity) -> (f64, Similarity) {
    let fits = |at: Similarity, slack: f64| Placed { cloud, at }.agreement(spots, step(spots, FITTED), slack);
    let fitted = |at: Similarity, near: bool| Placed { cloud, at }.fitted(spots, step(spots, FITTED), near);
    let first = [start, fitted(start, true), fitted(start, false)].map(|at| (fits(at, 1.0), at));
    let mut best =
        first.into_iter().fold((0.0, start), |best, other| if other.0 > best.0 { other } else { best });
    for _ in 0..CLIMBS {
        let change = |change: Similarity| {
            let at = change.after(&best.1);
            (fits(at, SLACK), at)
        };
        let other = changes(spots).into_iter().map(change).reduce(|a, b| if b.0 > a.0 { b } else { a });
        let Some((_, other)) = other.filter(|(other, _)| *other > 0.9 * fits(best.1, SLACK)) else { break };
        let other = fitted(other, true);
        let found = fits(other, 1.0);
        if found <= best.0 * 1.01 {
            break;
        }
        best = (found, other);
    }
    best
}

/// The transforms with which centres of splats and points of the mesh agree best, in descending order. The search
/// starts from rotations and reflections that map axes to axes and from rotations about `up`, with factors between
/// units and between sizes, and with shifts that join the middles or the bounding boxes of both.
pub(super) fn by_surfaces(surfaces: &Surfaces<'_>, up: DVec3) -> Vec<(Both, Similarity)> {
    let (cloud, spots) = (surfaces.cloud, &surfaces.spots);
    let sizes = [spots.radius / cloud.radius, size(spots.extents()) / size(cloud.extents())];
    let mut factors = UNITS.to_vec();
    for about in sizes {
        factors.extend([about, about * 0.9, about / 0.9, about / RATIO, about * RATIO]);
    }
    let (most, least) = (20.0 * sizes[0].max(sizes[1]), 0.05 * sizes[0].min(sizes[1]));
    factors.retain(|factor| factor.is_finite() && *factor > least && *factor < most);
    let centre = |[low, high]: [DVec3; 2]| 0.5 * (low + high);
    let (from, to) = (centre(cloud.extents()), centre(spots.extents()));
    let shifts = |rotation: DMat3, scale: f64| {
        [DVec3::ZERO, spots.middle - rotation * cloud.middle * scale, to - rotation * from * scale]
    };
    let fits = |at| surfaces.agreement(at, SPARSE, SLACK).mean();
    let turns = all_turns().into_iter().chain(turns_about(up));
    let tried = best_starts(turns, &factors, shifts, fits, STARTED);
    let mut refined: Vec<(f64, Similarity)> = tried.into_iter().map(|at| climbed_on(surfaces, at)).collect();
    refined.sort_by(|a, b| b.0.total_cmp(&a.0));
    let simple = |(_, at)| {
        let at = simplest(spots.middle, at, |at| surfaces.agreement(at, FINE, 1.0).mean());
        (surfaces.agreement(at, FINE, 1.0), at)
    };
    refined.into_iter().map(simple).collect()
}

/// Length of the diagonal of a box.
fn size([low, high]: [DVec3; 2]) -> f64 {
    (high - low).length()
}

/// Small changes of the scale and the position of a fitted mesh.
fn changes(spots: &Spots) -> Vec<Similarity> {
    let mut changes = Vec::new();
    for factor in [0.85, 0.92, 1.0 / 0.92, 1.0 / 0.85] {
        let grown = Similarity { scale: factor, ..Similarity::IDENTITY };
        changes.push(grown);
        changes.push(Similarity { offset: spots.middle * (1.0 - factor), ..grown });
    }
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        for side in [-1.0, 1.0] {
            let offset = axis * (side * ASIDE * spots.distance);
            changes.push(Similarity { offset, ..Similarity::IDENTITY });
        }
    }
    changes
}

/// Like [`climbed`], by the agreement of the surfaces.
fn climbed_on(surfaces: &Surfaces<'_>, start: Similarity) -> (f64, Similarity) {
    let (cloud, spots) = (surfaces.cloud, &surfaces.spots);
    let fits = |at: Similarity, slack: f64| surfaces.agreement(at, FITTED, slack).mean();
    let fitted = |at: Similarity, near: bool| Placed { cloud, at }.fitted(spots, step(spots, FITTED), near);
    let first = [start, fitted(start, true), fitted(start, false)].map(|at| (fits(at, 1.0), at));
    let mut best =
        first.into_iter().fold((0.0, start), |best, other| if other.0 > best.0 { other } else { best });
    for _ in 0..CLIMBS {
        let change = |change: Similarity| {
            let at = change.after(&best.1);
            (fits(at, SLACK), at)
        };
        let other = changes(spots).into_iter().map(change).reduce(|a, b| if b.0 > a.0 { b } else { a });
        let Some((_, other)) = other else { break };
        let other = [other, fitted(other, true)].map(|at| (fits(at, 1.0), at));
        let other = if other[0].0 > other[1].0 { other[0] } else { other[1] };
        if other.0 <= best.0 * 1.01 {
            break;
        }
        best = other;
    }
    best
}

/// The simplest transform that fits the points about as well as `found`; see [`simplest`].
fn simplest_of_views(cloud: &Cloud, spots: &Spots, found: Similarity) -> Similarity {
    simplest(spots.middle, found, |at| Placed { cloud, at }.agreement(spots, step(spots, FINE), 1.0))
}

/// The simplest transform that fits about as well as `found`. If possible, its rotation maps axes to axes, its
/// scale is one of [`UNITS`], and its shift is 0. `middle` is the middle of the splats.
fn simplest(middle: DVec3, found: Similarity, fits: impl Fn(Similarity) -> f64) -> Similarity {
    let least = SIMPLER * fits(found);
    let deviation = |a: &DMat3, b: &DMat3| {
        let off = *a - *b;
        off.x_axis.length().max(off.y_axis.length()).max(off.z_axis.length())
    };
    let straight = all_turns().into_iter().find(|turn| deviation(turn, &found.rotation) < SAME_TURN);
    let unit = UNITS.into_iter().find(|unit| (found.scale / unit - 1.0).abs() < SAME_FACTOR);
    // A simpler rotation or scale keeps the middle of the splats in place.
    let centre = found.rotation.transpose() * (middle - found.offset) / found.scale;
    let with = |rotation: DMat3, scale: f64| Similarity {
        rotation,
        scale,
        offset: middle - rotation * centre * scale,
    };
    let mut simpler = Vec::new();
    if let (Some(rotation), Some(scale)) = (straight, unit) {
        simpler.push(Similarity { rotation, scale, offset: DVec3::ZERO });
        simpler.push(with(rotation, scale));
    }
    simpler.extend(straight.map(|rotation| Similarity { rotation, scale: found.scale, offset: DVec3::ZERO }));
    simpler.extend(straight.map(|rotation| with(rotation, found.scale)));
    simpler.extend(unit.map(|scale| with(found.rotation, scale)));
    simpler.into_iter().find(|at| fits(*at) >= least).unwrap_or(found)
}

/// Number of parts of a transform that are not simple: a rotation that does not map axes to axes, a scale that is
/// not in [`UNITS`], and a shift that is not 0. A reflection counts as two.
pub(super) fn parts(by: &Similarity) -> usize {
    let turned = !turns().contains(&by.rotation);
    let mirrored = by.rotation.determinant() < 0.0;
    let scaled = !UNITS.contains(&by.scale);
    [turned, mirrored, scaled, by.offset != DVec3::ZERO].into_iter().filter(|part| *part).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_24_turns() {
        let all = turns();
        assert!(all.len() == 24 && all[0] == DMat3::IDENTITY);
        assert!(all.iter().all(|turn| turn.determinant() == 1.0));
    }
}
