//! The clipped pixels of a panorama.

use crate::light::linear::{LinearPixels, Transfer, linear_pixels, max3};
use engine::{NodeError, Notes};
use scene::error::Error;
use scene::types::{Panorama, Picture};

/// Minimum linear value at which a channel counts as clipped. In the data of the regression, clipping begins
/// gradually between 0.9 and 1; the middle of this range is used.
pub const CLIPPED: f32 = 0.95;

/// Minimum alpha of a pixel that may count as clipped. Pixels with a smaller alpha were filled, so their
/// colours were not captured.
pub const SEEN: f32 = 0.5;

/// Linear light of the panorama, limited to white if the panorama is display-encoded.
pub fn clipped_light(pano: &Panorama, notes: &mut Notes) -> Result<LinearPixels, NodeError> {
    if matches!(pano.image, Picture::Data(_)) {
        return Err(Error::Mismatch("the panorama holds data, not colour".to_owned()).into());
    }
    let (width, height, channels) = pano.image.size();
    if channels != 3 || width == 0 || height == 0 || pano.alpha.samples.len() != width * height {
        return Err(Error::Mismatch(format!("the panorama must not be empty, and needs 3 channels and an alpha value for each pixel (size: {width}x{height} pixels, channels: {channels})")).into());
    }
    let mut pixels = linear_pixels(&pano.image, Transfer::Srgb);
    if matches!(pano.image, Picture::Srgb(_)) {
        for rgb in &mut pixels.rgb {
            *rgb = rgb.map(|v| v.min(1.0));
        }
    }
    if pixels.broken > 0 {
        notes.warning(
            "not-finite",
            format!("samples that are not finite count as black (count: {})", pixels.broken),
        );
    }
    Ok(pixels)
}

/// For each pixel, true if it is clipped and visible: its brightest channel is above `white`.
pub fn clip_mask(pano: &Panorama, pixels: &LinearPixels, white: f32) -> Vec<bool> {
    let clipped = |rgb: [f32; 3]| pixels.ceiling && max3(rgb) > white;
    pixels.rgb.iter().zip(&pano.alpha.samples).map(|(rgb, alpha)| *alpha >= SEEN && clipped(*rgb)).collect()
}
