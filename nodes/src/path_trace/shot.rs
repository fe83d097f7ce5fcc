//! From sums over samples to the finished pictures of one camera.

use super::film::Sums;
use super::{FRONT, PAIR, R0};
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
    pub(super) rays: u64,
    pub(super) broken: u64,
    pub(super) untouched: u64,
    pub(super) chunks: u64,
}

impl Running {
    pub(super) fn new(camera: &Camera) -> Self {
        let pixels = camera.width_px as usize * camera.height_px as usize;
        Self { sums: vec![0.0; pixels * (R0 + PAIR)], rays: 0, broken: 0, untouched: 0, chunks: 0 }
    }

    pub(super) fn add(&mut self, r0: &Sums, pair: &Sums) {
        let parts = r0.sums.chunks_exact(R0).zip(pair.sums.chunks_exact(PAIR));
        for (sums, (a, b)) in self.sums.chunks_exact_mut(R0 + PAIR).zip(parts) {
            for (sum, v) in sums.iter_mut().zip(a.iter().chain(b)) {
                *sum += f64::from(*v);
            }
        }
        self.rays += r0.rays + pair.rays;
        self.broken += r0.broken + pair.broken;
        self.untouched += pair.untouched;
        self.chunks += 1;
    }
}

/// The pictures of a camera from the sums of all its samples.
pub(super) fn finish(camera: &Camera, samples: u32, running: &Running, front: &Sums) -> Shot {
    let (width, height) = (camera.width_px as usize, camera.height_px as usize);
    let mut images = [3, 3, 4].map(|channels| Image::<Linear>::new(width, height, channels));
    let [mut depth, mut normal, mut variance] = [1, 3, 3].map(|channels| Image::new(width, height, channels));
    let n = f64::from(samples);
    let (mut means, mut errors) = ([0.0; 3], [0.0; 3]);
    for index in 0..width * height {
        let (x, y) = (index % width, index / width);
        let sums = &running.sums[index * (R0 + PAIR)..(index + 1) * (R0 + PAIR)];
        let groups: [(usize, usize); 3] = [(0, 3), (R0, R0 + 3), (R0 + 4, R0 + 8)];
        for (k, (first, square)) in groups.into_iter().enumerate() {
            let channels = images[k].channels;
            for (out, sum) in images[k].pixel_mut(x, y).iter_mut().zip(&sums[first..first + channels]) {
                *out = (sum / n) as f32;
            }
            let rgb = [sums[first] / n, sums[first + 1] / n, sums[first + 2] / n];
            let mean = f64::from(luminance(rgb.map(|v| v as f32)));
            let spread = ((sums[square] / n - mean * mean) / (n - 1.0).max(1.0)).max(0.0);
            variance.pixel_mut(x, y)[k] = spread as f32;
            means[k] += mean;
            errors[k] += spread;
        }
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
