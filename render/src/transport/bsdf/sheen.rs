//! Sheen of cloth at grazing angles (Estevez and Kulla 2017, Production friendly microfacet sheen BRDF), as
//! specified by KHR_materials_sheen.

use std::f32::consts::PI;

use glam::Vec3;
use scene::math::num;

use crate::geometry::sampling::circle;

/// Density of the directions sampled by [`uniform`].
pub const UNIFORM: f32 = 0.5 / PI;

/// Samples a uniform direction of the upper hemisphere.
pub fn uniform([u, v]: [f32; 2]) -> Vec3 {
    let (sin, cos) = circle(u);
    let r = (1.0 - v * v).max(0.0).sqrt();
    Vec3::new(r * cos, r * sin, v)
}

/// Function fitted to the masking of fibres. Its coefficients are interpolated by `(1 - alpha)^2` between the
/// coefficients for an alpha of 1 and for an alpha of 0.
fn fit(x: f32, alpha: f32) -> f32 {
    let t = (1.0 - alpha) * (1.0 - alpha);
    let at = |wide: f32, narrow: f32| wide + (narrow - wide) * t;
    let (a, b, c) = (at(21.5473, 25.3245), at(3.82987, 3.32435), at(0.19823, 0.16801));
    let (d, e) = (at(-1.97760, -1.27393), at(-4.32054, -4.85967));
    a / (1.0 + b * num::powf(x, c)) + d * x + e
}

fn lambda(cosine: f32, alpha: f32) -> f32 {
    let exponent =
        if cosine < 0.5 { fit(cosine, alpha) } else { 2.0 * fit(0.5, alpha) - fit(1.0 - cosine, alpha) };
    num::f32::exp(exponent)
}

/// Value of a white sheen times the cosine of the incident direction. Both directions are above the surface.
pub fn value(out: Vec3, incident: Vec3, roughness: f32) -> f32 {
    let alpha = (roughness * roughness).clamp(0.01, 1.0);
    let half = (out + incident).normalize_or(Vec3::Z);
    let sin = (1.0 - half.z * half.z).max(0.0).sqrt();
    let d = (2.0 + 1.0 / alpha) * num::powf(sin, 1.0 / alpha) / (2.0 * PI);
    d / ((1.0 + lambda(out.z, alpha) + lambda(incident.z, alpha)) * 4.0 * out.z)
}
