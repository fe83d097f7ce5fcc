//! Measures the error of the ratio S = `with` / `without`, before and after denoising, and the CPU seconds spent.

use std::collections::BTreeMap;

use nodes::kinds::path_trace::surroundings::Surroundings;
use scene::types::Images;
use testkit::{Case, Data, Traced, denoised, relative_mse, rgb};

/// Number of seeds. Reported errors are means over the seeds, and reported CPU seconds are medians.
const SEEDS: u64 = 3;

/// Root mean square errors of S, where S is first clamped to at most 1. The first error is over the pixels that the
/// object does not cover, the second over the pixels that it partly covers.
fn errors(alpha: &Images, [r0, r1]: [&Images; 2], [b0, b1]: &[Vec<f32>; 2]) -> [f64; 2] {
    let (r0, r1, alpha) = (rgb(r0), rgb(r1), alpha.0[0].picture.samples());
    let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
    for i in (0..r0.len()).filter(|&i| b0[i] > 0.02) {
        let covered = alpha[i / 3 * 4 + 3];
        let rim = usize::from(covered > 0.0);
        let d = f64::from((r1[i] / r0[i]).min(1.0) - (b1[i] / b0[i]).min(1.0));
        if covered < 1.0 {
            sums[rim] += d * d;
            counts[rim] += 1.0;
        }
    }
    [0, 1].map(|k| (sums[k] / f64::max(counts[k], 1.0)).sqrt())
}

/// Prints the table. If `small` is true, only checks that the code runs. The sum of all columns of seconds is the
/// cost of a new picture after the object is moved. If the object is only rotated, `without` stays valid, so the
/// cost is the sum of the columns for the object and the filter.
pub fn table(data: &Data, numbers: &[u32], small: bool) {
    let (seeds, most) = if small { (1, 8) } else { (SEEDS, 128) };
    let case = Case::load(data, "sunny_plane");
    let reference = ["R0", "R1"].map(|layer| case.reference(&format!("ref-cycles/{layer}.exr")));
    let converged = rgb(&case.trace(99, most, true, Surroundings::OPEN).out.object);
    println!(
        "| samples | `without`, CPU-s | `objects` | filter | S and its rim, raw | denoised | O, raw | denoised |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut more = Vec::new();
    for &samples in numbers {
        let (mut squares, mut seconds) = ([[0.0; 2]; 2], [const { Vec::new() }; 3]);
        let (mut objects, mut counts) = ([0.0; 2], BTreeMap::new());
        for seed in 1..=seeds {
            let trace = |with| case.trace(seed, samples, with, Surroundings::OPEN);
            let (alone, all) = (trace(false), trace(true));
            let Traced { out, .. } = all;
            let (filtered, spent) = denoised(&out, data);
            let reported = [
                errors(&out.object, [&out.without, &out.with], &reference),
                errors(&out.object, [&filtered.without, &filtered.with], &reference),
            ];
            for (square, error) in squares.iter_mut().flatten().zip(reported.iter().flatten()) {
                *square += error * error / seeds as f64;
            }
            for (sum, images) in objects.iter_mut().zip([&out.object, &filtered.object]) {
                *sum += relative_mse(&rgb(images), &converged) / seeds as f64;
            }
            for (list, s) in seconds.iter_mut().zip([alone.seconds, all.seconds - alone.seconds, spent]) {
                list.push(s);
            }
            counts = all.counts;
        }
        let [raw, filtered] = squares.map(|of| of.map(f64::sqrt));
        let [r0, pair, filter] = seconds.map(|mut list: Vec<f64>| {
            list.sort_by(f64::total_cmp);
            list[list.len() / 2]
        });
        println!(
            "| {samples} | {r0:.3} | {pair:.3} | {filter:.3} | {:.4}, {:.4} | {:.4}, {:.4} | {:.1e} | {:.1e} |",
            raw[0], raw[1], filtered[0], filtered[1], objects[0], objects[1]
        );
        more.push(format!("{samples} samples: {counts:?}"));
    }
    println!("\n{}\n", more.join("\n"));
}
