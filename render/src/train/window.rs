//! The Gaussian window of SSIM, applied to rows of pixels.

use scene::math::num;

/// Radius of the window, which is 11 pixels wide.
pub const RADIUS: usize = 5;

/// Weights of half the window, from its edge to its middle: a Gaussian with a standard deviation of 1.5 pixels,
/// whose weights sum to 1.
#[derive(Debug, Clone, Copy)]
pub struct Window([f32; RADIUS + 1]);

impl Window {
    /// Computes the weights.
    pub fn new() -> Self {
        let weights: [f64; 2 * RADIUS + 1] = std::array::from_fn(|i| {
            let d = i as f64 - RADIUS as f64;
            num::f64::exp(-d * d / (2.0 * 1.5 * 1.5))
        });
        let sum: f64 = weights.iter().sum();
        Self(std::array::from_fn(|i| (weights[i] / sum) as f32))
    }

    /// Writes the weighted sum of 11 inputs to each element of `out`. For a pass along columns, the inputs are
    /// rows. For a pass along rows, they are the same row at 11 offsets. Each input has at least the length of
    /// `out`.
    #[inline(always)]
    pub fn apply(&self, inputs: [&[f32]; 2 * RADIUS + 1], out: &mut [f32]) {
        let n = out.len();
        let [a, b, c, d, e, f, g, h, i, j, k] = inputs.map(|input| &input[..n]);
        let [w0, w1, w2, w3, w4, w5] = self.0;
        for x in 0..n {
            let far = w0 * (a[x] + k[x]) + w1 * (b[x] + j[x]);
            let middle = w2 * (c[x] + i[x]) + w3 * (d[x] + h[x]);
            out[x] = far + middle + (w4 * (e[x] + g[x]) + w5 * f[x]);
        }
    }

    /// Applies the window along a row that is padded by [`RADIUS`] pixels at both ends.
    #[inline(always)]
    pub fn along(&self, padded: &[f32], out: &mut [f32]) {
        let n = out.len();
        self.apply(std::array::from_fn(|k| &padded[k..k + n]), out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The weights sum to 1, and a single bright pixel gives the weights in both orders.
    #[test]
    fn window_is_normalised_and_symmetric() {
        let window = Window::new();
        let mut row = vec![0.0; 21 + 2 * RADIUS];
        row[10 + RADIUS] = 1.0;
        let mut out = vec![0.0; 21];
        window.along(&row, &mut out);
        assert!((out.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        assert!((0..=10).all(|i| out[10 - i] == out[10 + i]));
        assert!(out[4] == 0.0 && out[5] > 0.0 && out[9] > out[8]);
    }
}
