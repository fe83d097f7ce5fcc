//! Addition of samples to sums.

use glam::Vec3;
use scene::math::color::luminance;

/// Adds a sample to the sums if it is finite; otherwise increments `broken`. Returns whether the sample was added.
pub(super) fn add(sums: &mut [f64], light: Vec3, broken: &mut u64) -> bool {
    if !light.is_finite() {
        *broken += 1;
        return false;
    }
    let rgb = light.to_array();
    for (sum, v) in sums.iter_mut().zip(rgb) {
        *sum += f64::from(v);
    }
    true
}

/// Square of the luminance of a sample.
pub(super) fn squared_luminance(light: Vec3) -> f64 {
    let y = f64::from(luminance(light.to_array()));
    y * y
}
