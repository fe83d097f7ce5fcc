//! Search for the level around an object's foot that supports the object.

use engine::{Context, NodeError};
use glam::DVec3;
use render::geometry::sampling::hash;

use super::ground::STEEPEST;

/// Number of planes that are tried, each horizontal or through three points.
const TRIED: u32 = 400;
/// Minimum number of points directly below the foot that is needed to determine a level from them.
const FEW: usize = 8;

/// Plane and the number of points on it.
#[derive(Clone, Copy)]
struct Candidate {
    /// Height at (0, 0), and slope along both axes.
    plane: [f64; 3],
    /// Number of points on the plane.
    held: usize,
    /// Number of points on the plane that lie directly below the foot.
    under: usize,
}

/// Finds the level that supports a foot, and returns its points. The foot extends `half` along both axes around (0,
/// 0), and its base is at height 0. A level consists of all points within `near` of a plane. A level qualifies if
/// it has at least half as many points below the foot as the level with the most points below the foot; if hardly
/// any points lie below the foot, every level qualifies. Of the levels that qualify, the level nearest to height 0
/// is taken, at the plane that contains most of its points. If several planes contain equally many points, the
/// plane nearest to height 0 is taken, and if several are equally near, the first that was tried.
pub(super) fn bearing(
    points: &[[f64; 3]],
    half: [f64; 2],
    near: f64,
    cx: &Context,
) -> Result<Vec<[f64; 3]>, NodeError> {
    let mut candidates = Vec::with_capacity(TRIED as usize);
    for k in 0..TRIED {
        cx.check()?;
        let some = |i| points.get(((u64::from(hash(k, i)) * points.len() as u64) >> 32) as usize).copied();
        let [Some(a), Some(b), Some(c)] = [some(0), some(1), some(2)] else { break };
        // Every other plane is horizontal, as most ground is.
        let plane =
            if k % 2 == 0 { [a[2], 0.0, 0.0] } else { through([a, b, c]).unwrap_or([a[2], 0.0, 0.0]) };
        let (mut held, mut under) = (0, 0);
        for point in points.iter().filter(|point| off(&plane, point).abs() <= near) {
            held += 1;
            under += usize::from(point[0].abs() <= half[0] && point[1].abs() <= half[1]);
        }
        candidates.push(Candidate { plane, held, under });
    }
    let most = candidates.iter().map(|candidate| candidate.under).max().unwrap_or(0);
    candidates.retain(|candidate| most < FEW || 2 * candidate.under >= most);
    let height = |candidate: &Candidate| candidate.plane[0];
    let better = |best: Candidate, next: Candidate| {
        let nearer = height(&next).abs() < height(&best).abs();
        if next.held > best.held || (next.held == best.held && nearer) { next } else { best }
    };
    let nearer = |a: Candidate, b: Candidate| if height(&b).abs() < height(&a).abs() { b } else { a };
    let mut best = candidates.iter().copied().reduce(nearer);
    let reach = if most < FEW { f64::INFINITY } else { 2.0 * near };
    // Other planes nearby contain more of the same rough surface, up to its middle.
    while let Some(last) = best {
        let of_level = |next: &&Candidate| (height(next) - height(&last)).abs() <= reach;
        best = candidates.iter().filter(of_level).copied().reduce(better);
        if best.is_none_or(|best| best.held <= last.held) {
            break;
        }
    }
    let Some(best) = best else { return Ok(Vec::new()) };
    Ok(points.iter().filter(|point| off(&best.plane, point).abs() <= near).copied().collect())
}

/// Plane through three points. `None` if it is steep.
fn through(points: [[f64; 3]; 3]) -> Option<[f64; 3]> {
    let [a, b, c] = points.map(DVec3::from_array);
    let normal = (b - a).cross(c - a).try_normalize().filter(|n| n.z.abs() >= STEEPEST)?;
    let rise = normal.truncate() / -normal.z;
    Some([a.z - rise.dot(a.truncate()), rise.x, rise.y])
}

/// Height of a point above a plane.
fn off(plane: &[f64; 3], point: &[f64; 3]) -> f64 {
    point[2] - plane[0] - plane[1] * point[0] - plane[2] * point[1]
}
