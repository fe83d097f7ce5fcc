//! Scores that compare pictures.

use scene::math::color::luminance;
use scene::math::num;
use scene::types::Images;

/// RGB samples of the first picture.
pub fn rgb(images: &Images) -> Vec<f32> {
    let picture = &images.0[0].picture;
    picture.samples().chunks(picture.size().2).flat_map(|p| [p[0], p[1], p[2]]).collect()
}

/// Mean of all samples.
pub fn mean(samples: &[f32]) -> f64 {
    samples.iter().map(|x| f64::from(*x)).sum::<f64>() / samples.len() as f64
}

/// Mean of `error^2 / (reference^2 + 0.01)`, which is the measure defined by the notes of `render-refs`.
pub fn relative_mse(ours: &[f32], reference: &[f32]) -> f64 {
    let pairs = ours.iter().zip(reference).map(|(a, r)| (f64::from(*a), f64::from(*r)));
    pairs.map(|(a, r)| (a - r) * (a - r) / (r * r + 0.01)).sum::<f64>() / ours.len() as f64
}

/// PSNR in dB for a peak of 1, and the largest deviation, over the first three channels. `seen` has `channels`
/// channels per pixel, and `truth` has `others`.
///
/// # Panics
/// If the pictures have different numbers of pixels.
pub fn psnr(seen: &[f32], channels: usize, truth: &[f32], others: usize) -> (f64, f64) {
    let (pixels, expected) = (seen.chunks_exact(channels), truth.chunks_exact(others));
    assert_eq!(pixels.len(), expected.len());
    let (mut squares, mut largest) = (0.0_f64, 0.0_f64);
    for (a, b) in pixels.zip(expected) {
        for c in 0..3 {
            let off = (f64::from(a[c]) - f64::from(b[c])).abs();
            squares += off * off;
            largest = largest.max(off);
        }
    }
    (-10.0 * num::f64::log10(squares / (truth.len() / others * 3) as f64), largest)
}

/// Compares the luminance of two pictures in which the errors of different pixels are independent. For each block
/// of 8 by 8 pixels, the mean difference is divided by its standard error, which is computed from the spread within
/// the block. Returns the mean of this score over the blocks, and the share of the blocks whose score is above 3
/// (0.0039 is expected from Student's distribution). Blocks without light are left out.
pub fn block_scores(ours: &[f32], other: &[f32], width: usize) -> (f64, f64) {
    let y = |rgb: &[f32]| f64::from(luminance([rgb[0], rgb[1], rgb[2]]));
    let apart: Vec<f64> = ours.chunks(3).map(y).zip(other.chunks(3).map(y)).map(|(a, b)| a - b).collect();
    let score = |block: usize| {
        let (left, top) = (block % (width / 8) * 8, block / (width / 8) * 8);
        let each = |i: usize| apart[(top + i / 8) * width + left + i % 8];
        let mean = (0..64).map(each).sum::<f64>() / 64.0;
        let square = (0..64).map(|i| (each(i) - mean) * (each(i) - mean)).sum::<f64>() / 63.0;
        (square > 0.0).then(|| mean / (square / 64.0).sqrt())
    };
    let scores: Vec<f64> = (0..apart.len() / 64).filter_map(score).collect();
    let n = scores.len() as f64;
    (scores.iter().sum::<f64>() / n, scores.iter().filter(|z| z.abs() > 3.0).count() as f64 / n)
}
