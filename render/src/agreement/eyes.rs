//! Views in which splats and mesh are compared, and the eyes of those around the inserted objects.
//!
//! The middle of a small object is so near to the ground that splats there appear as large spots in front of what is
//! behind them, and that the usual distance between mesh and splats is a large part of the depth. The middle of an
//! object that is too low is in the ground. The eye is therefore moved up to a position in free space.

use engine::{Context, NodeError};
use glam::DVec3;
use scene::types::{Camera, Splats};

use super::sight::Sight;
use super::spots::OPAQUE;
use crate::geometry::support::median;
use crate::splat::Blocks;

/// Distance from the eye, in standard deviations of a splat along its middle axis, within which the splat is too near.
/// Nearer splats are drawn as ellipses that are too large.
const GRAINS: f64 = 5.0;
/// Distance from the eye within which any splat is too near, as a share of the median distance of the surfaces in the
/// wanted views. It exceeds the usual distance between mesh and splats.
const CLEARANCE: f64 = 0.1;
/// Maximum distance at which a splat can be too near because of its size, as a share of the same median distance.
/// The backdrop of a capture has large splats in all directions.
const BACKDROP: f64 = 0.5;
/// Minimum share of the directions that splats which are too near must cover for the eye not to be in free space.
const COVERED: f64 = 0.1;
/// Number of steps by which the eye is moved up at most.
const STEPS: u32 = 32;
/// Length of a step, as a share of the same median distance.
const STEP: f64 = 0.025;

/// A splat that is too near to some of the positions.
struct Near {
    /// Centre relative to the middle of the object.
    centre: DVec3,
    /// Distance within which the splat is too near.
    reach: f64,
    /// Share of the directions that the splat covers, multiplied by the square of its distance.
    area: f64,
}

/// Renders the splats in the wanted views and around each of the objects with the middles `middles`, from free space
/// (see [`free`]). Objects without free space above them are left out. `frame` is the unit vectors to the right,
/// forward and up, and the number of world units per metre.
pub(super) fn sights(
    splats: &Splats,
    cameras: &[Camera],
    middles: &[DVec3],
    frame: ([DVec3; 3], f64),
    cx: &Context,
) -> Result<Vec<Sight>, NodeError> {
    let blocks = Blocks::of(splats, cx)?;
    let mut sights = Sight::wanted(splats, &blocks, cameras, frame.1, cx)?;
    let up = frame.0[2];
    let eyes: Vec<DVec3> = middles.iter().filter_map(|middle| free(splats, &sights, *middle, up)).collect();
    for eye in eyes {
        sights.extend(Sight::around(splats, &blocks, eye, frame, cx)?);
    }
    Ok(sights)
}

/// Returns the lowest position in free space above `point`, the middle of an object. Positions that at least one of the
/// views in `wanted` sees, with no surface in front of them, are preferred. `None` if there is no free space above the
/// object. `up` is a unit vector.
fn free(splats: &Splats, wanted: &[Sight], point: DVec3, up: DVec3) -> Option<DVec3> {
    let unit = distance(splats, wanted, point)?;
    let length = STEP * f64::from(STEPS) * unit;
    let near = |i: usize| {
        let [a, b, c] = splats.scales[i].map(f64::from);
        let size = a.max(b).min(a.min(b).max(c));
        let reach = (GRAINS * size).min(BACKDROP * unit).max(CLEARANCE * unit);
        let centre = splats.mean(i) - point;
        let lowest = centre - up * centre.dot(up).clamp(0.0, length);
        let area = 0.25 * f64::from(splats.opacities[i]) * size * size;
        (lowest.length_squared() < reach * reach).then_some(Near { centre, reach, area })
    };
    let opaque = (0..splats.len()).filter(|&i| splats.opacities[i] >= OPAQUE);
    let all: Vec<Near> = opaque.filter_map(near).collect();
    let covered = |at: DVec3| -> f64 {
        let own = all.iter().map(|splat| (splat, (splat.centre - at).length_squared()));
        let own = own.filter(|(splat, square)| *square < splat.reach * splat.reach);
        own.map(|(splat, square)| (splat.area / square).min(1.0)).sum()
    };
    let steps = (0..=STEPS).map(|step| up * (STEP * unit * f64::from(step)));
    let free: Vec<DVec3> = steps.filter(|at| covered(*at) < COVERED).map(|at| point + at).collect();
    let seen = free.iter().find(|at| wanted.iter().any(|sight| sight.sees(**at)));
    seen.or_else(|| free.first()).copied()
}

/// Median distance from the eyes of the wanted views to the surfaces that they show; without such surfaces, from the
/// point to the splats.
fn distance(splats: &Splats, wanted: &[Sight], point: DVec3) -> Option<f64> {
    let of_sight = |sight: &Sight| {
        let clear: Vec<usize> = (0..sight.depth.len()).filter(|&pixel| sight.clear[pixel]).collect();
        clear.into_iter().map(|pixel| sight.depth[pixel] * sight.ray(pixel).length()).collect::<Vec<_>>()
    };
    let step = (splats.len() / 1000).max(1);
    let far = || (0..splats.len()).step_by(step).map(|i| (splats.mean(i) - point).length()).collect();
    median(wanted.iter().flat_map(of_sight).collect()).or_else(|| median(far()))
}
