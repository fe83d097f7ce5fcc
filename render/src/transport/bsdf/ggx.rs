//! The GGX microfacet distribution, isotropic or anisotropic.

use std::f32::consts::PI;

use glam::Vec3;

use crate::geometry::sampling::circle;

/// Minimum alpha; smoother surfaces cannot be resolved in f32.
const NARROWEST: f32 = 1e-4;

/// GGX distribution, given by alpha along the first two axes of the frame.
#[derive(Debug, Clone, Copy)]
pub struct Ggx {
    x: f32,
    y: f32,
}

/// Mirror reflection between two directions, at the facet that lies halfway between them.
#[derive(Debug, Clone, Copy)]
pub struct Mirror {
    /// Cosine between either direction and the normal of the facet.
    pub cosine: f32,
    /// Value of the BRDF for a perfect mirror, times the cosine of the incident direction.
    pub value: f32,
    /// Density with which [`Ggx::reflect`] samples the incident direction.
    pub pdf: f32,
}

impl Ggx {
    /// Isotropic distribution with the given perceptual roughness.
    pub fn isotropic(roughness: f32) -> Self {
        Self::anisotropic(roughness, 0.0)
    }

    /// Distribution with the given perceptual roughness that is wider along the first axis, as
    /// KHR_materials_anisotropy defines it.
    pub fn anisotropic(roughness: f32, strength: f32) -> Self {
        let alpha = roughness * roughness;
        Self::of([alpha + (1.0 - alpha) * strength * strength, alpha])
    }

    /// Distribution with these alphas along the two axes.
    pub fn of([x, y]: [f32; 2]) -> Self {
        Self { x: x.max(NARROWEST), y: y.max(NARROWEST) }
    }

    /// Alphas along the two axes.
    pub fn alphas(&self) -> [f32; 2] {
        [self.x, self.y]
    }

    /// Roughness of an isotropic distribution that loses about as much energy to multiple scattering towards `out`
    /// as this distribution does. At normal incidence it follows from the mean of the squared alphas. At other
    /// angles, slopes along the view direction count less and slopes across it more. The formula is fitted to
    /// sampled albedos and matches them within 6 %.
    pub fn roughness(&self, out: Vec3) -> f32 {
        let aside = 0.425 * (1.0 - out.z * out.z).max(0.0);
        let x = self.x * self.x * (1.0 + aside - 0.85 * out.x * out.x);
        let y = self.y * self.y * (1.0 + aside - 0.85 * out.y * out.y);
        (0.5 * (x + y)).max(0.0).sqrt().sqrt().min(1.0)
    }

    /// Density of the facet normals at `half` (Walter et al. 2007), computed from the tangent components so that it
    /// is accurate near the pole.
    fn d(&self, half: Vec3) -> f32 {
        let (x, y) = (half.x / self.x, half.y / self.y);
        let d = x * x + y * y + half.z * half.z;
        1.0 / (PI * self.x * self.y * d * d)
    }

    /// Smith's auxiliary function, from which masking and shadowing are computed.
    fn lambda(&self, d: Vec3) -> f32 {
        let (x, y) = (d.x * self.x, d.y * self.y);
        0.5 * ((1.0 + (x * x + y * y) / (d.z * d.z)).sqrt() - 1.0)
    }

    /// Height-correlated masking-shadowing of both directions, divided by the masking of `out`. Each direction may
    /// be above or below the surface.
    pub fn g2_over_g1(&self, out: Vec3, incident: Vec3) -> f32 {
        let own = 1.0 + self.lambda(out);
        own / (own + self.lambda(incident))
    }

    /// Density of visible normals as seen from `out`.
    pub fn vndf_pdf(&self, out: Vec3, half: Vec3) -> f32 {
        let facing = out.dot(half).max(0.0);
        self.d(half) * facing / (out.z * (1.0 + self.lambda(out)))
    }

    /// Reflection from `incident` to `out`, both above the surface.
    pub fn mirror(&self, out: Vec3, incident: Vec3) -> Mirror {
        let half = (incident + out).normalize_or(Vec3::Z);
        let pdf = self.d(half) / (4.0 * out.z * (1.0 + self.lambda(out)));
        Mirror { cosine: out.dot(half).clamp(0.0, 1.0), value: pdf * self.g2_over_g1(out, incident), pdf }
    }

    /// Samples a visible normal (Dupuy and Benyoub 2023, Sampling visible GGX normals with spherical caps).
    pub fn sample(&self, out: Vec3, [u, v]: [f32; 2]) -> Vec3 {
        let stretched = Vec3::new(out.x * self.x, out.y * self.y, out.z).normalize();
        let (sin, cos) = circle(u);
        let z = (1.0 - v) * (1.0 + stretched.z) - stretched.z;
        let r = (1.0 - z * z).max(0.0).sqrt();
        let half = Vec3::new(r * cos, r * sin, z) + stretched;
        Vec3::new(half.x * self.x, half.y * self.y, half.z.max(0.0)).normalize_or(Vec3::Z)
    }

    /// Samples a facet, and returns the incident direction that it reflects to `out`.
    pub fn reflect(&self, out: Vec3, point: [f32; 2]) -> Vec3 {
        let half = self.sample(out, point);
        half * (2.0 * out.dot(half)) - out
    }
}

/// Schlick's factor (1 - cosine)^5.
pub fn schlick(cosine: f32) -> f32 {
    let c = 1.0 - cosine;
    (c * c) * (c * c) * c
}
