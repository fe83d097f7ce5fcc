//! The finished images of a camera, from the sums of all samples.

use engine::{Context, NodeError};
use scene::math::color::luminance;
use scene::types::{Camera, Cell, Image, Linear};

use super::{Accumulator, FinishedView, ReachedError};
use crate::transport::picture::film::{FIRST_HIT, R0, Sums};

/// The pixels of a row of the images of a camera.
#[derive(Default)]
struct Row {
    /// Samples of `without`, `with`, `object`, depth, nearest depth, normal and variance.
    samples: [Vec<f32>; 7],
    /// Variances of the luminances of `without`, `with` and `object`, per pixel.
    spreads: Vec<[f64; 3]>,
    /// Number of variances that f32 cannot hold.
    beyond: u64,
    /// True if a pixel has several samples.
    is_varied: bool,
}

/// Number of channels of the images in [`Row`].
const CHANNELS: [usize; 7] = [3, 3, 4, 1, 1, 3, 4];

impl Row {
    /// Computes a row. Each traced pixel may represent a block of `coarse_px` by `coarse_px` pixels.
    fn of(width: usize, y: u32, coarse_px: u32, accumulator: &Accumulator, front: &Sums) -> Self {
        let mut row = Self { samples: CHANNELS.map(|n| Vec::with_capacity(n * width)), ..Self::default() };
        let blocks = (width as u32).div_ceil(coarse_px);
        for block in 0..blocks {
            let index = accumulator.whole.index((block, y / coarse_px));
            let count = coarse_px.min(width as u32 - block * coarse_px) as usize;
            row.add(count, index, accumulator, front);
        }
        row
    }

    /// Adds the traced pixel `index`, `count` times.
    fn add(&mut self, count: usize, index: usize, accumulator: &Accumulator, front: &Sums) {
        let (sums, n) = accumulator.pixel(index);
        let spread = accumulator.variances(index);
        // R1 is R0 plus a change, whose errors may be correlated.
        let with = spread.without.sqrt() + spread.change.sqrt();
        let spreads = [spread.without, with * with, spread.object];
        let all = [spreads[0], spreads[1], spreads[2], spread.ratio];
        let stored = all.map(|v| (v as f32).min(f32::MAX));
        let is_beyond = |(v, to): (f64, f32)| v > f64::from(f32::MAX) || (v > 0.0 && to == 0.0);
        let beyond = all.into_iter().zip(stored).filter(|pair| is_beyond(*pair)).count() as u64;
        let values = &front.sums[index * FIRST_HIT..(index + 1) * FIRST_HIT];
        let colour = [0, 1, 2].map(|c| (sums[c] / n) as f32);
        let with = [0, 1, 2].map(|c| (sums[R0 + c] / n) as f32);
        let object = [4, 5, 6, 7].map(|c| (sums[R0 + c] / n) as f32);
        let pixel: [&[f32]; 7] =
            [&colour, &with, &object, &values[..1], &values[1..2], &values[2..], &stored];
        for _ in 0..count {
            self.samples.iter_mut().zip(pixel).for_each(|(row, pixel)| row.extend_from_slice(pixel));
            self.spreads.push(spreads);
            self.beyond += beyond;
        }
        self.is_varied |= n > 1.0;
    }
}

impl Accumulator {
    /// Computes the images of a camera from the sums of all samples. Each traced pixel may represent a block of pixels.
    pub(crate) fn finish(
        &self,
        camera: &Camera,
        coarse_px: u32,
        front: &Sums,
        reached: Option<ReachedError>,
        cx: &Context,
    ) -> Result<FinishedView, NodeError> {
        let (width, height) = (camera.width_px as usize, camera.height_px as usize);
        let rows = cx.for_each_tile(height, |y| Row::of(width, y as u32, coarse_px, self, front))?;
        let mut samples = CHANNELS.map(|channels| Vec::with_capacity(channels * width * height));
        let (mut means, mut errors, mut beyond, mut told_any) = ([0.0; 3], [0.0; 3], 0, false);
        // The order of the sums is that of the pixels, whatever thread computed them.
        for row in rows {
            let colours = row.samples.each_ref().map(Vec::as_slice);
            for (mean, (row, channels)) in means.iter_mut().zip(colours.into_iter().zip(CHANNELS)) {
                for pixel in row.chunks_exact(channels) {
                    *mean += f64::from(luminance([pixel[0], pixel[1], pixel[2]]));
                }
            }
            for spreads in &row.spreads {
                errors.iter_mut().zip(spreads).for_each(|(sum, v)| *sum += v);
            }
            beyond += row.beyond;
            told_any |= row.is_varied;
            samples.iter_mut().zip(row.samples).for_each(|(all, row)| all.extend(row));
        }
        let [without, with, object, depth, nearest, normal, variance] = samples;
        let images = [(without, 3), (with, 3), (object, 4)]
            .map(|(samples, channels)| Image::<Linear>::from_samples(width, height, channels, samples));
        let [depth, nearest, normal, variance] = [(depth, 1), (nearest, 1), (normal, 3), (variance, 4)]
            .map(|(samples, channels)| Image::from_samples(width, height, channels, samples));
        let all = (width * height).max(1) as f64;
        let mut rays = self.rays;
        rays += front.rays;
        let mut row = vec![Cell::Text(camera.name.clone())];
        for k in 0..3 {
            row.push(Cell::Number(means[k] / all));
            row.push(if told_any { Cell::Number((errors[k] / all).sqrt()) } else { Cell::Missing });
        }
        row.push(Cell::Count(rays.all()));
        let [traced, untouched, cropped] = self.pixels.map(|n| n as f64);
        row.extend([untouched, cropped].map(|n| Cell::Number(n / traced.max(1.0))));
        let covered: f64 = (0..self.samples.len()).map(|index| self.pixel(index).0[R0 + 7]).sum();
        let [cut, behind] = [self.cut, self.behind].map(|count| count as f64 / covered.max(1.0));
        let cropped = (cropped / traced.max(1.0), f64::from(self.bound));
        Ok(FinishedView {
            images,
            depth,
            nearest,
            normal,
            variance,
            row,
            rays,
            broken: self.broken,
            beyond,
            cut,
            behind,
            cropped,
            reached,
        })
    }
}
