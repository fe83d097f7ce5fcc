//! CPU seconds of `splat-render` on one core, stage by stage, beside the rate of its own arithmetic on one
//! tile that stays in cache. `cargo bench -p lightharmony-nodes --bench splat [-- META.json ...]`; without
//! files a cloud made from a seed.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a bench prints, and may stop")]

use std::time::Instant;

use engine::{Context, InputFile, Kind, Scene, Up};
use fearless_simd::Level;
use glam::{DMat4, DVec3};
use nodes::load_splats::{self, LoadSplats};
use nodes::splat::{Rendered, Settings, calibrate, render_clocked};
use nodes::types::{Camera, SplatEncoding, Splats};

/// A garden of 800 thousand splats, uniform in a slab before the camera.
fn cloud() -> Splats {
    let mut state = 1_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1 << 24) as f32
    };
    let n = 800_000;
    Splats {
        means: (0..n).map(|_| [next() * 40.0 - 20.0, next() * 60.0 - 30.0, next() * 8.0 - 2.0]).collect(),
        means_low: Vec::new(),
        quats: vec![[0.5, 0.5, -0.5, 0.5]; n],
        scales: (0..n).map(|_| [0.05 * next(), 0.03 * next(), 0.05 * next()]).collect(),
        opacities: (0..n).map(|_| next()).collect(),
        sh_degree: 0,
        sh: (0..n).map(|_| [next(), next(), next()]).collect(),
        encoding: SplatEncoding::Srgb,
        antialiased: false,
    }
}

/// A 640x480 view along -y with x to the left, tilted off the axes when asked.
fn camera(eye: DVec3, tilted: bool) -> Camera {
    let forward = if tilted { DVec3::new(-0.121_572, -0.990_128, -0.069_756) } else { DVec3::NEG_Y };
    let right = forward.cross(DVec3::Z).normalize();
    let down = forward.cross(right);
    let columns = [right, down, forward.normalize()].map(|axis| axis.extend(0.0));
    Camera {
        name: "bench".to_owned(),
        width_px: 640,
        height_px: 480,
        fx: 457.007_362,
        fy: 457.007_362,
        cx: 320.0,
        cy: 240.0,
        world_from_camera: DMat4::from_cols(columns[0], columns[1], columns[2], eye.extend(1.0))
            .to_cols_array(),
    }
}

/// CPU time of this thread, so that others on the machine do not enter; wall time where Linux does not
/// tell it.
fn cpu_seconds() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| START.get_or_init(Instant::now).elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

fn main() {
    let files: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with("--")).collect();
    let here = std::env::current_dir().unwrap();
    let cx = Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 1 }, here);
    let start = Instant::now();
    let splats = match files.split_first() {
        None => cloud(),
        Some((path, more)) => {
            let params = LoadSplats {
                path: InputFile(path.clone()),
                more: more.iter().cloned().map(InputFile).collect(),
                strict: false,
                max_extent: 1e6,
                frame: load_splats::Frame::ByFormat,
            };
            let (out, _) = LoadSplats::run(&params, load_splats::In {}, &cx).unwrap();
            std::sync::Arc::unwrap_or_clone(out.splats)
        }
    };
    println!("{} splats loaded in {:.3} s (all threads)", splats.len(), start.elapsed().as_secs_f64());
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let peak = (0..5).map(|_| calibrate(20_000)).fold(0.0, f64::max);
    println!("calibration, one tile, every lane live: {:.3} G evaluations/s", peak / 1e9);
    for (name, tilted) in [("along an axis", false), ("tilted", true)] {
        let camera = camera(DVec3::new(4.02, -31.3, 0.2), tilted);
        let settings = Settings::default();
        // The least of several runs: others share this machine.
        let best = (0..7)
            .map(|_| {
                one.install(|| {
                    render_clocked(&splats, &camera, &settings, &cx, Level::new(), &cpu_seconds).unwrap()
                })
            })
            .min_by(|a: &Rendered, b| a.seconds.iter().sum::<f64>().total_cmp(&b.seconds.iter().sum()))
            .unwrap();
        let [project, sort, bin, blend] = best.seconds.map(|s| s * 1e3);
        println!(
            "{name}: {:.1} CPU-ms on one thread = project {project:.1} + sort {sort:.1} + bin {bin:.1} + blend {blend:.1}",
            project + sort + bin + blend
        );
        let rate = best.work.evaluations as f64 / (blend * 1e-3);
        println!(
            "  {:?}\n  blend: {:.3} G evaluations/s, {:.0} % of the calibration",
            best.work,
            rate / 1e9,
            100.0 * rate / peak
        );
    }
}
