//! Fit of a plane to the floor. The normal of the plane is the up direction.

use glam::DVec3;

use super::axes::across;
use super::patch::{Patch, Patches};
use super::profile::Profile;
use crate::geometry::support::GroundPlane;

/// Number of iterations of the fit. Each iteration uses only points that are closer to the plane than in the
/// previous iteration.
const ROUNDS: usize = 4;
/// Maximum slope of a floor whose normal is used as `up`, as rise over run: 8 degrees.
const STEEP: f64 = 0.14;
/// Minimum share of the plan of a scene that a layer must cover to count as a ceiling.
const CEILING_COVER: f64 = 0.3;

/// The orientation of a scene, with its floor and ceiling.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stand {
    pub up: DVec3,
    pub floor: f64,
    pub floor_confidence: f64,
    pub ceiling: Option<f64>,
}

impl Stand {
    /// Replaces the up direction. The floor keeps its height at the point `centre`.
    pub fn turn_to(&mut self, up: DVec3, centre: DVec3) {
        self.floor += centre.dot(up) - centre.dot(self.up);
        self.up = up;
    }
}

/// Fits a plane to the floor that a profile found.
pub(super) fn refine(patches: &Patches, profile: &Profile) -> Stand {
    let [x, y] = across(profile.up);
    let mut band = (0.03 * profile.height().max(0.2 * patches.radius)).min(0.05 * patches.radius);
    let mut plane = GroundPlane {
        height: profile.floor - patches.centre.dot(profile.up),
        slope: [0.0; 2],
        roughness: 0.0,
    };
    let local = |p: &Patch| {
        let v = p.middle - patches.centre;
        [v.dot(x), v.dot(y), v.dot(profile.up)]
    };
    let mut count = 0;
    for _ in 0..ROUNDS {
        let near: Vec<[f64; 3]> = patches
            .core
            .iter()
            .filter(|p| p.normal.is_some_and(|n| n.dot(profile.up).abs() > 0.9))
            .map(local)
            .filter(|&[px, py, h]| (h - plane.at(px, py)).abs() < band)
            .collect();
        let Some(next) = GroundPlane::of(&near) else { break };
        if next.slope.iter().any(|s| s.abs() > STEEP) {
            break;
        }
        (plane, count) = (next, near.len());
        band *= 0.6;
    }
    let up = (profile.up - x * plane.slope[0] - y * plane.slope[1]).normalize();
    let floor = patches.centre.dot(up) + plane.height * profile.up.dot(up);
    // A floor is wide compared with the plan.
    let wide = (profile.cover / 0.25).min(1.0);
    let thick = (profile.ground / 0.02).min(1.0);
    let floor_confidence = if count == 0 { 0.0 } else { 0.99 * wide * thick };
    let covered = profile.lid_cover > CEILING_COVER && profile.lid > 0.3 * profile.ground;
    let ceiling = (covered && profile.height() > 0.1 * patches.radius).then_some(profile.top);
    Stand { up, floor, floor_confidence, ceiling }
}
