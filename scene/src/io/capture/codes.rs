//! Conversion of pictures to the codes of photographs.

use engine::NodeError;

use crate::error::Error;
use crate::math::color::{code8, srgb_from_linear};
use crate::types::{Camera, Picture};

/// A picture as numbers: width, height, channels and samples, and true if the samples are linear light.
pub struct Sampled {
    size: (usize, usize, usize),
    samples: Vec<f32>,
    linear: bool,
}

/// Largest relative difference between the aspect ratios of a photograph and of its camera.
const ASPECT: f64 = 0.01;

/// Scales a picture down to the size of its camera. Each pixel of the result is the mean over its area.
///
/// # Errors
/// If the picture is smaller than that of the camera, or has a different aspect ratio.
pub fn of_size(picture: Picture, camera: &Camera) -> Result<Sampled, NodeError> {
    let (width, height, channels) = picture.size();
    let to = (camera.width_px as usize, camera.height_px as usize);
    let linear = matches!(picture, Picture::Linear(_));
    let samples = picture.samples();
    if (width, height) == to {
        return Ok(Sampled { size: (width, height, channels), samples: samples.to_vec(), linear });
    }
    let (across, down) = (width as f64 / to.0 as f64, height as f64 / to.1 as f64);
    if across < 1.0 || down < 1.0 || (across / down - 1.0).abs() > ASPECT {
        let what = format!(
            "the photograph `{}` has {width}x{height} pixels, but its camera has {}x{}",
            camera.name, to.0, to.1
        );
        return Err(NodeError::from(Error::Mismatch(what)).at("rig").hint(
            "the photograph must have the size of the camera, or be larger with the same aspect ratio",
        ));
    }
    let (columns, rows) = (spans(width, to.0), spans(height, to.1));
    let mut out = Vec::with_capacity(to.0 * to.1 * channels);
    for (top, weights) in &rows {
        for (left, across) in &columns {
            for c in 0..channels {
                let mut sum = 0.0;
                for (y, down) in weights.iter().enumerate() {
                    for (x, across) in across.iter().enumerate() {
                        let at = ((top + y) * width + left + x) * channels + c;
                        sum += down * across * f64::from(samples[at]);
                    }
                }
                out.push(sum as f32);
            }
        }
    }
    Ok(Sampled { size: (to.0, to.1, channels), samples: out, linear })
}

/// For each of `to` equal parts of `from` pixels, the first pixel that it overlaps, and the share of each pixel
/// from there in the part. The shares of a part sum to 1.
fn spans(from: usize, to: usize) -> Vec<(usize, Vec<f64>)> {
    let each = from as f64 / to as f64;
    let span = |part: usize| {
        let (start, end) = (part as f64 * each, ((part + 1) as f64 * each).min(from as f64));
        let (first, last) = (start as usize, (end.ceil() as usize).clamp(start as usize + 1, from));
        let share = |pixel: usize| (end.min((pixel + 1) as f64) - start.max(pixel as f64)).max(0.0);
        let sum: f64 = (first..last).map(share).sum();
        (first, (first..last).map(|pixel| share(pixel) / sum).collect())
    };
    (0..to).map(span).collect()
}

/// Display codes of the pixels, and 255 for pixels of which at least half is opaque. Colours are divided by alpha.
pub fn codes(picture: &Sampled) -> Vec<[u8; 4]> {
    let (_, _, channels) = picture.size;
    let code = |value: f32| code8(if picture.linear { srgb_from_linear(value) } else { value });
    let pixel = |samples: &[f32]| {
        let (rgb, alpha) = match *samples {
            [r, g, b, alpha, ..] => ([r, g, b], alpha),
            [r, g, b] => ([r, g, b], 1.0),
            [grey, alpha] => ([grey; 3], alpha),
            _ => ([samples.first().copied().unwrap_or(0.0); 3], 1.0),
        };
        if alpha < 0.5 {
            return [0; 4];
        }
        let [r, g, b] = rgb.map(|value| code(value / alpha));
        [r, g, b, u8::MAX]
    };
    picture.samples.chunks(channels.max(1)).map(pixel).collect()
}

/// Excludes the pixels whose mask is below one half.
pub fn masked(pixels: &mut [[u8; 4]], mask: &Sampled) {
    let (_, _, channels) = mask.size;
    for (pixel, mask) in pixels.iter_mut().zip(mask.samples.chunks(channels.max(1))) {
        if mask.first().is_some_and(|value| *value < 0.5) {
            pixel[3] = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_every_pixel_once() {
        for (from, to) in [(6, 3), (7, 3), (100, 33), (5, 5)] {
            let mut covered = vec![0.0; from];
            for (first, shares) in spans(from, to) {
                assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                shares.iter().enumerate().for_each(|(i, share)| covered[first + i] += share);
            }
            let each = to as f64 / from as f64;
            assert!(covered.iter().all(|c| (c - each).abs() < 1e-9), "{from} {to} {covered:?}");
        }
    }

    #[test]
    fn transparent_pixels_are_excluded_and_colours_divided_by_alpha() {
        let sampled = |channels, samples: &[f32], linear| Sampled {
            size: (samples.len() / channels, 1, channels),
            samples: samples.to_vec(),
            linear,
        };
        let picture = sampled(4, &[0.25, 0.5, 0.0, 0.5, 0.1, 0.1, 0.1, 0.4], false);
        let mut pixels = codes(&picture);
        assert_eq!(pixels, [[128, 255, 0, 255], [0; 4]]);
        masked(&mut pixels, &sampled(1, &[0.2, 1.0], false));
        assert_eq!(pixels[0][3], 0);
        assert_eq!(codes(&sampled(3, &[0.214, 1.0, 7.0], true)), [[127, 255, 255, 255]]);
    }
}
