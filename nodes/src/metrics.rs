//! Distances between two pictures, in f64 and in the variants that papers print. Every number is a sum in
//! the order of rows, so it does not depend on threads.

use engine::{Context, NodeError};

use crate::num;

/// A picture as numbers to compare: interleaved channels, row by row.
pub struct Plane {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples a pixel.
    pub channels: usize,
    /// All samples.
    pub samples: Vec<f64>,
}

/// Sums over some pixels of two pictures.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Errors {
    /// Pixels summed.
    pub pixels: u64,
    /// Mean of squared differences over pixels and channels.
    pub mean_square: f64,
    /// Mean of absolute differences.
    pub mean_absolute: f64,
    /// Largest absolute difference.
    pub largest: f64,
    /// Mean of `(a - b)^2 / (b^2 + 0.01)`, for linear light, `b` being the reference.
    pub relative_square: f64,
}

impl Errors {
    /// Peak signal to noise ratio in dB for a peak of 1; infinite for equal pictures.
    pub fn psnr(&self) -> f64 {
        -10.0 * num::f64::log10(self.mean_square)
    }
}

/// Compares the pixels for which `inside` holds; the mean over channels comes first, then over pixels.
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

/// Half of the window of SSIM: 11 pixels across.
pub const SSIM_RADIUS: usize = 5;

/// The SSIM of every pixel, averaged over channels: Gaussian window of 11 pixels and sigma 1.5, biased
/// variances, C1 = 0.01^2, C2 = 0.03^2, zeros beyond the border. Its mean is what the code of 3D Gaussian
/// splatting prints; over pixels [`SSIM_RADIUS`] from the border, it is the SSIM of the original paper.
pub fn ssim_map(a: &Plane, b: &Plane, cx: &Context) -> Result<Vec<f64>, NodeError> {
    const C1: f64 = 1e-4;
    const C2: f64 = 9e-4;
    let (width, height, channels) = (a.width, a.height, a.channels.min(b.channels).max(1));
    let window = gaussian();
    // Windowed sums of x, y, xx, yy, xy: along rows, then along columns.
    let along_rows = cx.for_each_tile(height, |y| {
        let mut row = vec![[0.0; 5]; width * channels];
        for x in 0..width {
            for c in 0..channels {
                let sum = &mut row[x * channels + c];
                for (k, weight) in window.iter().enumerate() {
                    let Some(at) = (x + k).checked_sub(SSIM_RADIUS).filter(|at| *at < width) else {
                        continue;
                    };
                    let (p, q) = (
                        a.samples[(y * width + at) * a.channels + c],
                        b.samples[(y * width + at) * b.channels + c],
                    );
                    let terms = [p, q, p * p, q * q, p * q];
                    for (s, term) in sum.iter_mut().zip(terms) {
                        *s += weight * term;
                    }
                }
            }
        }
        row
    })?;
    let rows = cx.for_each_tile(height, |y| {
        let mut row = vec![0.0; width];
        for (x, out) in row.iter_mut().enumerate() {
            for c in 0..channels {
                let mut sum = [0.0; 5];
                for (k, weight) in window.iter().enumerate() {
                    let at = (y + k).checked_sub(SSIM_RADIUS).and_then(|at| along_rows.get(at));
                    let Some(at) = at else { continue };
                    for (s, term) in sum.iter_mut().zip(at[x * channels + c]) {
                        *s += weight * term;
                    }
                }
                let [mx, my, xx, yy, xy] = sum;
                let (vx, vy, cov) = (xx - mx * mx, yy - my * my, xy - mx * my);
                let top = (2.0 * mx * my + C1) * (2.0 * cov + C2);
                *out += top / ((mx * mx + my * my + C1) * (vx + vy + C2)) / channels as f64;
            }
        }
        row
    })?;
    Ok(rows.concat())
}

fn gaussian() -> [f64; 2 * SSIM_RADIUS + 1] {
    let weights: [f64; 11] = std::array::from_fn(|i| {
        let d = i as f64 - SSIM_RADIUS as f64;
        num::f64::exp(-d * d / (2.0 * 1.5 * 1.5))
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// Mean of a map over the pixels for which `inside` holds; `None` where there is none.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::context;

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
    }
}
