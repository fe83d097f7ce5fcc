//! Adaptive sampling: the number of samples per block of pixels for a target error.
//!
//! The first chunk is traced for the whole image. Then the error of each block of pixels is estimated from the
//! variance in the block. The block takes one further chunk after another until it reaches the target or the
//! maximum. So the number of samples of a block depends only on the inputs and the target, and its pixels equal,
//! bit for bit, those of an image that takes this number of samples everywhere. The tiles whose error is estimated
//! are large compared with a pixel, so that the value of a pixel hardly affects its number of samples. A strong
//! dependence would bias the value.

use engine::NodeError;

use super::accumulator::{Accumulator, ReachedError, TargetError};
use super::film::{Area, TILE, chunks};

/// Side, in tiles, of the blocks of pixels that all take the same number of samples.
const BLOCK: u32 = 4;
/// Number of blocks that are traced together. No thread waits at the end of a block, and a cancelled run keeps most of its
/// work.
const TOGETHER: usize = 16;
/// Share of the median of the image `without` below which receiver pixels are ignored. The default of
/// `shadow-ratio` is the same.
const DARK: f64 = 1e-3;
/// Maximum factor by which stratification is assumed to reduce the variance.
const GAIN: f64 = 16.0;
/// Multiple of its standard error that a ratio must exceed to be reliable. A smaller ratio may be due to a single
/// outlier path, so its error must not be measured relative to the ratio.
const SURE: f64 = 2.0;
/// If the error is not required, the pixels of a tile with the largest errors of the ratio are left out, one of 16 pixels.
/// Rare bright samples are as probable in all other pixels, so samples for their blocks alone would hardly make the picture
/// better, and a filter removes single dots.
const LEFT_OUT: usize = 16;
/// Number of degrees of freedom given to the variance of independent samples when it is mixed with the
/// variance between chunks, which is unreliable for few chunks and few pixels.
const PRIOR: f64 = 0.5;

/// Variance of the mean of a pixel, relative to the square of what its error is relative to.
#[derive(Debug, Clone, Copy)]
struct Noise {
    /// As if samples were independent.
    alone: f64,
    /// From the spread between chunks.
    apart: f64,
}

/// Target of adaptive sampling.
pub(crate) struct ErrorGoal {
    /// Target standard error; see [`ErrorGoal::error`].
    asked: TargetError,
    /// Mean luminance of the objects over the pixels that they cover.
    scale: f64,
    /// Minimum luminance that a pixel of the image `without` must have for its error to count.
    dark: f64,
    /// All chunks of samples that may be taken.
    chunks: Vec<(u32, u32)>,
}

impl ErrorGoal {
    /// Creates the target for an image whose first chunk is already traced.
    pub(crate) fn new(asked: TargetError, most: u32, accumulator: &Accumulator) -> Self {
        Self {
            asked,
            scale: accumulator.object_luminance(),
            dark: DARK * accumulator.mean_luminance(),
            chunks: chunks(most),
        }
    }

    /// Standard error of the worst tile of an area after a number of chunks. The error of a tile is the larger of
    /// two errors: the error of the ratio S = R1 / R0, weighted by the share of the pixel that objects do not
    /// cover, and the error of the objects relative to their mean light. Each of the two is the root mean square
    /// over the pixels of the tile whose error is not 0.
    ///
    /// S can be very large where objects light dark ground. If S exceeds 1, its error is divided by a lower
    /// confidence bound of S in the pixel or its tile, so that the error of a highlight is relative to the
    /// highlight. After one chunk, the error is computed as if samples were independent. After several chunks, it
    /// is computed from the spread between chunks, which has less weight if there are fewer pixels.
    ///
    /// If the error is not required, a few pixels with the largest errors of the ratio are left out ([`LEFT_OUT`]).
    fn error(&self, accumulator: &Accumulator, area: Area, chunks: usize) -> f64 {
        let mut worst = 0.0_f64;
        for tile in area.pieces(TILE) {
            let around = self.lit(accumulator, tile);
            let pixels: Vec<[Noise; 2]> = tile
                .each()
                .map(|pixel| self.noise(accumulator, accumulator.whole.index(pixel), around, chunks))
                .collect();
            for k in 0..2 {
                let share = if k == 0 && !self.asked.required { LEFT_OUT } else { usize::MAX };
                worst = worst.max(tile_error(pixels.iter().map(|pixel| pixel[k]), share, chunks));
            }
        }
        worst
    }

    /// Noise of the ratio and of the objects in a pixel, given the lower bound of the ratio around it.
    fn noise(&self, accumulator: &Accumulator, index: usize, around: f64, chunks: usize) -> [Noise; 2] {
        let spread = accumulator.variances(index);
        let seen = 1.0 - accumulator.alpha(index);
        let of_chunks = accumulator.variances_between_chunks(index, chunks);
        let [without, with, object_luminance] = accumulator.luminances(index);
        let scale = self.scale.max(object_luminance);
        let object = if scale > 0.0 { 1.0 / (scale * scale) } else { 0.0 };
        let shown =
            if without > self.dark { seen / reference(with / without, spread.ratio, around) } else { 0.0 };
        let of =
            |weight: f64, square: f64, apart: f64| Noise { alone: weight * square, apart: weight * apart };
        [of(shown * shown, spread.ratio, of_chunks[0]), of(object, spread.object, of_chunks[1])]
    }

    /// Lower confidence bound of the mean ratio over the part of a tile that objects do not cover.
    fn lit(&self, accumulator: &Accumulator, tile: Area) -> f64 {
        let (mut sum, mut noise, mut weight) = (0.0_f64, 0.0_f64, 0.0_f64);
        for pixel in tile.each() {
            let index = accumulator.whole.index(pixel);
            let seen = 1.0 - accumulator.alpha(index);
            let [without, with, _] = accumulator.luminances(index);
            if without > self.dark && seen > 0.0 {
                sum += seen * (with / without);
                noise += seen * seen * accumulator.variances(index).ratio;
                weight += seen;
            }
        }
        if weight > 0.0 { lower_bound(sum / weight, noise / (weight * weight)) } else { 0.0 }
    }

    /// Traces the samples that each block needs, by calls to `take`, which traces a range of samples of several areas.
    /// Reports progress as a share of the work, if all blocks need all samples.
    pub(crate) fn reach(
        &self,
        accumulator: &mut Accumulator,
        mut take: impl FnMut(&mut Accumulator, &[Area], (u32, u32)) -> Result<(), NodeError>,
        progress: impl Fn(f32),
    ) -> Result<ReachedError, NodeError> {
        let mut reached = ReachedError { asked: self.asked, ..ReachedError::default() };
        let whole = accumulator.whole;
        let samples =
            |chunks: usize| chunks.checked_sub(1).map_or(0.0, |last| f64::from(self.chunks[last].1));
        let blocks = whole.pieces(BLOCK * TILE);
        let firsts: Vec<f64> = blocks.iter().map(|&area| self.error(accumulator, area, 1)).collect();
        // Number of chunks taken, and error.
        let mut states: Vec<(usize, f64)> = firsts.iter().map(|&first| (1, first)).collect();
        for (chunk, &range) in self.chunks.iter().enumerate().skip(1) {
            let short: Vec<usize> =
                (0..blocks.len()).filter(|&index| states[index].1 > self.asked.error).collect();
            for (number, batch) in short.chunks(TOGETHER).enumerate() {
                let areas: Vec<Area> = batch.iter().map(|&index| blocks[index]).collect();
                take(accumulator, &areas, range)?;
                for &index in batch {
                    states[index] = (chunk + 1, self.error(accumulator, blocks[index], chunk + 1));
                }
                let done = ((number + 1) * TOGETHER).min(short.len()) as f32 / short.len() as f32;
                progress(
                    samples(chunk) as f32 / samples(self.chunks.len()) as f32
                        + (range.1 - range.0) as f32 * done / samples(self.chunks.len()) as f32,
                );
            }
        }
        let mut sum = 0.0;
        for ((&area, &first), &(taken, error)) in blocks.iter().zip(&firsts).zip(&states) {
            let promised = first * (samples(1) / samples(taken)).sqrt();
            reached.predicted = reached.predicted.max(promised);
            reached.worst = reached.worst.max(error);
            reached.blocks[0] += 1;
            reached.blocks[1] += u64::from(taken > 1);
            reached.blocks[2] += u64::from(error > self.asked.error);
            sum += samples(taken) * area.pixels() as f64;
        }
        reached.samples = sum / whole.pixels().max(1) as f64;
        Ok(reached)
    }
}

/// Root mean square of the errors of the pixels of a tile whose error is not 0. One of `share` pixels is left out, those with
/// the largest errors.
fn tile_error(pixels: impl Iterator<Item = Noise> + Clone, share: usize, chunks: usize) -> f64 {
    let noisy = pixels.filter(|noise| noise.alone > 0.0);
    let mut largest: Vec<f64> = noisy.clone().map(|noise| noise.alone).collect();
    largest.sort_unstable_by(|a, b| b.total_cmp(a));
    let Some(&most) = largest.get(largest.len() / share) else { return 0.0 };
    let (mut alone, mut squares, mut apart, mut count) = (0.0, 0.0, 0.0, 0.0);
    for noise in noisy.filter(|noise| noise.alone <= most) {
        alone += noise.alone;
        squares += noise.alone * noise.alone;
        apart += noise.apart;
        count += 1.0;
    }
    let freedom = chunks.saturating_sub(1) as f64 * effective(alone, squares);
    let mixed = (freedom * apart + PRIOR * alone) / (freedom + PRIOR);
    (mixed.max(alone / GAIN) / count).sqrt()
}

/// Value by which the error of a ratio is divided: the largest of 1, the lower confidence bound of the ratio, and
/// the lower confidence bound of the mean ratio of its tile. The bound of the tile counts only up to the ratio
/// itself. An uncertain pixel in a bright tile is not an outlier.
fn reference(ratio: f64, variance: f64, around: f64) -> f64 {
    lower_bound(ratio, variance).max(ratio.min(around)).max(1.0)
}

/// Lower confidence bound of a ratio, from its variance.
fn lower_bound(ratio: f64, variance: f64) -> f64 {
    if ratio > 0.0 { (ratio - SURE * SURE * variance / ratio).max(0.0) } else { 0.0 }
}

/// Effective number of values in a sum: the number of values if all are equal, and 1 if one value dominates.
fn effective(sum: f64, squares: f64) -> f64 {
    // Squares of the smallest variances underflow to 0.
    if squares > 0.0 { sum / squares * sum } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    // If one of n paths is an outlier, the error of the ratio is as large as the ratio, so its lower bound is 0.
    // The ratio of a pixel with light from many paths is reliable.
    #[test]
    fn a_dot_is_not_sure_and_a_light_is() {
        assert_eq!(lower_bound(8.0, 64.0), 0.0);
        assert!((lower_bound(8.0, 0.01) - 7.995).abs() < 1e-9);
        assert_eq!(lower_bound(0.0, 0.0), 0.0);
    }

    // A lamp on dark ground: its light is 2000 times the original light, and a single pixel is uncertain. The tile
    // has no effect on an outlier in an unlit tile, or on the dark side of the edge of a light.
    #[test]
    fn a_pixel_that_is_not_sure_is_judged_beside_what_its_tile_surely_is() {
        let tile = |others: [f64; 2], odd: [f64; 2]| {
            let (sum, noise) = (63.0 * others[0] + odd[0], 63.0 * others[1] * others[1] + odd[1] * odd[1]);
            lower_bound(sum / 64.0, noise / 4096.0)
        };
        let bright = tile([2000.0, 500.0], [1910.0, 1024.0]);
        assert!(bright > 1950.0 && lower_bound(1910.0, 1024.0 * 1024.0) == 0.0);
        assert!((1024.0 / reference(1910.0, 1024.0 * 1024.0, bright) - 0.54).abs() < 0.01);
        assert_eq!(reference(1.2, 0.01, bright), 1.2, "no more than it is");
        let dark = tile([1.0, 0.0], [64.0, 64.0]);
        assert_eq!(reference(64.0, 64.0 * 64.0, dark), 1.0);
    }

    /// A dot does not decide if dots are left out, and a line does. This test fails if `tile_error` leaves out the smallest
    /// errors, or none.
    #[test]
    fn dots_are_left_out_and_lines_are_not() {
        let error = |bright: usize, share| {
            let noise = |pixel| Noise { alone: if pixel < bright { 4.0 } else { 1e-3 }, apart: 0.0 };
            tile_error((0..64).map(noise), share, 1)
        };
        assert!((error(1, usize::MAX) - 0.252).abs() < 1e-3);
        assert!((error(1, LEFT_OUT) - 1e-3_f64.sqrt()).abs() < 1e-9);
        assert!(error(8, LEFT_OUT) > 0.5);
        // Few pixels are never left out, nor are those without noise counted.
        assert_eq!(
            tile_error([4.0, 0.0].map(|alone| Noise { alone, apart: 0.0 }).into_iter(), LEFT_OUT, 1),
            2.0
        );
        assert_eq!(tile_error(std::iter::empty(), LEFT_OUT, 1), 0.0);
    }

    #[test]
    fn variances_are_spread_over_as_many_pixels_as_have_them() {
        assert_eq!(effective(64.0, 64.0), 64.0);
        assert_eq!(effective(3.0, 9.0), 1.0);
        assert_eq!(effective(1e-200, 0.0), 0.0);
    }
}
