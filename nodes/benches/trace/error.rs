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
    println!("{name} {block:?} {bounce:?}\n");
    // The same estimator with other random numbers: what it has in common with ours beside them, the tests
    // against other programs would show.
    let own = case.trace(99, 256, true, block, bounce);
    let [b0, b1, bo] = [&own.out.without, &own.out.with, &own.out.object].map(|i| rgb(i));
    println!(
        "| samples | `without`: CPU-s, error | `with` and `object`: CPU-s | error of `with`, `object` | error of S |"
    );
    println!("|---|---|---|---|---|");
    let mut more = Vec::new();
    for samples in [4, 16, 64] {
        let alone = case.trace(7, samples, false, block, bounce);
        let all = case.trace(7, samples, true, block, bounce);
        let [r0, r1, o] = [&all.out.without, &all.out.with, &all.out.object].map(|i| rgb(i));
        let outside = outside.map(|b| format!(" ({:.1e})", relative_mse(&r0, b))).unwrap_or_default();
        println!(
            "| {samples} | {:.2}, {:.1e}{outside} | {:.2} | {:.1e}, {:.1e} | {:.4} |",
            alone.seconds,
            relative_mse(&r0, &b0),
            all.seconds - alone.seconds,
            relative_mse(&r1, &b1),
            relative_mse(&o, &bo),
            ratio_error(&r0, &r1, &b0, &b1),
        );
        more.push(format!(
            "{samples} samples: setup {:.3} CPU-s, {} | {}",
            all.setup, alone.counts, all.counts
        ));
    }
    println!("\n{}\n", more.join("\n"));
}
