//! Estimates of the up direction, the floor and the scale of a capture.

mod axes;
mod candidate;
mod patch;
mod profile;
mod refine;
mod reliable;
mod rig;
mod scale;
#[cfg(test)]
mod tests;

use glam::{DMat3, DVec3};
use scene::math::num;
use scene::types::{Mesh, Rig, Splats};
use serde::Serialize;

use candidate::{Candidate, LAYERED};
use patch::Patches;
use profile::profile;
use reliable::{LEAST_LAYERING, LEAST_OBSERVATIONS, is_reliable};

pub use patch::rotation;
pub use profile::Evidence;
pub use scale::Scale;

/// Maximum number of axes that are considered as candidates for the vertical.
const AXES: usize = 6;
/// Maximum number of splats of a sample.
const SAMPLED: usize = 1 << 16;
/// Minimum confidence of a reliable direction.
pub const SURE: f64 = 0.95;
/// Largest confidence of an estimate from splats alone.
const MOST: f64 = 0.99;

/// An estimate of the orientation, floor and scale of a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LevelEstimate {
    /// Unit vector that points up, in the frame of the scene.
    pub up: [f64; 3],
    /// Estimated probability that `up` is correct within 5 degrees, 0 to 1.
    pub confidence: f64,
    /// Height of the floor along `up`, in world units.
    pub floor: f64,
    /// Estimated probability that `floor` is the height of the floor, 0 to 1.
    pub floor_confidence: f64,
    /// Height of the ceiling along `up`, in world units. `None` if there is no ceiling.
    pub ceiling: Option<f64>,
    /// Centre of the scene, in world units.
    pub centre: [f64; 3],
    /// Radius of the scene around its centre, without the background, in world units.
    pub radius: f64,
    /// Evidence that `up`, and not the opposite direction, points up.
    pub evidence: Evidence,
    /// True if cameras contributed to the estimate.
    pub by_cameras: bool,
    /// The scale of the scene.
    pub scale: Scale,
}

impl LevelEstimate {
    /// The axis, such as `+z`, that is within 2.5 degrees of `up`. `None` if there is no such axis.
    pub fn axis(&self) -> Option<&'static str> {
        const NAMES: [[&str; 2]; 3] = [["-x", "+x"], ["-y", "+y"], ["-z", "+z"]];
        (0..3).find(|&k| self.up[k].abs() > 0.999).map(|k| NAMES[k][usize::from(self.up[k] > 0.0)])
    }

    /// The point of the floor below the centre of the scene, in world units.
    pub fn floor_point(&self) -> DVec3 {
        let (up, centre) = (DVec3::from_array(self.up), DVec3::from_array(self.centre));
        centre + up * (self.floor - centre.dot(up))
    }

    /// True if `up` is reliable.
    pub fn is_sure(&self) -> bool {
        self.confidence >= SURE
    }

    /// True if the height of the floor is reliable.
    pub fn is_floor_sure(&self) -> bool {
        self.is_sure() && self.floor_confidence >= SURE
    }

    /// The smallest rotation that maps `up` to a wanted direction.
    pub fn turn_to(&self, wanted: DVec3) -> DMat3 {
        turn(DVec3::from_array(self.up), wanted)
    }
}

/// The smallest rotation that maps the up direction of the cameras of a capture to `up`, and true if their up direction
/// is certain. It is false if all cameras were held on their side, so that up and down may be exchanged. `None` if there
/// are fewer than three cameras, or if they were not held level.
pub fn upright_cameras(cameras: &Rig, up: DVec3) -> Option<(DMat3, bool)> {
    rig::held(cameras).map(|held| (turn(held.up, up), held.signed))
}

/// The smallest rotation that maps one unit vector to another.
fn turn(from: DVec3, to: DVec3) -> DMat3 {
    let cosine = from.dot(to);
    if cosine < -1.0 + 1e-12 {
        let [axis, _] = axes::across(from);
        // Half a turn.
        return DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z) * 2.0 - DMat3::IDENTITY;
    }
    let v = from.cross(to);
    let cross =
        DMat3::from_cols(DVec3::new(0.0, v.z, -v.y), DVec3::new(-v.z, 0.0, v.x), DVec3::new(v.y, -v.x, 0.0));
    DMat3::IDENTITY + cross + cross * cross * (1.0 / (1.0 + cosine))
}

/// Estimates the orientation, floor and scale of a scene of splats. `cameras` are the cameras of its capture in the
/// frame of the splats, if they are known. Returns `None` if there are too few visible splats. The result is the
/// same on every machine.
pub fn of_splats(splats: &Splats, cameras: Option<&Rig>) -> Option<LevelEstimate> {
    estimate(&Patches::of_splats(splats), cameras)
}

/// Same as [`of_splats`] without cameras, from up to 65,536 of the splats, so that the time is small for any scene.
pub fn of_sample(splats: &Splats) -> Option<LevelEstimate> {
    let step = splats.len().div_ceil(SAMPLED).max(1);
    let few = || (0..splats.len()).step_by(step);
    let width = splats.sh_len();
    let sample = Splats {
        means: few().map(|i| splats.means[i]).collect(),
        means_low: few().filter_map(|i| splats.means_low.get(i).copied()).collect(),
        quats: few().map(|i| splats.quats[i]).collect(),
        scales: few().map(|i| splats.scales[i]).collect(),
        opacities: few().map(|i| splats.opacities[i]).collect(),
        sh_degree: 0,
        sh: few().filter_map(|i| splats.sh.get(i * width).copied()).collect(),
        encoding: splats.encoding,
        antialiased: splats.antialiased,
    };
    of_splats(&sample, None)
}

/// Estimates the orientation, floor and scale of a place from its mesh.
pub fn of_mesh(mesh: &Mesh, cameras: Option<&Rig>) -> Option<LevelEstimate> {
    estimate(&Patches::of_mesh(mesh), cameras)
}

/// Estimates floor, ceiling and scale of a scene of splats whose up direction is given, for example by the format
/// of its file. The up direction is also estimated from the splats. If the estimate is within 5 degrees of `up`,
/// the result has the confidence of the estimate; otherwise its confidence is 0.
pub fn upright(splats: &Splats, up: DVec3, cameras: Option<&Rig>) -> Option<LevelEstimate> {
    let patches = Patches::of_splats(splats);
    let measured = estimate(&patches, cameras)?;
    let profile = profile(&patches, up);
    let mut found = refine::refine(&patches, &profile);
    found.turn_to(up, patches.centre);
    let agrees = DVec3::from_array(measured.up).dot(up) > 0.9962;
    let confidence = if agrees { measured.confidence } else { 0.0 };
    Some(LevelEstimate {
        up: up.to_array(),
        confidence,
        floor: found.floor,
        floor_confidence: found.floor_confidence.min(if agrees { 1.0 } else { 0.5 }),
        ceiling: found.ceiling,
        evidence: profile.evidence(),
        scale: scale::scale(&found, &patches, cameras),
        ..measured
    })
}

fn estimate(patches: &Patches, cameras: Option<&Rig>) -> Option<LevelEstimate> {
    if patches.core.len() < 3 || patches.radius <= 0.0 {
        return None;
    }
    let axes = axes::candidates(&patches.core, patches.centre, patches.radius, AXES);
    let strongest = axes.first()?.layering;
    let mut candidates: Vec<Candidate> = Vec::new();
    for one in &axes {
        // The normal of the plane fitted to the largest layer is more exact than the axis.
        let [a, b] = [one.axis, -one.axis].map(|up| profile(patches, up));
        let first = if a.ground >= b.ground { a } else { b };
        let axis = refine::refine(patches, &first).up;
        for up in [axis, -axis] {
            let profile = profile(patches, up);
            let layered = LAYERED * num::f64::ln((one.layering / strongest).max(1e-9));
            candidates.push(Candidate {
                odds: layered + profile.evidence().sum(),
                layering: one.layering,
                profile,
            });
        }
    }
    let held = cameras.and_then(rig::held);
    if let Some(held) = &held {
        rig::weigh(held, patches, &mut candidates);
    }
    candidates.sort_by(|a, b| b.odds.total_cmp(&a.odds));
    let best = &candidates[0];
    let sum: f64 = candidates.iter().map(|c| num::f64::exp((c.odds - best.odds).max(-700.0))).sum();
    let mut confidence = (1.0 / sum).min(MOST);
    let seen = held.as_ref().is_some_and(|held| held.agrees(best.profile.up));
    // Odds are not reliable if there is little evidence.
    if !seen {
        confidence *= (best.layering / LEAST_LAYERING).min(1.0);
        confidence *= (best.profile.observations / LEAST_OBSERVATIONS).min(1.0);
    }
    let mut found = refine::refine(patches, &best.profile);
    // A floor that is not reliable may lean. Cameras that were held level then give the more exact vertical.
    let is_clear = is_reliable(best.layering, &best.profile);
    if let Some(held) = held.filter(|held| seen && !is_clear && held.is_exact()) {
        let up = if held.up.dot(found.up) < 0.0 { -held.up } else { held.up };
        found.turn_to(up, patches.centre);
    }
    let ceiling = found.ceiling;
    Some(LevelEstimate {
        up: found.up.to_array(),
        confidence,
        floor: found.floor,
        floor_confidence: confidence.min(found.floor_confidence),
        ceiling,
        centre: patches.centre.to_array(),
        radius: patches.radius,
        evidence: best.profile.evidence(),
        by_cameras: seen,
        scale: scale::scale(&found, patches, cameras),
    })
}
