//! Photographs that a camera would take.

use render::light::linear::LinearPixels;
use scene::math::color::{luminance, srgb_from_linear};
use scene::math::num;
use scene::types::{Data, Image};

/// Photograph that a camera would take at `ev`: display-encoded, limited to white. `colour` holds the colour of the
/// hidden light of each pixel, if it is known.
pub(super) fn expose(
    pixels: &LinearPixels,
    log2_gain: &[f32],
    colour: Option<&Image<Data>>,
    ev: f64,
) -> Vec<f32> {
    let code = |(at, (rgb, gain)): (usize, (&[f32; 3], &f32))| {
        let colour = colour.map(|colour| colour.rgb(at % pixels.width, at / pixels.width));
        exposed(*rgb, (*gain, colour), ev, 1.0)
    };
    pixels.rgb.iter().zip(log2_gain).enumerate().flat_map(code).collect()
}

/// Same as [`expose`] for one pixel, limited to `white`. Without a colour, hidden light has the colour of the pixel.
pub(super) fn exposed(
    rgb: [f32; 3],
    (log2_gain, colour): (f32, Option<[f32; 3]>),
    ev: f64,
    white: f32,
) -> [f32; 3] {
    let (gain, exposure) = (num::f64::exp2(f64::from(log2_gain)), num::f64::exp2(ev));
    let hidden = f64::from(luminance(rgb)) * (gain - 1.0);
    let light = |c: usize| match colour {
        Some(colour) if hidden > 0.0 => f64::from(rgb[c]) + f64::from(colour[c]) * hidden,
        _ => f64::from(rgb[c]) * gain,
    };
    [0, 1, 2].map(|c| srgb_from_linear(((light(c) * exposure) as f32).min(white)))
}
