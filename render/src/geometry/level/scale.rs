//! Estimate of the length of a world unit, from the height of the ceiling or of the cameras.

use scene::types::Rig;
use serde::Serialize;

use super::patch::Patches;
use super::refine::Stand;
use crate::geometry::support::median;

/// Range of heights above the floor at which people hold a camera, in metres. If the measured height is outside the
/// range, the true height is assumed to be the middle of the range.
const HELD: [f64; 2] = [1.1, 1.9];
/// Range of usual heights of rooms, in metres. If the measured height is outside the range, the true height is
/// assumed to be the middle of the range.
const ROOM: [f64; 2] = [2.2, 3.4];

/// Estimated length of a world unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scale {
    /// Metres per world unit; `None` if unknown.
    pub metres_per_unit: Option<f64>,
    /// Estimated probability that `metres_per_unit` is correct within 20 %, 0 to 1.
    pub confidence: f64,
    /// The evidence in words, such as "the ceiling is 2.69 units above the floor".
    pub reason: String,
}

impl Scale {
    fn unknown(reason: &str) -> Self {
        Self { metres_per_unit: None, confidence: 0.0, reason: reason.to_owned() }
    }
}

/// Estimates the scale from the height of the ceiling, or else from the height of the cameras. If this height is
/// plausible in metres, the unit is assumed to be a metre.
pub(super) fn scale(stand: &Stand, patches: &Patches, cameras: Option<&Rig>) -> Scale {
    let of = |length: f64, [least, most]: [f64; 2], what: &str, chances: [f64; 2]| {
        let fits = (least..=most).contains(&length);
        let metres = if fits { 1.0 } else { (least + most) * 0.5 / length };
        let confidence = chances[usize::from(fits)];
        Scale {
            metres_per_unit: Some(metres),
            confidence,
            reason: format!("{what} {length:.3} units above the floor"),
        }
    };
    let heights =
        cameras.map(|rig| rig.cameras.iter().map(|c| c.eye().dot(stand.up) - stand.floor).collect());
    let held = heights.and_then(median).filter(|h| *h > 1e-3 * patches.radius);
    let room = stand.ceiling.map(|ceiling| ceiling - stand.floor);
    match (room, held) {
        (Some(room), _) => of(room, ROOM, "the ceiling is", [0.5, 0.8]),
        (None, Some(held)) => of(held, HELD, "the cameras are", [0.3, 0.6]),
        (None, None) => Scale::unknown("there is no ceiling, and no camera above the floor"),
    }
}
