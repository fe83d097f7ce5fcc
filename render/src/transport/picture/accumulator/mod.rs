//! Computation of the finished images of one camera from sums over samples.

mod finish;

use scene::math::color::luminance;
use scene::types::{Cell, Data, Image, Linear};

use crate::light::level::level;
use crate::transport::path::rays::Rays;
use crate::transport::picture::film::CROSS;
use crate::transport::picture::film::PAIR;
use crate::transport::picture::film::R0;
use crate::transport::picture::film::{Area, Sums};

/// Indices of the sums of squares among the sums of a pixel. The parts store their square roots.
const SQUARES: [usize; 3] = [3, R0 + 3, R0 + 8];

/// Standard error at which a block of pixels takes no more samples.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TargetError {
    /// Standard error of the worst tile of the block.
    pub error: f64,
    /// True if the result is degraded when a block does not reach the error with the maximum number of samples.
    pub required: bool,
}

/// Result of sampling to a target error.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ReachedError {
    /// Target error.
    pub asked: TargetError,
    /// Largest error of any tile for the number of samples taken, as predicted from the first samples.
    pub predicted: f64,
    /// Largest error of any tile after all samples.
    pub worst: f64,
    /// Total number of blocks of pixels, number of blocks that took more samples than the first chunk, and number
    /// of blocks whose error is above the target.
    pub blocks: [u64; 3],
    /// Average number of samples per pixel.
    pub samples: f64,
}

/// Finished images of one camera.
pub struct FinishedView {
    /// The receiver without the objects, the receiver with the objects, and the objects with premultiplied alpha.
    pub images: [Image<Linear>; 3],
    /// Planar depth of the first surface, in world units.
    pub depth: Image<Data>,
    /// Planar depth of the surface in front of which splats are left, in world units.
    pub nearest: Image<Data>,
    /// Unit normal of the first surface.
    pub normal: Image<Data>,
    /// Variances of the means of the pixels.
    pub variance: Image<Data>,
    /// Row of the camera in the report.
    pub row: Vec<Cell>,
    /// Number of rays by purpose.
    pub rays: Rays,
    /// Number of samples that were not finite and count as black.
    pub broken: u64,
    /// Among the samples that show an object, the share in which the limit on bounces ended a path that still
    /// carried most of its light.
    pub cut: f64,
    /// Among the samples that show an object, the share that is dark behind the back of a single-sided face.
    pub behind: f64,
    /// Number of variances outside the range of single precision.
    pub beyond: u64,
    /// Share of the pixel chunks that were cropped, and upper bound of the relative change of their light.
    pub cropped: (f64, f64),
    /// Result of sampling to a target error, if there is one.
    pub reached: Option<ReachedError>,
}

impl FinishedView {
    /// True if the given pixel shows an object.
    pub fn shows_objects_at(&self, (x, y): (u32, u32)) -> bool {
        self.images[2].pixel(x as usize, y as usize)[3] > 0.0
    }

    /// True if any pixel shows an object.
    pub fn shows_objects(&self) -> bool {
        let object = &self.images[2];
        object.samples.chunks_exact(object.channels).any(|pixel| pixel[3] > 0.0)
    }
}

/// Sums over the chunks of a camera. Each chunk is added when it arrives, so that memory does not grow with the
/// number of chunks.
pub(crate) struct Accumulator {
    pub(crate) whole: Area,
    /// `R0 + PAIR` sums per pixel. Sums of squares are stored here as such, while the parts store their square
    /// roots.
    sums: Vec<f64>,
    /// Number of samples per pixel.
    samples: Vec<u32>,
    /// Products of chunk sums for each pixel: y1 y1, y1 y0, y0 y0 and y y. Here y0, y1 and y are the sums over a
    /// chunk of the luminances of R0, R1 and O. The products are divided by the chunk's number of samples and added
    /// over the chunks.
    cross: Vec<[f64; CROSS]>,
    pub(crate) rays: Rays,
    broken: u64,
    cut: u64,
    behind: u64,
    /// A pixel chunk is one chunk of samples of one pixel. Total number of pixel chunks, number of pixel chunks that
    /// no object changed (including cropped ones), and number of cropped pixel chunks.
    pixels: [u64; 3],
    /// Upper bound of the relative change of light in cropped chunks.
    bound: f32,
}

impl Accumulator {
    pub(crate) fn new(whole: Area) -> Self {
        let pixels = whole.pixels();
        Self {
            whole,
            sums: vec![0.0; pixels * (R0 + PAIR)],
            samples: vec![0; pixels],
            cross: vec![[0.0; CROSS]; pixels],
            rays: Rays::default(),
            broken: 0,
            cut: 0,
            behind: 0,
            pixels: [0; 3],
            bound: 0.0,
        }
    }

    /// Adds the sums over the samples in `range`, for the pixels of `area`.
    pub(crate) fn add(&mut self, area: Area, r0: &Sums, pair: &Sums, range: (u32, u32)) {
        let parts = r0.sums.chunks_exact(R0).zip(pair.sums.chunks_exact(PAIR));
        for (pixel, (a, b)) in area.each().zip(parts) {
            let index = self.whole.index(pixel);
            for (k, (sum, v)) in
                self.sums[index * (R0 + PAIR)..].iter_mut().zip(a.iter().chain(b)).enumerate()
            {
                let v = f64::from(*v);
                *sum += if SQUARES.contains(&k) { v * v } else { v };
            }
            self.samples[index] += range.1 - range.0;
            let light = |c: &[f32]| f64::from(luminance([c[0], c[1], c[2]]));
            let (y0, y1, y) = (light(a), light(b), light(&b[4..]));
            for (sum, v) in self.cross[index].iter_mut().zip([y1 * y1, y1 * y0, y0 * y0, y * y]) {
                *sum += v / f64::from(range.1 - range.0);
            }
        }
        self.rays += r0.rays;
        self.rays += pair.rays;
        self.broken += r0.broken + pair.broken;
        self.cut += pair.cut;
        self.behind += pair.behind;
        self.pixels[0] += area.pixels() as u64;
        self.pixels[1] += pair.untouched;
        self.pixels[2] += pair.cropped.0;
        self.bound = self.bound.max(pair.cropped.1);
    }

    /// Sums of a pixel and its number of samples.
    fn pixel(&self, index: usize) -> (&[f64], f64) {
        (&self.sums[index * (R0 + PAIR)..(index + 1) * (R0 + PAIR)], f64::from(self.samples[index]))
    }

    /// Share of a pixel that is covered by objects.
    pub(crate) fn alpha(&self, index: usize) -> f64 {
        let (sums, n) = self.pixel(index);
        sums[R0 + 7] / n
    }

    /// Mean luminances of R0, R1 and the objects in a pixel.
    pub(crate) fn luminances(&self, index: usize) -> [f64; 3] {
        let (sums, n) = self.pixel(index);
        [0, R0, R0 + 4].map(|first| f64::from(luminance([0, 1, 2].map(|k| (sums[first + k] / n) as f32))))
    }

    /// Median luminance of R0 over the pixels that are lit, computed as in `shadow-ratio`. The mean would be
    /// dominated by a visible sun.
    pub(crate) fn mean_luminance(&self) -> f64 {
        level((0..self.samples.len()).map(|index| self.luminances(index)[0] as f32))
    }

    /// Mean luminance of the objects over the pixels that they cover.
    pub(crate) fn object_luminance(&self) -> f64 {
        let (mut light, mut cover) = (0.0, 0.0);
        for index in 0..self.samples.len() {
            let (sums, n) = self.pixel(index);
            light += f64::from(luminance([0, 1, 2].map(|k| (sums[R0 + 4 + k] / n) as f32)));
            cover += sums[R0 + 7] / n;
        }
        if cover > 0.0 { light / cover } else { 0.0 }
    }

    /// Variances for a pixel, computed as if samples were independent: of the mean luminance of R0, of the change C
    /// = R1 - R0 and of O, and of the ratio S = R1 / R0. They are 0 for a single sample. Stratified samples have
    /// less variance, so these values are too high. C is estimated separately from R0, so S = 1 + C / R0 has
    ///
    /// `Var(S) = (Var(C) + (S - 1)^2 Var(R0)) / R0^2 - 2 (S - 1) Cov(C, R0) / R0^2`.
    ///
    /// The last term is left out. Where C and R0 share light samples, the blocked light grows with the light
    /// itself, so the term is negative and the estimate is too high. Elsewhere C and R0 share only the position in
    /// the pixel.
    pub(crate) fn variances(&self, index: usize) -> Variances {
        let (sums, n) = self.pixel(index);
        let mean = |k: usize| f64::from(luminance([0, 1, 2].map(|c| (sums[k + c] / n) as f32)));
        let of_mean = |square: f64, mean: f64| {
            // A single sample has no variance, and rounding must not create one.
            if n > 1.0 { ((square / n - mean * mean) / (n - 1.0)).max(0.0) } else { 0.0 }
        };
        let [y0, y1, y] = [0, R0, R0 + 4].map(mean);
        let without = of_mean(sums[3], y0);
        let change = of_mean(sums[R0 + 3], y1 - y0);
        let ratio = match y0 > 0.0 {
            true => (change + (y1 / y0 - 1.0) * (y1 / y0 - 1.0) * without) / (y0 * y0),
            false => 0.0,
        };
        Variances { without, change, object: of_mean(sums[R0 + 8], y), ratio }
    }

    /// Variances of the ratio S and of the luminance of O, estimated from the spread between chunks. For S, `(y1 -
    /// S y0)^2 / n` is summed over the chunks, where n is the number of samples of a chunk and y1 and y0 are its
    /// sums. The result is this sum per degree of freedom, times the total number of samples, divided by the square
    /// of the total y0. These variances include the benefit of stratification, but with few chunks only the mean
    /// over many pixels is useful.
    pub(crate) fn variances_between_chunks(&self, index: usize, chunks: usize) -> [f64; 2] {
        let (sums, n) = self.pixel(index);
        let of = |k: usize| f64::from(luminance([0, 1, 2].map(|c| sums[k + c] as f32)));
        let ([y0, y1, y], [a, b, c, o]) = ([0, R0, R0 + 4].map(of), self.cross[index]);
        let s = if y0 > 0.0 { y1 / y0 } else { 0.0 };
        let freedom = (chunks.max(2) - 1) as f64;
        let ratio = if y0 > 0.0 { n * (a - 2.0 * s * b + s * s * c) / (y0 * y0) } else { 0.0 };
        [ratio, (o - y * y / n) / n].map(|spread| spread.max(0.0) / freedom)
    }
}

/// Variances of the mean luminances of a pixel, and of their ratio.
pub(crate) struct Variances {
    without: f64,
    change: f64,
    pub(crate) object: f64,
    pub(crate) ratio: f64,
}
