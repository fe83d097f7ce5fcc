//! Reflection and refraction at a smooth interface between two media without absorption (Fresnel, Snell).

use glam::Vec3;

use super::params::BsdfParams;

/// Reflectance at normal incidence of an interface with the given index of refraction.
pub fn f0_of_ior(ior: f32) -> f32 {
    let r = (ior - 1.0) / (ior + 1.0);
    r * r
}

/// Index of refraction of the far side of a surface, relative to the side of the viewer. The index of a body counts
/// as at least 1.01: at an index of 1 light is not bent, so the facet that refracts it cannot be determined from
/// the two directions.
pub fn relative(params: &BsdfParams) -> f32 {
    let index = if params.thick { params.ior.max(1.01) } else { params.ior };
    if params.inside { 1.0 / index } else { index }
}

/// Cosine of the angle of refraction at an interface of relative index `eta`. `cosine` is the cosine of the angle
/// of incidence. `None` beyond the critical angle.
pub fn cos_refracted(cosine: f32, eta: f32) -> Option<f32> {
    let squared = 1.0 - (1.0 - cosine * cosine) / (eta * eta);
    (squared > 0.0).then(|| squared.sqrt())
}

/// Fresnel reflectance of an interface for unpolarised light. `cosine` is the cosine of the angle of incidence.
pub fn fresnel(cosine: f32, eta: f32) -> f32 {
    let Some(across) = cos_refracted(cosine, eta) else { return 1.0 };
    let across_plane = (cosine - eta * across) / (cosine + eta * across);
    let in_plane = (eta * cosine - across) / (eta * cosine + across);
    0.5 * (across_plane * across_plane + in_plane * in_plane)
}

/// Relative rise of the reflectance above its value at normal incidence: 0 at normal incidence, and 1 at grazing
/// incidence. In Schlick's approximation it is `(1 - cosine)^5`. For indices of 4 and more, the reflectance is
/// below its value at normal incidence at some angles; the rise is 0 there.
pub fn rise(cosine: f32, eta: f32) -> f32 {
    let f0 = f0_of_ior(eta);
    ((fresnel(cosine, eta) - f0) / (1.0 - f0)).clamp(0.0, 1.0)
}

/// Incident direction that a facet refracts to `out`. `None` beyond the critical angle.
pub fn refract(out: Vec3, half: Vec3, eta: f32) -> Option<Vec3> {
    let facing = out.dot(half);
    Some(half * (facing / eta - cos_refracted(facing, eta)?) - out / eta)
}
