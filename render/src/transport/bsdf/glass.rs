//! Transmission through an interface: straight through a thin wall, or refracted into and out of a body.
//!
//! Radiance is not scaled by the square of the relative index, since the factors at entry and exit cancel and the
//! viewer is never inside a body.

use glam::Vec3;

use super::dielectric::{fresnel, refract};
use super::ggx::Ggx;
use super::gloss::Gloss;
use super::lobe::Scatter;
use super::params::BsdfParams;

/// Refraction of light from `incident`, below the surface, to `out`, above it. Returns the value of the BSDF
/// without gain (Walter et al. 2007), the density of `incident`, and the cosine between `out` and the normal of the
/// facet.
pub fn refraction(ggx: &Ggx, out: Vec3, incident: Vec3, eta: f32) -> [f32; 3] {
    let half = (out + incident * eta).normalize_or_zero();
    let half = if half.z < 0.0 { -half } else { half };
    let (near, far) = (out.dot(half), incident.dot(half));
    if near <= 0.0 || far >= 0.0 {
        return [0.0; 3];
    }
    let spread = near + eta * far;
    let pdf = ggx.vndf_pdf(out, half) * (eta * eta * -far) / (spread * spread).max(1e-12);
    [pdf * (1.0 - fresnel(near, eta)) * ggx.g2_over_g1(out, incident), pdf, near]
}

/// Factor, per channel, by which one crossing of a surface colours transmitted light. Light crosses a thin wall
/// once and the surface of a body twice, so the factor of a body is the square root of the base colour.
pub fn tint(params: &BsdfParams) -> Vec3 {
    if params.thick { Vec3::from_array(params.base.to_array().map(f32::sqrt)) } else { params.base }
}

/// Transmission of a surface.
#[derive(Debug, Clone, Copy)]
pub struct Glass {
    /// Index of refraction of the other side, relative to the side of the viewer. `None` for a thin wall.
    eta: Option<f32>,
    /// Product of the transmitted share, the colour and the gain.
    weight: Vec3,
    /// Share of the surface that is metal, which reflects light at every angle.
    metal: f32,
    /// Share of the surface that transmits the light that its interface does not reflect.
    clear: f32,
    /// Share of the light that is transmitted towards the viewer if equal light arrives from all directions.
    pub albedo: Vec3,
}

impl Glass {
    /// Transmission of a surface below its gloss. `None` if it transmits no light.
    pub fn new(params: &BsdfParams, gloss: &Gloss) -> Option<Self> {
        let share = params.transmission * (1.0 - params.metallic);
        let albedo = tint(params) * gloss.left * share;
        if (share <= 0.0 && !params.every_lobe) || params.blocked {
            return None;
        }
        // A body that lets no light in is opaque.
        let body = params.thick && share > 0.0;
        let eta = body.then_some(gloss.eta);
        let kept = if body { gloss.facets.passed } else { gloss.facets.all };
        let (metal, clear) = (params.metallic, (1.0 - params.metallic) * params.transmission);
        // Beyond the critical angle a smooth body transmits nothing, so there is nothing to compensate.
        (kept > 1e-3).then(|| Self { eta, weight: albedo / kept, metal, clear, albedo })
    }

    /// True if any light is transmitted.
    pub fn passes(&self) -> bool {
        self.clear > 0.0
    }

    /// True if the surface bounds a body, false if it is a thin wall.
    pub fn is_body(&self) -> bool {
        self.eta.is_some()
    }

    /// Probability of reflection rather than refraction at a facet of a body. `None` for a thin wall, where the
    /// choice between reflection and transmission is made before a facet is sampled.
    pub fn reflection_probability(&self, facing: f32) -> Option<f32> {
        let f = fresnel(facing, self.eta?);
        let (mirrored, passed) = (self.metal + (1.0 - self.metal) * f, self.clear * (1.0 - f));
        Some(mirrored / (mirrored + passed))
    }

    /// Transmission from `incident` below to `out` above. The density does not include the probability of choosing
    /// this lobe.
    pub fn eval(&self, ggx: &Ggx, out: Vec3, incident: Vec3) -> Scatter {
        let [value, pdf] = match self.eta {
            Some(eta) => {
                let [value, pdf, facing] = refraction(ggx, out, incident, eta);
                [value, pdf * (1.0 - self.reflection_probability(facing).unwrap_or(0.0))]
            }
            // Transmission is blurred like the reflection, but mirrored to the other side.
            None => {
                let mirror = ggx.mirror(out, Vec3::new(incident.x, incident.y, -incident.z));
                [mirror.value, mirror.pdf]
            }
        };
        Scatter { value: self.weight * value, pdf }
    }

    /// Samples an incident direction on the far side of a thin wall.
    pub fn through(&self, ggx: &Ggx, out: Vec3, point: [f32; 2]) -> Vec3 {
        let mirrored = ggx.reflect(out, point);
        Vec3::new(mirrored.x, mirrored.y, -mirrored.z)
    }

    /// Samples a facet of a body, and returns the direction into which the facet reflects or refracts, depending on
    /// `choice`. `None` for a thin wall, or if the direction is on the wrong side of the surface.
    pub fn sample_facet(&self, ggx: &Ggx, out: Vec3, point: [f32; 2], choice: f32) -> Option<Vec3> {
        let half = ggx.sample(out, point);
        let facing = out.dot(half);
        match choice < self.reflection_probability(facing)? {
            true => Some(half * (2.0 * facing) - out).filter(|d| d.z > 0.0),
            false => refract(out, half, self.eta?).filter(|d| d.z < 0.0),
        }
    }
}
