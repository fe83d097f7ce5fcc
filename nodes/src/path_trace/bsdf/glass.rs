//! Light that passes an interface: straight through a thin wall, or bent into and out of a body.
//!
//! Radiance is carried as if both sides had the same index, since the factors at entry and exit cancel
//! and the viewer is never inside.

use glam::Vec3;

use super::albedo;
use super::ggx::{Ggx, schlick};
use super::gloss::Gloss;
use super::{Look, Scatter};

/// Reflectance at normal incidence of an index of refraction.
pub fn normal(ior: f32) -> f32 {
    let r = (ior - 1.0) / (ior + 1.0);
    r * r
}

/// Keeps a relative index off 1, where facets bend nothing and directions do not tell them.
pub fn steep(eta: f32) -> f32 {
    if eta >= 1.0 { eta.max(1.01) } else { eta.min(1.0 / 1.01) }
}

/// Cosine on the other side of relative index `eta`, for one on this side; none beyond the critical angle.
pub fn other(cosine: f32, eta: f32) -> Option<f32> {
    let squared = 1.0 - (1.0 - cosine * cosine) / (eta * eta);
    (squared > 0.0).then(|| squared.sqrt())
}

/// Reflectance of an interface by Schlick's formula, by the cosine in the thinner medium.
fn fresnel(cosine: f32, eta: f32) -> f32 {
    let Some(across) = other(cosine, eta) else { return 1.0 };
    let f0 = normal(eta);
    f0 + (1.0 - f0) * schlick(if eta > 1.0 { cosine } else { across })
}

/// The direction that a facet bends to `out`; none beyond the critical angle.
fn bend(out: Vec3, half: Vec3, eta: f32) -> Option<Vec3> {
    let facing = out.dot(half);
    Some(half * (facing / eta - other(facing, eta)?) - out / eta)
}

/// Value and density of light that is bent from `incident` below to `out` above, without any gain (Walter et
/// al. 2007).
pub fn refraction(ggx: &Ggx, out: Vec3, incident: Vec3, eta: f32) -> [f32; 2] {
    let half = (out + incident * eta).normalize_or_zero();
    let half = if half.z < 0.0 { -half } else { half };
    let (near, far) = (out.dot(half), incident.dot(half));
    if near <= 0.0 || far >= 0.0 {
        return [0.0; 2];
    }
    let spread = near + eta * far;
    let pdf = ggx.visible(out, half) * (eta * eta * -far) / (spread * spread).max(1e-12);
    [pdf * (1.0 - fresnel(near, eta)) * ggx.seen(out, incident), pdf]
}

/// What one sampled facet reflects and lets through.
pub fn split(ggx: &Ggx, out: Vec3, eta: f32, point: [f32; 2]) -> [f32; 2] {
    let half = ggx.sample(out, point);
    let facing = out.dot(half);
    let reflected = fresnel(facing, eta);
    let mirrored = half * (2.0 * facing) - out;
    let above = if mirrored.z > 0.0 { reflected * ggx.seen(out, mirrored) } else { 0.0 };
    let bent = bend(out, half, eta).filter(|i| i.z < 0.0);
    [above, bent.map_or(0.0, |i| (1.0 - reflected) * ggx.seen(out, i))]
}

/// What colour a surface gives to what passes it. A body is entered and left, a wall passed once: both take
/// the base colour once in all.
pub fn tint(look: &Look) -> Vec3 {
    if look.thick { Vec3::from_array(look.base.to_array().map(f32::sqrt)) } else { look.base }
}

/// What passes.
#[derive(Debug, Clone, Copy)]
pub struct Glass {
    /// Relative index of the other side; none for a thin wall.
    eta: Option<f32>,
    /// Share, colour and gain.
    weight: Vec3,
    /// How much passes towards the viewer.
    pub albedo: Vec3,
}

impl Glass {
    /// Of a look seen from a direction of its frame, below its gloss.
    pub fn new(look: &Look, gloss: &Gloss, out: Vec3) -> Option<Self> {
        let share = look.transmission * (1.0 - look.metallic) * gloss.left;
        if share <= 0.0 || look.blocked {
            return None;
        }
        let tint = tint(look);
        let eta = look.thick.then(|| steep(if look.inside { 1.0 / look.ior } else { look.ior }));
        let (roughness, cosine) = (gloss.ggx.roughness(out), out.z);
        let kept = match eta {
            Some(eta) => albedo::interface(cosine, roughness, eta)[1],
            None => albedo::reflection(cosine, roughness).iter().sum(),
        };
        let albedo = tint * share;
        // Beyond the critical angle a smooth body lets nothing through, so that there is nothing to give back.
        (kept > 1e-3).then(|| Self { eta, weight: albedo / kept, albedo })
    }

    /// Light that passes from `incident` below to `out` above.
    pub fn eval(&self, ggx: &Ggx, out: Vec3, incident: Vec3) -> Scatter {
        let [value, pdf] = match self.eta {
            Some(eta) => refraction(ggx, out, incident, eta),
            // Blurred like the reflection, of which it is the image behind the wall.
            None => {
                let mirror = ggx.mirror(out, Vec3::new(incident.x, incident.y, -incident.z));
                [mirror.value, mirror.pdf]
            }
        };
        Scatter { value: self.weight * value, pdf }
    }

    /// A direction below.
    pub fn sample(&self, ggx: &Ggx, out: Vec3, point: [f32; 2]) -> Option<Vec3> {
        match self.eta {
            Some(eta) => bend(out, ggx.sample(out, point), eta),
            None => {
                let mirrored = ggx.reflect(out, point);
                Some(Vec3::new(mirrored.x, mirrored.y, -mirrored.z))
            }
        }
    }
}
