//! Photographs that a camera would take.

use crate::light::linear::LinearPixels;
use crate::math::color::srgb_from_linear;
use crate::math::num;

/// Photograph that a camera would take at `ev`: display-encoded, limited to white.
pub(super) fn expose(pixels: &LinearPixels, log2_gain: &[f32], ev: f64) -> Vec<f32> {
    pixels.rgb.iter().zip(log2_gain).flat_map(|(rgb, gain)| exposed(*rgb, *gain, ev, 1.0)).collect()
}

/// Same as [`expose`] for one pixel, limited to `white`.
pub(super) fn exposed(rgb: [f32; 3], log2_gain: f32, ev: f64, white: f32) -> [f32; 3] {
    let scale = num::f64::exp2(f64::from(log2_gain) + ev);
    rgb.map(|v| srgb_from_linear(((f64::from(v) * scale) as f32).min(white)))
}
