//! Error of each output against samples and seconds.

use std::path::Path;

use nodes::kinds::path_trace::surroundings::Surroundings;
use nodes::math::color::luminance;

use super::case::{Case, Traced, relative_mse, rgb};

/// Root of the mean squared error of S over the receiver.
fn ratio_error(r0: &[f32], r1: &[f32], b0: &[f32], b1: &[f32]) -> f64 {
    let s = |r1: f32, r0: f32| f64::from((r1 / r0).clamp(0.0, 1.0));
    let (mut sum, mut n) = (0.0, 0.0);
    for i in (0..r0.len()).filter(|&i| b0[i] > 0.02 && r0[i] > 0.0) {
        let d = s(r1[i], r0[i]) - s(b1[i], b0[i]);
        sum += d * d;
        n += 1.0;
    }
    (sum / f64::max(n, 1.0)).sqrt()
}

/// Samples of the rows of a table, and of what they are compared with.
struct Effort {
    rows: &'static [u32],
    reference: u32,
}
const WHOLE: Effort = Effort { rows: &[4, 8, 16, 64], reference: 256 };
/// To see whether it runs.
const SMALL: Effort = Effort { rows: &[4], reference: 8 };

/// Prints the table of the open scene, or only tries it.
pub fn plane(data: &Path, small: bool) {
    let case = Case::load(data, "sunny_plane");
    let outside = case.reference("ref-mitsuba/R0.exr");
    let effort = if small { SMALL } else { WHOLE };
    table("sunny_plane", &case, Surroundings::OPEN, &outside, &effort);
}

/// Prints those of the closed room.
pub fn rooms(data: &Path) {
    let case = Case::load(data, "closed_room");
    for (tag, bounces) in [("env", false), ("solid", true)] {
        let outside = case.reference(&format!("ref-proto/R0-frontface-{tag}.exr"));
        table("closed_room", &case, Surroundings::Room { layers: 3, bounces }, &outside, &WHOLE);
    }
}

/// Difference of the luminance of two pictures with independent errors per pixel, over blocks of 8 by 8 pixels, in
/// standard errors from the spread within a block: the mean over the blocks, and the share of them beyond 3 (0.0039
/// for Student's distribution). Blocks without light are left out.
fn block_scores(ours: &[f32], other: &[f32], width: usize) -> (f64, f64) {
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

fn table(name: &str, case: &Case, how: Surroundings, outside: &[f32], effort: &Effort) {
    println!("{name} {how:?}\n");
    // The same estimator with other random numbers: errors common to both would show in the tests against other
    // programs.
    let own = case.trace(99, effort.reference, true, how);
    let [b0, b1, bo] = [&own.out.without, &own.out.with, &own.out.object].map(|i| rgb(i));
    println!(
        "| samples | `without`: CPU-s, error | `with` and `object`: CPU-s | error of `with`, `object` | error of S |"
    );
    println!("|---|---|---|---|---|");
    let mut more = Vec::new();
    for &samples in effort.rows {
        let alone = case.trace(7, samples, false, how);
        let all = case.trace(7, samples, true, how);
        let [r0, r1, o] = [&all.out.without, &all.out.with, &all.out.object].map(|i| rgb(i));
        println!(
            "| {samples} | {:.2}, {:.1e} ({:.1e}) | {:.2} | {:.1e}, {:.1e} | {:.4} |",
            alone.seconds,
            relative_mse(&r0, &b0),
            relative_mse(&r0, outside),
            all.seconds - alone.seconds,
            relative_mse(&r1, &b1),
            relative_mse(&o, &bo),
            ratio_error(&r0, &r1, &b0, &b1),
        );
        let (mean, beyond) = block_scores(&r0, outside, 192);
        more.push(format!(
            "{samples} samples: z of blocks of `without` {mean:.3} on average, {beyond:.4} beyond 3"
        ));
        more.push(format!(
            "{samples} samples: setup {:.3} CPU-s, {:?} | {:?}",
            all.setup, alone.counts, all.counts
        ));
    }
    println!("\n{}\n", more.join("\n"));
}

/// Prints what `crop` saves, and how far it is off, on the open scene from afar.
pub fn crop(data: &Path) {
    let (near, how) = (Case::load(data, "sunny_plane"), Surroundings::OPEN);
    println!("| seen from | `crop` | rays of `with` and `object` | CPU-s | largest error of S in a tile |");
    println!("|---|---|---|---|---|");
    for times in [1.0, 4.0, 12.0] {
        let case = near.with_camera_at(times);
        let alone = case.trace(7, 16, false, how);
        let full = case.cropped(99, 64, true, how, 0.0);
        for crop in [0.0, 0.001, 0.002, 0.004] {
            let all = case.cropped(7, 16, true, how, crop);
            let count = |traced: &Traced, name: &str| traced.counts[name];
            let tile = |i: usize| i / 3 / 192 / 8 * 24 + i / 3 % 192 / 8;
            let [r0, r1] = [&all.out.without, &all.out.with].map(|i| rgb(i));
            let [b0, b1] = [&full.out.without, &full.out.with].map(|i| rgb(i));
            let mut sums = vec![[0.0; 2]; 24 * 18];
            for i in (0..r0.len()).filter(|&i| r0[i] == r1[i] && b0[i] > 0.0) {
                sums[tile(i)][0] += f64::from(b1[i] / b0[i]) - 1.0;
                sums[tile(i)][1] += 1.0;
            }
            // Tiles that nothing asked, whole.
            let off = sums.iter().filter(|sum| sum[1] == 192.0).map(|sum| (sum[0] / sum[1]).abs());
            println!(
                "| {times} times as far | {crop} | {:.0} k | {:.3} | {:.5} |",
                (count(&all, "rays") - count(&alone, "rays")) as f64 / 1e3,
                all.seconds - alone.seconds,
                off.fold(0.0, f64::max),
            );
        }
    }
}
