//! Compares every mode with the float64 references of `splat-refs`, and with this renderer in float64 if every
//! splat is evaluated at every pixel.

use render::splat::{Bounds, Precision, Settings, render};
use testkit::psnr;

use crate::{Bench, millions, timed};

/// Width and height in pixels of the part of a view in which every splat is evaluated at every pixel.
const PART: (u32, u32) = (32, 24);

pub fn table(bench: &Bench) {
    let (garden, playbot) = (bench.garden(), bench.playbot());
    println!("\n| view | bounds | precision | PSNR dB | largest error | M evaluations | M blends | CPU ms |");
    println!("|---|---|---|---|---|---|---|---|");
    let views = ["garden_A", "garden_A2_tilted", "garden_B_face90", "playbot_A_sh2"];
    for name in views {
        let scene = if name.starts_with("garden") { &garden } else { &playbot };
        let (camera, reference) = (bench.camera(name), bench.reference(name));
        for (bounds, precision) in [
            (Bounds::Inria, Precision::F64),
            (Bounds::Inria, Precision::F32),
            (Bounds::Exact, Precision::F32),
        ] {
            let settings = Settings { bounds, precision, ..Settings::default() };
            let runs = if precision == Precision::F64 { 1 } else { 3 };
            let (seen, cpu) = timed(runs, || render(scene, &camera, None, &settings, &bench.cx).unwrap());
            let (psnr, largest) = psnr(&seen.rgba, 4, &reference, 3);
            println!(
                "| {name} | {bounds:?} | {precision:?} | {psnr:.1} | {largest:.1e} | {:.1} | {:.2} | {:.0} |",
                millions(seen.work.evaluations),
                millions(seen.work.blends),
                cpu * 1e3
            );
        }
    }
    println!(
        "\n| central {}x{} pixels of view | against `None`, `F64`, with the same `alpha_cut` and `stop` | with `alpha_cut` 0 and `stop` 0 |",
        PART.0, PART.1
    );
    println!("|---|---|---|");
    for name in views {
        let scene = if name.starts_with("garden") { &garden } else { &playbot };
        let mut camera = bench.camera(name);
        camera.cx -= f64::from(camera.width_px - PART.0) / 2.0;
        camera.cy -= f64::from(camera.height_px - PART.1) / 2.0;
        (camera.width_px, camera.height_px) = PART;
        let draw = |settings: Settings| render(scene, &camera, None, &settings, &bench.cx).unwrap().rgba;
        let fast = draw(Settings::default());
        let same = Settings { bounds: Bounds::None, precision: Precision::F64, ..Settings::default() };
        let all = Settings { alpha_cut: 0.0, stop: 0.0, ..same };
        let cells = [same, all].map(|settings| {
            let (psnr, largest) = psnr(&fast, 4, &draw(settings), 4);
            format!("{psnr:.1} dB, largest {largest:.1e}")
        });
        println!("| {name} | {} | {} |", cells[0], cells[1]);
    }
}
