//! Exposure: metering of a panorama, and measurement of clipped light from other exposures.

use scene::math::color::luminance;
use scene::math::num;
use scene::types::{Image, Linear};

use super::linear::max3;

/// Exponent of the tone curve: samples are raised to the power 1 / `GAMMA` before the median is taken.
const GAMMA: f64 = 2.4;
/// Target value of the median after the tone curve.
const MIDDLE: f64 = 0.5;
/// Maximum share of the sphere, by solid angle, in which the brightest channel may exceed 1 after scaling.
const ABOVE_WHITE: f64 = 0.15;

/// A display colour counts as clipped if one of its channels, in linear light, is above this.
pub const WHITE: f32 = 0.9;
/// Minimum luminance in comparisons. Darker light is raised to this value, since 8-bit codes are too coarse to
/// represent it.
pub const DARKEST: f64 = 1e-4;

/// The factor that scales the light of a panorama to EV 0, as a photographer would meter it. With this factor, the
/// median of the positive samples is 0.5 after they are raised to the power 1 / 2.4. A smaller factor is used if
/// the brightest channel would otherwise exceed 1 in more than 15 % of the sphere. This is the rule of
/// DiffusionLight's tone mapping (Phongthawee et al. 2024), with the bound of 15 % added. `None` for a black
/// panorama.
pub fn ev0_scale(image: &Image<Linear>) -> Option<f64> {
    let mut positive: Vec<f32> = image.samples.iter().copied().filter(|v| *v > 0.0).collect();
    if positive.is_empty() {
        return None;
    }
    positive.sort_unstable_by(f32::total_cmp);
    let (low, high) = (positive[(positive.len() - 1) / 2], positive[positive.len() / 2]);
    let root = |v: f32| num::pow(f64::from(v), 1.0 / GAMMA);
    let scale = num::pow(MIDDLE / (0.5 * (root(low) + root(high))), GAMMA);
    let (width, height) = (image.width, image.height);
    let mut peaks: Vec<(f32, f64)> = (0..width * height)
        .map(|i| {
            let [r, g, b] = image.rgb(i % width, i / width);
            let (sine, _) = num::sin_cos(std::f64::consts::PI * ((i / width) as f64 + 0.5) / height as f64);
            (r.max(g).max(b), sine)
        })
        .collect();
    peaks.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = peaks.iter().map(|p| p.1).sum();
    let mut sum = 0.0;
    let limit = peaks.iter().find(|(_, weight)| {
        sum += weight;
        sum >= (1.0 - ABOVE_WHITE) * total
    });
    Some(limit.map_or(scale, |(peak, _)| scale.min(1.0 / f64::from(*peak))))
}

/// A pixel of a photograph.
#[derive(Clone, Copy)]
pub struct Shown {
    /// Exposure of the photograph, in EV.
    pub ev: f64,
    /// Linear light, as stored in the photograph.
    pub rgb: [f32; 3],
    /// True if the pixel is clipped.
    pub clipped: bool,
}

impl Shown {
    /// Converts a pixel of a picture that is clipped at white.
    pub fn display(ev: f64, rgb: [f32; 3]) -> Self {
        Self { ev, rgb, clipped: max3(rgb) > WHITE }
    }

    /// Luminance of the pixel, scaled to an exposure of EV 0.
    pub fn light(&self) -> f64 {
        f64::from(luminance(self.rgb)) * num::f64::exp2(-self.ev)
    }
}

/// The hidden light of a pixel: log2 of the ratio of its true luminance to its luminance in the panorama. Ratios
/// below 1 are raised to 1. The true luminance is taken from the first of `exposures` (sorted from brightest to
/// darkest) in which the pixel is not clipped. If the pixel is clipped in all of them, the last is used, and the
/// returned flag is true. `None` if there are no exposures.
pub fn measured(own: [f32; 3], exposures: impl Iterator<Item = Shown>) -> Option<(f32, bool)> {
    let own = f64::from(luminance(own)).max(DARKEST);
    let mut last = None;
    for shown in exposures {
        last = Some((num::f64::log2((shown.light() / own).max(1.0)) as f32, shown.clipped));
        if !shown.clipped {
            break;
        }
    }
    last
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_goes_to_the_middle_unless_too_much_would_clip() {
        // Nine rows in ten are dim, one row near the horizon is bright: a sixteenth of the sphere.
        let (width, height) = (32, 16);
        let lit = |rows: std::ops::Range<usize>| {
            let sample = |i: usize| if rows.contains(&(i / (3 * width))) { 40.0 } else { 0.02 };
            Image::from_samples(width, height, 3, (0..width * height * 3).map(sample).collect())
        };
        let little = ev0_scale(&lit(8..9)).unwrap_or_default();
        assert!((num::pow(0.02_f32.into(), 1.0 / 2.4) * num::pow(little, 1.0 / 2.4) - 0.5).abs() < 1e-7);
        let much = ev0_scale(&lit(6..10)).unwrap_or_default();
        assert!((much - 1.0 / 40.0).abs() < 1e-9, "{much}");
        assert_eq!(ev0_scale(&Image::new(4, 2, 3)), None);
        // Very dim light: a picture of 1e-30 of the light is scaled up by 1e30.
        let dim = lit(6..10).samples.iter().map(|v| v * 1e-30).collect();
        let dim = ev0_scale(&Image::from_samples(width, height, 3, dim)).unwrap_or_default();
        assert!((dim * 1e-30 * 40.0 - 1.0).abs() < 1e-5, "{dim}");
    }
}
