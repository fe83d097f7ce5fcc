//! Prints the error of each output and the CPU seconds spent, for several numbers of samples per pixel.

use nodes::kinds::path_trace::surroundings::Surroundings;
use testkit::{Case, Data, Traced, block_scores, relative_mse, rgb};

/// Root mean square error of the ratio S = `with` / `without` over the pixels of the receiver.
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

/// Numbers of samples per pixel: one for each row of a table, and one for the reference.
struct Effort {
    rows: &'static [u32],
    reference: u32,
}
const WHOLE: Effort = Effort { rows: &[4, 8, 16, 64], reference: 256 };
/// A small amount of work, to check that the benchmark runs.
const SMALL: Effort = Effort { rows: &[4], reference: 8 };

/// Prints the table of the open scene. If `small` is true, takes few samples, only to check that the code runs.
pub fn plane(data: &Data, small: bool) {
    let case = Case::load(data, "sunny_plane");
    let outside = case.reference("ref-mitsuba/R0.exr");
    let effort = if small { SMALL } else { WHOLE };
    table("sunny_plane", &case, Surroundings::OPEN, &outside, &effort);
}

/// Prints the tables of the closed rooms.
pub fn rooms(data: &Data) {
    let case = Case::load(data, "closed_room");
    for (tag, bounces) in [("env", false), ("solid", true)] {
        let outside = case.reference(&format!("ref-proto/R0-frontface-{tag}.exr"));
        table("closed_room", &case, Surroundings::Room { layers: 3, bounces }, &outside, &WHOLE);
    }
}

fn table(name: &str, case: &Case, how: Surroundings, outside: &[f32], effort: &Effort) {
    println!("{name} {how:?}\n");
    // The reference is the same estimator with other random numbers. Systematic errors, which it shares, are
    // covered by the tests against other programs.
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
            "{samples} samples: z scores of the blocks of `without`: mean {mean:.3}, share above 3 {beyond:.4}"
        ));
        more.push(format!(
            "{samples} samples: setup {:.3} CPU-s, {:?} | {:?}",
            all.setup, alone.counts, all.counts
        ));
    }
    println!("\n{}\n", more.join("\n"));
}

/// Prints the time that `crop` saves and the error that it causes, for the open scene seen from several camera
/// distances.
pub fn crop(data: &Data) {
    let (near, how) = (Case::load(data, "sunny_plane"), Surroundings::OPEN);
    println!(
        "| camera distance | `crop` | rays of `with` and `object` | CPU-s | largest error of S in a tile |"
    );
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
            // Complete tiles that the object does not affect.
            let off = sums.iter().filter(|sum| sum[1] == 192.0).map(|sum| (sum[0] / sum[1]).abs());
            println!(
                "| {times} times | {crop} | {:.0} k | {:.3} | {:.5} |",
                (count(&all, "rays") - count(&alone, "rays")) as f64 / 1e3,
                all.seconds - alone.seconds,
                off.fold(0.0, f64::max),
            );
        }
    }
}
