//! Error of each output against samples and seconds.

use std::path::Path;

use nodes::path_trace::rules::{Bounce, EnvBlock};

use super::case::{Case, relative_mse, rgb};

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

/// Prints the table.
pub fn table(data: &Path) {
    let front = EnvBlock::FrontFace { max_layers: 3 };
    for (name, block, bounce) in [
        ("sunny_plane", EnvBlock::Solid, Bounce::Solid),
        ("closed_room", front, Bounce::Env),
        ("closed_room", front, Bounce::Solid),
    ] {
        let case = Case::load(data, name);
        println!("{name} {block:?} {bounce:?}");
        // The same estimator with other random numbers: what it has in common with ours beside them, the tests
        // against other programs would show.
        let own = case.trace(99, 256, true, block, bounce);
        let [b0, b1, bo] = [&own.out.without, &own.out.with, &own.out.object].map(|i| rgb(i));
        let outside = match name {
            "sunny_plane" => Some(case.reference("ref-mitsuba/R0.exr")),
            _ => None,
        };
        for samples in [4, 16, 64] {
            let alone = case.trace(7, samples, false, block, bounce);
            let all = case.trace(7, samples, true, block, bounce);
            let [r0, r1, o] = [&all.out.without, &all.out.with, &all.out.object].map(|i| rgb(i));
            println!(
                "  {samples:4}: R0 {:.3} CPU-s {:.2e} ({:.2e}); R1 + O {:.3} CPU-s, R1 {:.2e}, O {:.2e}, S {:.4}; setup {:.3}",
                alone.seconds,
                relative_mse(&r0, &b0),
                outside.as_ref().map_or(f64::NAN, |b| relative_mse(&r0, b)),
                all.seconds - alone.seconds,
                relative_mse(&r1, &b1),
                relative_mse(&o, &bo),
                ratio_error(&r0, &r1, &b0, &b1),
                all.setup,
            );
            if samples == 64 {
                println!("        {} | {}", alone.counts, all.counts);
            }
        }
    }
}
