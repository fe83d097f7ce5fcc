//! From sums over samples to the finished pictures of one camera.

use super::film::Sums;
use super::{CROSS, FRONT, PAIR, R0};
use crate::color::luminance;
use crate::types::{Camera, Cell, Data, Image, Linear};

/// The finished pictures of one camera.
pub(super) struct Shot {
    pub(super) images: [Image<Linear>; 3],
    pub(super) depth: Image<Data>,
    pub(super) normal: Image<Data>,
    pub(super) variance: Image<Data>,
    pub(super) row: Vec<Cell>,
    pub(super) rays: u64,
    pub(super) broken: u64,
}

/// The chunks of a camera, added in their order as they come, so that memory does not grow with them.
pub(super) struct Running {
    /// `R0 + PAIR` sums a pixel.
    pub(super) sums: Vec<f64>,
    /// For the luminances y0 of R0 and y1 of R1, sums over a chunk, divided by its number of samples: y1 y1,
    /// y1 y0 and y0 y0 of each pixel, added over chunks.
    cross: Vec<[f64; CROSS]>,
    pub(super) rays: u64,
    pub(super) broken: u64,
    pub(super) untouched: u64,
    pub(super) chunks: u64,
}

impl Running {
    pub(super) fn new(camera: &Camera) -> Self {
        let pixels = camera.width_px as usize * camera.height_px as usize;
        Self {
            sums: vec![0.0; pixels * (R0 + PAIR)],
            cross: vec![[0.0; CROSS]; pixels],
            rays: 0,
            broken: 0,
            untouched: 0,
            chunks: 0,
        }
    }

    pub(super) fn add(&mut self, r0: &Sums, pair: &Sums, range: (u32, u32)) {
        let samples = f64::from(range.1 - range.0);
        let parts = r0.sums.chunks_exact(R0).zip(pair.sums.chunks_exact(PAIR));
        let known = self.sums.chunks_exact_mut(R0 + PAIR).zip(&mut self.cross);
        for ((sums, cross), (a, b)) in known.zip(parts) {
            for (sum, v) in sums.iter_mut().zip(a.iter().chain(b)) {
                *sum += f64::from(*v);
            }
            let [y0, y1] = [a, b].map(|c| f64::from(luminance([c[0], c[1], c[2]])));
            for (sum, v) in cross.iter_mut().zip([y1 * y1, y1 * y0, y0 * y0]) {
                *sum += v / samples;
            }
        }
        self.rays += r0.rays + pair.rays;
        self.broken += r0.broken + pair.broken;
        self.untouched += pair.untouched;
        self.chunks += 1;
    }

    /// Variance of the ratio of luminances of a pixel, that of a ratio of means: over chunks of n samples
    /// with sums y1 and y0, `sum((y1 - S y0)^2 / n)` for each degree of freedom, over the square of all y0.
    /// It sees how evenly samples are spread, and that R0 and R1 share their random numbers. One chunk has
    /// no spread; then a sample counts as light that the object takes wholly or not at all, and S as half a
    /// sample less sure than it looks: `s (1 - s) / n` where `s = (n S + 1/2) / (n + 1)`.
    fn ratio_variance(&self, index: usize, samples: f64) -> f64 {
        let sums = &self.sums[index * (R0 + PAIR)..(index + 1) * (R0 + PAIR)];
        let [y0, y1] =
            [0, R0].map(|k| f64::from(luminance([sums[k], sums[k + 1], sums[k + 2]].map(|v| v as f32))));
        if y0 <= 0.0 || sums[..3] == sums[R0..R0 + 3] {
            return 0.0;
        }
        let (s, [a, b, c]) = (y1 / y0, self.cross[index]);
        if self.chunks < 2 {
            let s = (samples * s.clamp(0.0, 1.0) + 0.5) / (samples + 1.0);
            return s * (1.0 - s) / samples;
        }
        let spread = (a - 2.0 * s * b + s * s * c).max(0.0) / (self.chunks - 1) as f64;
        // Sums of n samples over n have the variance of one: the ratio of all N has that over N.
        samples * spread / (y0 * y0)
    }
}

/// The pictures of a camera from the sums of all its samples.
pub(super) fn finish(camera: &Camera, samples: u32, running: &Running, front: &Sums) -> Shot {
    let (width, height) = (camera.width_px as usize, camera.height_px as usize);
    let mut images = [3, 3, 4].map(|channels| Image::<Linear>::new(width, height, channels));
    let [mut depth, mut normal, mut variance] = [1, 3, 4].map(|channels| Image::new(width, height, channels));
    let n = f64::from(samples);
    let (mut means, mut errors) = ([0.0; 3], [0.0; 3]);
    for index in 0..width * height {
        let (x, y) = (index % width, index / width);
        let sums = &running.sums[index * (R0 + PAIR)..(index + 1) * (R0 + PAIR)];
        let (mut means_of, mut errors_of) = ([0.0_f64; 3], [0.0_f64; 3]);
        let groups: [(usize, usize); 3] = [(0, 3), (R0, R0 + 3), (R0 + 4, R0 + 8)];
        for (k, (first, square)) in groups.into_iter().enumerate() {
            let channels = images[k].channels;
            for (out, sum) in images[k].pixel_mut(x, y).iter_mut().zip(&sums[first..first + channels]) {
                *out = (sum / n) as f32;
            }
            let rgb = [sums[first] / n, sums[first + 1] / n, sums[first + 2] / n];
            let mean = f64::from(luminance(rgb.map(|v| v as f32)));
            let of_mean = |square: f64, mean: f64| ((square / n - mean * mean) / (n - 1.0).max(1.0)).max(0.0);
            let spread = match k {
                // R1 is R0 and a change, whose errors may go the same way.
                1 => {
                    let root = of_mean(sums[square], mean - means_of[0]).sqrt() + errors_of[0].sqrt();
                    root * root
                }
                _ => of_mean(sums[square], mean),
            };
            (means_of[k], errors_of[k]) = (mean, spread);
            variance.pixel_mut(x, y)[k] = spread as f32;
            means[k] += mean;
            errors[k] += spread;
        }
        variance.pixel_mut(x, y)[3] = running.ratio_variance(index, n) as f32;
        let values = &front.sums[index * FRONT..(index + 1) * FRONT];
        depth.pixel_mut(x, y)[0] = values[0];
        normal.pixel_mut(x, y).copy_from_slice(&values[1..]);
    }
    let all = (width * height).max(1) as f64;
    let rays = running.rays + front.rays;
    let mut row = vec![Cell::Text(camera.name.clone())];
    for k in 0..3 {
        row.push(Cell::Number(means[k] / all));
        row.push(Cell::Number((errors[k] / all).sqrt()));
    }
    row.push(Cell::Count(rays));
    row.push(Cell::Number(running.untouched as f64 / (all * running.chunks.max(1) as f64)));
    Shot { images, depth, normal, variance, row, rays, broken: running.broken }
}
