//! Distances between two pictures, in f64, in the variants whose values papers report. All sums are in row order,
//! so they do not depend on the number of threads. No crate is used, since the existing crates compute in f32 or
//! with the math functions of the system, and lack HDR-FLIP.

mod ciede2000;
mod flip;
mod lpips;
mod plane;
mod ssim;

pub use ciede2000::ciede2000_map;
pub use flip::{Exposures, PIXELS_PER_DEGREE, Sight, hdr_flip_map};
pub use lpips::Lpips;
pub use plane::Plane;
pub use ssim::{SSIM_RADIUS, ssim_map};

use crate::math::num;

/// Errors over the compared pixels of two pictures.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Errors {
    /// Number of compared pixels.
    pub pixels: u64,
    /// Mean of squared differences over pixels and channels.
    pub mean_square: f64,
    /// Mean of absolute differences over pixels and channels.
    pub mean_absolute: f64,
    /// Largest absolute difference.
    pub largest: f64,
    /// Mean of `(a - b)^2 / (b^2 + 0.01)`, for linear light, `b` being the reference.
    pub relative_square: f64,
}

impl Errors {
    /// Peak signal to noise ratio in dB for a peak of 1; infinite for equal pictures.
    pub fn psnr(&self) -> f64 {
        // Subtracted from 0, so that 0 is not -0.
        0.0 - 10.0 * num::f64::log10(self.mean_square)
    }
}

/// Compares the pixels for which `inside` returns true. Differences are averaged over channels first, then over
/// pixels.
pub fn errors(a: &Plane, b: &Plane, inside: impl Fn(usize) -> bool) -> Errors {
    let channels = a.channels.min(b.channels).max(1);
    let mut out = Errors::default();
    for pixel in (0..a.width * a.height).filter(|&pixel| inside(pixel)) {
        let (x, y) = (&a.samples[pixel * a.channels..], &b.samples[pixel * b.channels..]);
        let (mut square, mut absolute, mut relative) = (0.0, 0.0, 0.0);
        for (x, y) in x.iter().zip(y).take(channels) {
            let d = x - y;
            square += d * d;
            absolute += d.abs();
            relative += d * d / (y * y + 0.01);
            out.largest = out.largest.max(d.abs());
        }
        out.pixels += 1;
        out.mean_square += square;
        out.mean_absolute += absolute;
        out.relative_square += relative;
    }
    let count = (out.pixels.max(1) * channels as u64) as f64;
    out.mean_square /= count;
    out.mean_absolute /= count;
    out.relative_square /= count;
    out
}

/// Mean of a map over the pixels for which `inside` returns true; `None` if there are none.
pub fn mean_over(map: &[f64], inside: impl Fn(usize) -> bool) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0_u64);
    for (pixel, value) in map.iter().enumerate() {
        if inside(pixel) {
            sum += value;
            count += 1;
        }
    }
    (count > 0).then(|| sum / count as f64)
}

/// Quantile at `share` (0 to 1) of a map over the pixels for which `inside` returns true, interpolated between
/// adjacent values; `None` if there are no such pixels.
pub fn quantile_over(map: &[f64], share: f64, inside: impl Fn(usize) -> bool) -> Option<f64> {
    let mut chosen: Vec<f64> = (0..map.len()).filter(|i| inside(*i)).map(|i| map[i]).collect();
    chosen.sort_by(f64::total_cmp);
    let place = share.clamp(0.0, 1.0) * chosen.len().checked_sub(1)? as f64;
    let below = place as usize;
    let (low, high) = (chosen[below], chosen[(below + 1).min(chosen.len() - 1)]);
    Some(low + (high - low) * (place - below as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::context;

    fn plane(seed: u64) -> Plane {
        let (width, height) = (19, 14);
        let value = |i: u64| ((i * 2_654_435_761 + seed * 40_503) % 1000) as f64 / 999.0;
        Plane { width, height, channels: 3, samples: (0..(width * height * 3) as u64).map(value).collect() }
    }

    #[test]
    fn equal_pictures_are_equal_and_the_order_does_not_matter() {
        let (a, b) = (plane(1), plane(2));
        let same = errors(&a, &a, |_| true);
        assert_eq!((same.psnr(), same.mean_absolute, same.relative_square), (f64::INFINITY, 0.0, 0.0));
        let map = ssim_map(&a, &a, &context()).expect("runs");
        assert!(map.iter().all(|s| (s - 1.0).abs() < 1e-12));
        let (ab, ba) = (errors(&a, &b, |_| true), errors(&b, &a, |_| true));
        assert_eq!((ab.mean_square, ab.largest), (ba.mean_square, ba.largest));
        assert_eq!(ssim_map(&a, &b, &context()).ok(), ssim_map(&b, &a, &context()).ok());
    }

    #[test]
    fn known_distances() {
        let flat = |v: f64| Plane { width: 4, height: 3, channels: 1, samples: vec![v; 12] };
        let e = errors(&flat(0.6), &flat(0.5), |pixel| pixel < 5);
        assert_eq!(e.pixels, 5);
        assert!((e.psnr() - 20.0).abs() < 1e-12 && (e.mean_absolute - 0.1).abs() < 1e-12);
        assert!((e.relative_square - 0.01 / 0.26).abs() < 1e-12);
        assert_eq!(mean_over(&[1.0, 2.0, 4.0], |pixel| pixel > 0), Some(3.0));
        assert_eq!(mean_over(&[1.0], |_| false), None);
        assert_eq!(quantile_over(&[4.0, 9.0, 1.0, 2.0], 0.5, |pixel| pixel != 1), Some(2.0));
        assert_eq!(quantile_over(&[4.0, 8.0], 0.75, |_| true), Some(7.0));
        assert_eq!(quantile_over(&[1.0], 0.5, |_| false), None);
    }
}
