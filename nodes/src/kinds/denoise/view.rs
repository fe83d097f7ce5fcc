//! Layers of one view, and the fields that are filtered.

use glam::Vec3;
use scene::math::color::luminance;
use scene::math::num;
use scene::types::{Image, Linear, Picture};

use super::means::{Field, Pixel};

/// Ratio above which ratios are compared by their logarithm. The light of an inserted lamp may exceed it.
const BRIGHT: f32 = 8.0;
/// Value to which ratios, variances and the light of the object (divided by its mean) are limited, so that squares
/// and sums do not overflow.
pub(super) const BRIGHTEST: f32 = 1e15;

/// Layers of one view.
pub(super) struct ViewLayers<'a> {
    pub without: &'a Image<Linear>,
    pub with: &'a Image<Linear>,
    pub object: &'a Image<Linear>,
    pub depth: &'a Picture,
    pub normal: &'a Picture,
    pub variance: &'a Picture,
}

impl ViewLayers<'_> {
    /// Builds a field whose normals and nearness come from the guide layers. `fill` sets the other data of a pixel;
    /// its arguments are the index of the pixel, the alpha of the object there, and the pixel to fill.
    fn field(&self, fill: impl Fn(usize, f32, &mut Pixel)) -> Field {
        let (width, height) = (self.without.width, self.without.height);
        let pixel = |i: usize| {
            let normal = &self.normal.samples()[i * 3..i * 3 + 3];
            let depth = self.depth.samples()[i];
            let near = if depth > 0.0 && depth.is_finite() { 1.0 / depth } else { 0.0 };
            let normal = Vec3::new(normal[0], normal[1], normal[2]);
            let mut pixel = Pixel {
                normal: if normal.is_finite() { normal } else { Vec3::ZERO },
                nearness: [near, 0.0, 0.0],
                ..Pixel::default()
            };
            fill(i, self.object.samples[i * 4 + 3], &mut pixel);
            pixel
        };
        let mut field =
            Field { width, height, pixels: (0..width * height).map(pixel).collect(), doubts: false };
        field.find_slopes();
        field
    }

    /// Field of R0 and R1, compared by their ratio, and the number of fireflies removed.
    pub fn receiver(&self) -> (Field, u64) {
        let mut field = self.field(|i, alpha, pixel| {
            let colour = |image: &Image<Linear>| -> [f32; 3] {
                let at = i * image.channels;
                [image.samples[at], image.samples[at + 1], image.samples[at + 2]]
            };
            let (r0, r1) = (colour(self.without), colour(self.with));
            pixel.values = [r0[0], r0[1], r0[2], r1[0], r1[1], r1[2]];
            let variance = self.variance.samples()[i * 4 + 3];
            // Objects change nothing outside the receiver.
            let met = pixel.nearness[0] > 0.0;
            pixel.there = met && pixel.values.iter().all(|v| v.is_finite()) && luminance(r0) > 0.0;
            if pixel.there {
                let ratio = |k: usize| if r0[k] > 0.0 { (r1[k] / r0[k]).clamp(0.0, BRIGHTEST) } else { 1.0 };
                pixel.signal = [ratio(0), ratio(1), ratio(2)];
                pixel.variance = known(variance).min(BRIGHTEST * BRIGHTEST);
            }
            // The object is in front; which part of the receiver lies behind it is unknown.
            if alpha > 0.0 {
                pixel.normal = Vec3::ZERO;
            }
        });
        // Only pixels brighter than without objects: in a shadow, few paths may carry all the light there is.
        let fireflies = field.quench(1.0, |values, ratio| {
            (0..3).for_each(|k| values[3 + k] = values[k] * ratio[k]);
        });
        field.pixels.iter_mut().for_each(scale_ratios);
        // A variance from a few chunks of samples has few degrees of freedom.
        field.smooth_variance(3);
        (field, fireflies)
    }

    /// Power of two that brings the mean light of the object near 1. Thresholds are then relative to the
    /// mean, and filtering does not depend on the unit of light, bit for bit.
    pub fn exposure(&self) -> f32 {
        let (mut sum, mut cover) = (0.0, 0.0);
        for o in self.object.samples.chunks_exact(4).filter(|o| o[3] > 0.0 && o.iter().all(|v| v.is_finite()))
        {
            sum += f64::from(luminance([o[0], o[1], o[2]]));
            cover += f64::from(o[3]);
        }
        let mean = (sum / cover) as f32;
        // The exponent alone, for normal numbers.
        let exponent = mean.to_bits() >> 23;
        if mean.is_normal() && (1..=253).contains(&exponent) {
            f32::from_bits((254 - exponent) << 23)
        } else {
            1.0
        }
    }

    /// Field of the object, compared by its colour.
    pub fn inserted(&self) -> Field {
        let exposure = self.exposure();
        let mut field = self.field(|i, alpha, pixel| {
            let o = &self.object.samples[i * 4..i * 4 + 4];
            let variance = self.variance.samples()[i * 4 + 2] / (alpha * alpha);
            pixel.values = [o[0], o[1], o[2], o[3], 0.0, 0.0];
            pixel.there = alpha > 0.0 && o.iter().all(|v| v.is_finite());
            if pixel.there {
                pixel.signal = [0, 1, 2].map(|k| (o[k] / alpha * exposure).min(BRIGHTEST));
                pixel.variance = (known(variance) * exposure * exposure).min(BRIGHTEST);
            }
        });
        field.find_doubts();
        field.smooth_variance(1);
        field
    }
}

/// Maps ratios to the scale on which they are compared, and scales their variance.
fn scale_ratios(pixel: &mut Pixel) {
    let slope = |ratio: f32| if ratio > BRIGHT { BRIGHT / ratio } else { 1.0 };
    let scale: f32 = pixel.signal.iter().map(|&ratio| slope(ratio) * slope(ratio)).sum::<f32>() / 3.0;
    pixel.variance = (pixel.variance * scale).min(BRIGHTEST);
    for ratio in &mut pixel.signal {
        if *ratio > BRIGHT {
            *ratio = BRIGHT * (1.0 + num::f32::ln(*ratio / BRIGHT));
        }
    }
}

/// Returns the variance, or 0 if the variance is unknown. A variance that equals the largest float is unknown,
/// since it may have been clamped.
pub fn known(variance: f32) -> f32 {
    if variance < f32::MAX { variance.max(0.0) } else { 0.0 }
}
