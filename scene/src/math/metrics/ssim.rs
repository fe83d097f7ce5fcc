//! Structural similarity (SSIM), in the variants whose values papers report.

use engine::{Context, NodeError};

use super::plane::Plane;
use crate::math::num;

/// Radius of the SSIM window, which is 11 pixels wide.
pub const SSIM_RADIUS: usize = 5;

/// The SSIM of every pixel, averaged over channels: Gaussian window of 11 pixels and sigma 1.5, biased variances,
/// C1 = 0.01^2, C2 = 0.03^2, zeros beyond the border. The mean over all pixels is the value that the code of 3D
/// Gaussian splatting prints; the mean over pixels at least [`SSIM_RADIUS`] from the border is the SSIM of the
/// original paper.
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
