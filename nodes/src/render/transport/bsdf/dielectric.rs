//! Reflection and refraction at a smooth interface between two media without absorption (Fresnel, Snell).

use glam::Vec3;

use super::BsdfParams;

/// Reflectance at normal incidence of an index of refraction.
pub fn f0_of_ior(ior: f32) -> f32 {
    let r = (ior - 1.0) / (ior + 1.0);
    r * r
}

/// Relative index of the far side of a surface. For a body it is kept away from 1, where facets do not
/// refract and cannot be determined from the directions.
pub fn relative(params: &BsdfParams) -> f32 {
    let index = if params.thick { params.ior.max(1.01) } else { params.ior };
    if params.inside { 1.0 / index } else { index }
}

/// Cosine on the other side of an interface of relative index `eta`, for a cosine on this side. `None` beyond
/// the critical angle.
pub fn cos_refracted(cosine: f32, eta: f32) -> Option<f32> {
    let squared = 1.0 - (1.0 - cosine * cosine) / (eta * eta);
    (squared > 0.0).then(|| squared.sqrt())
}

/// Fresnel reflectance of an interface for unpolarised light. `cosine` is on this side.
pub fn fresnel(cosine: f32, eta: f32) -> f32 {
    let Some(across) = cos_refracted(cosine, eta) else { return 1.0 };
    let across_plane = (cosine - eta * across) / (cosine + eta * across);
    let in_plane = (eta * cosine - across) / (eta * cosine + across);
    0.5 * (across_plane * across_plane + in_plane * in_plane)
}

/// Rise of reflectance from normal incidence towards 1, which is `(1 - cosine)^5` in Schlick's approximation.
/// The dip before the rise for indices of 4 and more is left out.
pub fn rise(cosine: f32, eta: f32) -> f32 {
    let f0 = f0_of_ior(eta);
    ((fresnel(cosine, eta) - f0) / (1.0 - f0)).clamp(0.0, 1.0)
}

/// Incident direction that a facet refracts to `out`. `None` beyond the critical angle.
pub fn refract(out: Vec3, half: Vec3, eta: f32) -> Option<Vec3> {
    let facing = out.dot(half);
    Some(half * (facing / eta - cos_refracted(facing, eta)?) - out / eta)
}
