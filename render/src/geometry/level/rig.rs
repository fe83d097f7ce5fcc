//! Estimate of the up direction from the cameras of a capture. It assumes that people hold cameras level.

use glam::{DMat3, DVec3};
use scene::math::num;
use scene::types::Rig;

use super::candidate::{Candidate, LAYERED};
use super::patch::Patches;
use super::profile::profile;
use super::reliable::is_reliable;

/// Minimum number of cameras.
const FEWEST: usize = 3;
/// Cosine of 20 degrees. The cameras and the surfaces agree if their verticals are within this angle.
const AGREE: f64 = 0.94;
/// Evidence for the up direction from [`FEWEST`] cameras that are exactly level, as a logarithm of odds.
const COUNT: f64 = 5.0;
/// Maximum factor by which the evidence grows with the number of cameras. The errors of cameras that one person held
/// are not independent.
const MOST_EVIDENCE: f64 = 2.5;
/// Minimum value of `level` at which the mean of the cameras is within a few degrees of the vertical: their horizontal
/// axes are level to 2 degrees (root mean square).
const EXACT: f64 = 0.85;

/// The vertical as estimated from the cameras.
#[derive(Debug, Clone, Copy)]
pub(super) struct Held {
    /// The up direction. It may point down if `signed` is false.
    pub up: DVec3,
    /// False if all cameras were held on their side, in which case the sign of the direction is unknown.
    pub signed: bool,
    /// Degree to which the cameras were held level, 0 to 1.
    pub level: f64,
    /// Number of cameras.
    pub count: usize,
}

impl Held {
    /// True if the direction is more exact than that of a floor that is not reliable.
    pub fn is_exact(&self) -> bool {
        self.level >= EXACT
    }

    /// True if the direction is within 20 degrees of `up`.
    pub fn agrees(&self, up: DVec3) -> bool {
        let cosine = self.up.dot(up);
        (if self.signed { cosine } else { cosine.abs() }) > AGREE && self.level > 0.5
    }
}

/// Finds the direction that is most nearly perpendicular to all axes, and the second-best direction, which is
/// perpendicular to the first. Returns the first direction, then the root mean square of the cosines between the
/// first direction and the axes, then that value for the second direction.
fn least(axes: &[DVec3]) -> (DVec3, f64, f64) {
    let mut m = DMat3::ZERO;
    for &a in axes {
        m += DMat3::from_cols(a * a.x, a * a.y, a * a.z);
    }
    let m = m * (1.0 / axes.len() as f64);
    // The eigenvector of `m` with the smallest eigenvalue is that of the identity minus `m` with the largest; the
    // next one follows by deflation.
    let power = |m: DMat3| {
        let mut v = DVec3::new(0.577, 0.578, 0.576).normalize();
        for _ in 0..200 {
            let next = m * v;
            if next.length() < 1e-12 {
                break;
            }
            v = next.normalize();
        }
        v
    };
    let rest = DMat3::IDENTITY - m;
    let first = power(rest);
    let value = first.dot(m * first);
    let without = rest - DMat3::from_cols(first * first.x, first * first.y, first * first.z) * (1.0 - value);
    let second = power(without);
    (first, value.max(0.0).sqrt(), second.dot(m * second).max(0.0).sqrt())
}

/// Estimates the vertical from the cameras of a rig. `None` if there are too few cameras, or if they were not held
/// level.
pub(super) fn held(rig: &Rig) -> Option<Held> {
    let count = rig.cameras.len();
    if count < FEWEST {
        return None;
    }
    let axis = |k: usize| -> Vec<DVec3> {
        rig.cameras.iter().map(|c| DMat3::from_mat4(c.world_from_camera()).col(k).normalize()).collect()
    };
    let (rights, downs) = (axis(0), axis(1));
    let mean = |of: &[DVec3]| of.iter().fold(DVec3::ZERO, |sum, v| sum + *v) / of.len() as f64;
    // If cameras are held upright, their right axes are level. If they are held on their side, their down axes are.
    let (upright, sideways) = (least(&rights), least(&downs));
    let up = -mean(&downs);
    let side = mean(&rights);
    // The vertical is perpendicular to all level axes. If all of these point the same way, it is found by the mean
    // only.
    let found = |(axis, least, next): (DVec3, f64, f64), towards: DVec3| {
        let axis = if next > 3.0 * least && next > 0.2 { axis } else { towards.normalize() };
        let axis = if axis.dot(towards) < 0.0 { -axis } else { axis };
        (axis, (1.0 - 4.0 * least).max(0.0) * towards.length().min(1.0))
    };
    let (a, level_a) = found(upright, up);
    let (b, level_b) = found(sideways, side);
    if upright.2 <= 0.2 && sideways.2 <= 0.2 {
        // All cameras look the same way, so the only evidence is how they were held.
        return Some(Held { up: up.normalize(), signed: true, level: 0.5 * level_a.max(0.0), count });
    }
    let held = if level_a >= level_b {
        Held { up: a, signed: true, level: level_a, count }
    } else {
        Held { up: b, signed: false, level: level_b, count }
    };
    (held.level > 0.1 && held.up.is_finite()).then_some(held)
}

/// Adds the evidence of the cameras to each candidate. If no candidate agrees with the vertical of the cameras,
/// this vertical is added as a candidate.
pub(super) fn weigh(held: &Held, patches: &Patches, candidates: &mut Vec<Candidate>) {
    if candidates.iter().all(|c| c.profile.up.dot(held.up) < AGREE) {
        let least = candidates.iter().map(|c| c.layering).fold(f64::INFINITY, f64::min);
        let most = candidates.iter().map(|c| c.layering).fold(1e-12, f64::max);
        for up in [held.up, -held.up] {
            let profile = profile(patches, up);
            let odds = LAYERED * num::f64::ln((least / most).max(1e-9)) * 0.5 + profile.evidence().sum();
            candidates.push(Candidate { odds, layering: least, profile });
        }
    }
    // Next to a clear floor, cameras may be in another frame, whatever their number.
    let is_clear = candidates.iter().any(|c| is_reliable(c.layering, &c.profile));
    let more = 1.0 + 0.5 * num::f64::ln(held.count as f64 / FEWEST as f64);
    let evidence = COUNT * held.level * if is_clear { 1.0 } else { more.min(MOST_EVIDENCE) };
    for c in candidates {
        let cosine = held.up.dot(c.profile.up);
        let cosine = if held.signed { cosine } else { cosine.abs() };
        c.odds += evidence * ((cosine - 0.5) * 2.0).clamp(-1.0, 1.0);
    }
}
