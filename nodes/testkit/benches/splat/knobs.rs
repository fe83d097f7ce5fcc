//! Measures the loss of quality that each setting causes, in decibels, and the number of evaluations that it saves.

use render::splat::{Bounds, DepthMode, Precision, Rendered, Settings, Sort, render};
use scene::types::{Camera, Splats};
use testkit::psnr;

use crate::{Bench, millions, timed};

/// Renders at half the width and height, and enlarges the picture to full size by interpolation between pixel
/// centres.
fn at_half(scene: &Splats, camera: &Camera, settings: Settings, bench: &Bench) -> Rendered {
    let half = Camera {
        width_px: camera.width_px / 2,
        height_px: camera.height_px / 2,
        fx: camera.fx / 2.0,
        fy: camera.fy / 2.0,
        cx: camera.cx / 2.0,
        cy: camera.cy / 2.0,
        ..camera.clone()
    };
    let mut seen = render(scene, &half, None, &settings, &bench.cx).unwrap();
    let (width, height) = (half.width_px as usize, half.height_px as usize);
    let place = |i: usize, n: usize| {
        let at = ((i as f32 + 0.5) / 2.0 - 0.5).clamp(0.0, (n - 1) as f32);
        (at as usize, (at as usize + 1).min(n - 1), at.fract())
    };
    let mut rgba = Vec::with_capacity(seen.rgba.len() * 4);
    for y in 0..height * 2 {
        let (y0, y1, fy) = place(y, height);
        for x in 0..width * 2 {
            let (x0, x1, fx) = place(x, width);
            for c in 0..4 {
                let at = |x: usize, y: usize| seen.rgba[(y * width + x) * 4 + c];
                let top = at(x0, y0) * (1.0 - fx) + at(x1, y0) * fx;
                let bottom = at(x0, y1) * (1.0 - fx) + at(x1, y1) * fx;
                rgba.push(top * (1.0 - fy) + bottom * fy);
            }
        }
    }
    seen.rgba = rgba;
    seen
}

pub fn table(bench: &Bench) {
    for (name, scene) in [("garden_A2_tilted", bench.garden()), ("playbot_A_sh2", bench.playbot())] {
        let camera = bench.camera(name);
        let default = Settings::default();
        // `None` would take hours; below 1e-5 a splat adds nothing that a picture shows.
        let truth = Settings { precision: Precision::F64, alpha_cut: 1e-5, stop: 0.0, ..default };
        let truth = render(&scene, &camera, None, &truth, &bench.cx).unwrap();
        let mut rows = vec![
            ("default", default),
            ("precision F64", Settings { precision: Precision::F64, ..default }),
            ("bounds Inria", Settings { bounds: Bounds::Inria, ..default }),
            ("stop 0", Settings { stop: 0.0, ..default }),
            ("stop 1e-3", Settings { stop: 1e-3, ..default }),
            ("stop 1e-2", Settings { stop: 1e-2, ..default }),
            ("alpha_cut 1/1020", Settings { alpha_cut: 0.25 / 255.0, ..default }),
            ("alpha_cut 2/255", Settings { alpha_cut: 2.0 / 255.0, ..default }),
            ("alpha_cut 4/255", Settings { alpha_cut: 4.0 / 255.0, ..default }),
            ("alpha_cut 8/255", Settings { alpha_cut: 8.0 / 255.0, ..default }),
            ("alpha_cap 0.999", Settings { alpha_cap: 0.999, ..default }),
            ("sort Distance", Settings { sort: Sort::Distance, ..default }),
            ("compensation On", Settings { compensate: true, ..default }),
            ("low_pass_px2 0.1", Settings { low_pass_px2: 0.1, ..default }),
            ("depth Median", Settings { depth: DepthMode::Median, ..default }),
            ("depth Transmittance", Settings { depth: DepthMode::Transmittance, ..default }),
            ("count_blends", Settings { count_blends: true, ..default }),
        ];
        if scene.sh_degree > 0 {
            rows.push(("sh_degree 1", Settings { sh_degree: 1, ..default }));
            rows.push(("sh_degree 0", Settings { sh_degree: 0, ..default }));
        }
        println!("\n{name}, against F64 with `alpha_cut` 1e-5 and `stop` 0\n");
        println!("| setting | PSNR dB | largest error | M evaluations | M blends | CPU ms |");
        println!("|---|---|---|---|---|---|");
        let line = |name: &str, (seen, cpu): (Rendered, f64)| {
            let (psnr, largest) = psnr(&seen.rgba, 4, &truth.rgba, 4);
            println!(
                "| {name} | {psnr:.1} | {largest:.1e} | {:.2} | {:.2} | {:.0} |",
                millions(seen.work.evaluations),
                millions(seen.work.blends),
                cpu * 1e3
            );
        };
        for (name, settings) in rows {
            line(name, timed(3, || render(&scene, &camera, None, &settings, &bench.cx).unwrap()));
        }
        line("half the resolution", timed(3, || at_half(&scene, &camera, default, bench)));
    }
}
