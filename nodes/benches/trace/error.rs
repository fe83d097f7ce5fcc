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

/// Prints the table of the open scene.
pub fn plane(data: &Path) {
    let case = Case::load(data, "sunny_plane");
    let outside = case.reference("ref-mitsuba/R0.exr");
    table("sunny_plane", &case, EnvBlock::Solid, Bounce::Solid, Some(&outside));
}

/// Prints those of the closed room.
pub fn rooms(data: &Path) {
    let case = Case::load(data, "closed_room");
    for bounce in [Bounce::Env, Bounce::Solid] {
        table("closed_room", &case, EnvBlock::FrontFace { max_layers: 3 }, bounce, None);
    }
}

fn table(name: &str, case: &Case, block: EnvBlock, bounce: Bounce, outside: Option<&[f32]>) {
    println!("{name} {block:?} {bounce:?}");
    // The same estimator with other random numbers: what it has in common with ours beside them, the tests
    // against other programs would show.
    let own = case.trace(99, 256, true, block, bounce);
    let [b0, b1, bo] = [&own.out.without, &own.out.with, &own.out.object].map(|i| rgb(i));
    for samples in [4, 16, 64] {
        let alone = case.trace(7, samples, false, block, bounce);
        let all = case.trace(7, samples, true, block, bounce);
        let [r0, r1, o] = [&all.out.without, &all.out.with, &all.out.object].map(|i| rgb(i));
        println!(
            "  {samples:4}: R0 {:.3} CPU-s {:.2e} ({:.2e}); R1 + O {:.3} CPU-s, R1 {:.2e}, O {:.2e}, S {:.4}; setup {:.3}",
            alone.seconds,
            relative_mse(&r0, &b0),
            outside.map_or(f64::NAN, |b| relative_mse(&r0, b)),
            all.seconds - alone.seconds,
            relative_mse(&r1, &b1),
            relative_mse(&o, &bo),
            ratio_error(&r0, &r1, &b0, &b1),
            all.setup,
        );
        println!("        {} | {}", alone.counts, all.counts);
    }
}
