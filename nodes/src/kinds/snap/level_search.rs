//! Which of the levels around an object's foot bears it.

use engine::{Context, NodeError};
use glam::DVec3;

use super::STEEPEST;
use crate::geometry::sampling::hash;

/// Planes that are tried, each level or through three points.
const TRIED: u32 = 400;
/// Fewer points under the foot itself tell no level there.
const FEW: usize = 8;

/// A plane and what it holds.
#[derive(Clone, Copy)]
struct Candidate {
    /// Its height over (0, 0) and its rise along both axes.
    plane: [f64; 3],
    /// Points that it holds.
    held: usize,
    /// Those of them under the foot itself.
    under: usize,
}

/// The points of the level that bears a foot, which reaches `half` along both axes about (0, 0): all those within `near`
/// of a plane. Of levels with at least half as many points under the foot as any has there it is the nearest to 0, and
/// of its planes the one that holds most points; where hardly any point is under the foot, the one of all that does. Of
/// planes that hold as many it is the nearest, and of those the first that is tried.
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
        // Every other plane is level, which is what most ground is.
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
    // Other planes near by hold more of the same rough surface, up to its middle.
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

/// The plane through three points; none where it is steep.
fn through(points: [[f64; 3]; 3]) -> Option<[f64; 3]> {
    let [a, b, c] = points.map(DVec3::from_array);
    let normal = (b - a).cross(c - a).try_normalize().filter(|n| n.z.abs() >= STEEPEST)?;
    let rise = normal.truncate() / -normal.z;
    Some([a.z - rise.dot(a.truncate()), rise.x, rise.y])
}

/// Height of a point over a plane.
fn off(plane: &[f64; 3], point: &[f64; 3]) -> f64 {
    point[2] - plane[0] - plane[1] * point[0] - plane[2] * point[1]
}
