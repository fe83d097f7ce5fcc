//! Search for axes that may be the vertical of a scene. A large share of the surface lies in layers perpendicular
//! to such an axis.

use glam::DVec3;
use scene::math::num;

use super::patch::Patch;

/// Number of directions that are tested. They cover half a sphere and are about 2.5 degrees apart.
const DIRECTIONS: usize = 3000;
/// Number of patches that are used to test a direction.
const SAMPLED: usize = 20_000;
/// Number of layers into which the scene is divided along an axis.
const LAYERS: usize = 64;
/// Cosine of 15 degrees. Two axes with a smaller angle between them count as one axis.
const APART: f64 = 0.966;

/// Unit vectors spread evenly over half a sphere (a Fibonacci lattice).
pub(super) fn half_sphere(count: usize) -> impl Iterator<Item = DVec3> {
    let golden = std::f64::consts::PI * (5.0_f64.sqrt() - 1.0);
    (0..count).map(move |i| {
        let z = (i as f64 + 0.5) / count as f64;
        let (sin, cos) = num::sin_cos(golden * i as f64);
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * cos, r * sin, z)
    })
}

/// Selects every n-th patch, where n is such that at most `most` patches are selected.
fn sample(patches: &[Patch], most: usize) -> Vec<Patch> {
    patches.iter().step_by(patches.len().div_ceil(most).max(1)).copied().collect()
}

/// Measures how much the surface is concentrated in few layers perpendicular to an axis. The share of a layer is
/// the part of all surface that lies flat in it. The result is the square root of the sum of the squared shares.
fn layering(patches: &[Patch], axis: DVec3, centre: DVec3, radius: f64) -> f64 {
    let mut layers = [0.0; LAYERS + 2];
    let (mut total, per) = (0.0, LAYERS as f64 / (2.0 * radius));
    for patch in patches {
        total += patch.weight;
        let flat = match patch.normal {
            Some(normal) => {
                let c = normal.dot(axis);
                // 1 at 0 degrees, a half at 16, 0 at 26.
                ((c * c - 0.8) * 5.0).max(0.0)
            }
            None => 0.15,
        };
        if flat > 0.0 {
            let at = ((patch.middle - centre).dot(axis) + radius) * per;
            let low = at.floor();
            let share = at - low;
            let low = (low.max(0.0) as usize).min(LAYERS);
            layers[low] += patch.weight * flat * (1.0 - share);
            layers[low + 1] += patch.weight * flat * share;
        }
    }
    if total > 0.0 { layers.iter().map(|v| v * v).sum::<f64>().sqrt() / total } else { 0.0 }
}

/// An axis, whose sign is arbitrary, and the concentration of surface in layers perpendicular to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis {
    pub axis: DVec3,
    pub layering: f64,
}

/// Finds the axes with the highest concentration of surface in layers perpendicular to them, in descending order of
/// concentration. At most `most` axes are returned.
pub(super) fn candidates(patches: &[Patch], centre: DVec3, radius: f64, most: usize) -> Vec<Axis> {
    let few = sample(patches, SAMPLED);
    let score = |axis: DVec3| layering(&few, axis, centre, radius);
    let mut all: Vec<Axis> =
        half_sphere(DIRECTIONS).map(|axis| Axis { axis, layering: score(axis) }).collect();
    all.sort_by(|a, b| b.layering.total_cmp(&a.layering));
    let mut chosen: Vec<Axis> = Vec::new();
    for one in all {
        if chosen.len() == most {
            break;
        }
        if chosen.iter().all(|other| other.axis.dot(one.axis).abs() < APART) {
            chosen.push(one);
        }
    }
    // Move each axis uphill in smaller and smaller steps.
    for one in &mut chosen {
        let mut step = 0.03;
        while step > 5e-4 {
            let [across, along] = across(one.axis);
            let tries = [across, -across, along, -along].map(|way| (one.axis + way * step).normalize());
            let best = tries
                .map(|axis| (score(axis), axis))
                .into_iter()
                .fold((one.layering, one.axis), |best, next| if next.0 > best.0 { next } else { best });
            if best.0 > one.layering {
                (one.layering, one.axis) = best;
            } else {
                step *= 0.5;
            }
        }
    }
    // Axes may have moved to the same maximum.
    let mut apart: Vec<Axis> = Vec::new();
    for one in chosen {
        if apart.iter().all(|other| other.axis.dot(one.axis).abs() < APART) {
            apart.push(one);
        }
    }
    apart.sort_by(|a, b| b.layering.total_cmp(&a.layering));
    apart
}

/// Two unit vectors perpendicular to an axis.
pub(super) fn across(axis: DVec3) -> [DVec3; 2] {
    let least = if axis.x.abs() <= axis.y.abs() && axis.x.abs() <= axis.z.abs() {
        DVec3::X
    } else if axis.y.abs() <= axis.z.abs() {
        DVec3::Y
    } else {
        DVec3::Z
    };
    let one = axis.cross(least).normalize();
    [one, axis.cross(one)]
}
