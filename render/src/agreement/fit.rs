//! Fits a mesh to points by the iterative closest point algorithm (Besl and McKay 1992), with distances from points
//! to planes (Chen and Medioni 1992). The fit includes a scale. Points far from the mesh have little or no weight.

use glam::{DMat3, DQuat, DVec3};
use scene::types::frame::Similarity;

use super::cloud::Placed;
use super::spots::{Spots, kernel};

/// Maximum distance between paired points in each iteration, as a share of the median distance of the points from
/// the eye.
const GATES: [f64; 14] = [0.4, 0.4, 0.35, 0.3, 0.25, 0.2, 0.17, 0.14, 0.12, 0.1, 0.09, 0.08, 0.07, 0.06];
/// Index in `GATES` of the first iteration if the cloud is nearly in place, so that larger distances are skipped.
const NEAR: usize = 5;
/// Value added to the diagonal of the system of equations, as a share of its mean diagonal element. It keeps the
/// solution close to 0 along directions that the points do not determine.
const DAMPING: f64 = 2e-3;
/// Minimum absolute cosine between the two normals of a pair.
const ALIGNED: f64 = 0.7;

impl Placed<'_> {
    /// Nearest point of the cloud to the point `to`, and its normal, all in world coordinates; `None` if no point
    /// is within the distance `within`.
    fn nearest(&self, to: DVec3, within: f64) -> Option<(DVec3, DVec3)> {
        let Similarity { rotation, scale, offset } = self.at;
        let local = rotation.transpose() * (to - offset) / scale;
        let (point, normal) = self.cloud.points[self.cloud.nearest(local, within / scale)?];
        Some((self.at.point(point), rotation * normal))
    }

    /// Mean agreement of every `step`-th point with the cloud, 0 to 1. Tolerances are multiplied by `slack`.
    pub fn agreement(&self, spots: &Spots, step: usize, slack: f64) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        let gap = 1.5 * self.cloud.spacing * self.at.scale;
        for spot in spots.list.iter().step_by(step) {
            total += spot.weight;
            let tolerance = slack * spot.tolerance;
            // In a coarse cloud the nearest point may be farther away than the tolerance. Its plane may still be
            // near.
            let Some((point, normal)) = self.nearest(spot.point, tolerance.max(gap.min(3.0 * tolerance)))
            else {
                continue;
            };
            if spot.normal.is_none_or(|own| own.dot(normal).abs() >= ALIGNED) {
                sum += spot.weight * kernel((spot.point - point).dot(normal) / tolerance);
            }
        }
        sum / total
    }

    /// Refines the transform so that the cloud fits every `step`-th point. If `near` is true, the iterations with
    /// the largest distances between paired points are skipped, because the cloud is nearly in place.
    pub fn fitted(mut self, spots: &Spots, step: usize, near: bool) -> Similarity {
        let unit = spots.distance;
        let first = if near { NEAR } else { 0 };
        for gate in GATES.into_iter().skip(first).map(|share| share * unit) {
            let mut system = [[0.0; 8]; 7];
            for spot in spots.list.iter().step_by(step) {
                let Some((point, normal)) = self.nearest(spot.point, gate) else { continue };
                if spot.normal.is_some_and(|own| own.dot(normal).abs() < ALIGNED) {
                    continue;
                }
                let off = (spot.point - point).dot(normal) / unit;
                let arm = (point - spots.middle) / unit;
                let turn = arm.cross(normal);
                let row = [turn.x, turn.y, turn.z, normal.x, normal.y, normal.z, normal.dot(arm)];
                let weight = spot.weight * kernel(off * unit / gate);
                for i in 0..7 {
                    for j in 0..7 {
                        system[i][j] += weight * row[i] * row[j];
                    }
                    system[i][7] += weight * row[i] * off;
                }
            }
            let Some([a, b, c, x, y, z, grown]) = solved(system) else { return self.at };
            let turn = DVec3::new(a, b, c).clamp_length_max(0.3) * 0.5;
            let rotation = DMat3::from_quat(DQuat::from_xyzw(turn.x, turn.y, turn.z, 1.0).normalize());
            let scale = 1.0 + grown.clamp(-0.2, 0.2);
            let shift = DVec3::new(x, y, z).clamp_length_max(0.3) * unit;
            let offset = spots.middle - rotation * spots.middle * scale + shift;
            self.at = Similarity { rotation, scale, offset }.after(&self.at);
        }
        self.at
    }
}

/// Solution of a symmetric system of seven equations, with damping; `None` if the system is zero or not finite.
fn solved(mut system: [[f64; 8]; 7]) -> Option<[f64; 7]> {
    let mean = (0..7).map(|i| system[i][i]).sum::<f64>() / 7.0;
    if !(mean > 0.0 && mean.is_finite()) {
        return None;
    }
    (0..7).for_each(|i| system[i][i] += DAMPING * mean);
    for i in 0..7 {
        let pivot = system[i];
        for row in system.iter_mut().skip(i + 1) {
            let factor = row[i] / pivot[i];
            (i..8).for_each(|k| row[k] -= factor * pivot[k]);
        }
    }
    let mut found = [0.0; 7];
    for i in (0..7).rev() {
        let known: f64 = (i + 1..7).map(|k| system[i][k] * found[k]).sum();
        found[i] = (system[i][7] - known) / system[i][i];
    }
    found.iter().all(|value| value.is_finite()).then_some(found)
}
