//! CPU seconds of `splat-render` on one core, stage by stage, for every instruction set of this machine, beside the
//! rate of its own arithmetic on one tile that stays in cache; and six faces of a cube one by one and in one pass. `cargo bench -p lightharmony-nodes --bench splat [-- META.json ...]`; without
//! files a cloud made from a seed.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a bench prints, and may stop")]

use std::time::Instant;

use engine::{Context, InputFile, Kind, Scene, Up};
use fearless_simd::Level;
use glam::{DMat4, DVec3};
use nodes::cube_rig::{self, CubeRig, Turn};
use nodes::load_splats::{self, LoadSplats};
use nodes::splat::{Rendered, Settings, Sort, Work, calibrate, render, render_all, render_clocked};
use nodes::types::{Camera, Pose, Rig, SplatEncoding, Splats};

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
    for (name, level) in levels() {
        let peak = (0..5).map(|_| calibrate(20_000, level)).fold(0.0, f64::max);
        println!("{name}: one tile, every lane live: {:.3} G evaluations/s", peak / 1e9);
        for (view, tilted) in [("along an axis", false), ("tilted", true)] {
            let camera = camera(EYE, tilted);
            let settings = Settings::default();
            // The least of several runs: others share this machine.
            let best = (0..7)
                .map(|_| {
                    one.install(|| {
                        render_clocked(&splats, &camera, &settings, &cx, level, &cpu_seconds).unwrap()
                    })
                })
                .min_by(|a: &Rendered, b| a.seconds.iter().sum::<f64>().total_cmp(&b.seconds.iter().sum()))
                .unwrap();
            let [project, sort, bin, blend] = best.seconds.map(|s| s * 1e3);
            println!(
                "  {view}: {:.1} CPU-ms on one thread = project {project:.1} + sort {sort:.1} + bin {bin:.1} + blend {blend:.1}",
                project + sort + bin + blend
            );
            let rate = best.work.evaluations as f64 / (blend * 1e-3);
            println!(
                "    {:?}\n    blend: {:.3} G evaluations/s ({:.3} G blends/s), {:.0} % of that tile",
                best.work,
                rate / 1e9,
                best.work.blends as f64 / (blend * 1e-3) / 1e9,
                100.0 * rate / peak
            );
        }
    }
    cubes(&splats, &cx, &one);
}

const EYE: DVec3 = DVec3::new(4.02, -31.3, 0.2);

fn levels() -> Vec<(&'static str, Level)> {
    #[cfg(target_arch = "x86_64")]
    {
        let best = Level::new();
        let all = [
            ("SSE2", best.as_sse2().map(Level::Sse2)),
            ("SSE4.2", best.as_sse4_2().map(Level::Sse4_2)),
            ("AVX2", best.as_avx2().map(Level::Avx2)),
            ("AVX-512", best.as_avx512().map(Level::Avx512)),
        ];
        all.into_iter().filter_map(|(name, level)| Some((name, level?))).collect()
    }
    #[cfg(not(target_arch = "x86_64"))]
    vec![("best", Level::new())]
}

/// Six faces around a point, each on its own and all in one pass, turn by turn.
fn cubes(splats: &Splats, cx: &Context, one: &rayon::ThreadPool) {
    for size_px in [128, 512] {
        let params = CubeRig { height_metres: 0.0, size_px, guard_deg: 3.0, turn: Turn::OffAxis };
        let at = std::sync::Arc::new(Pose { world_from_local: DMat4::from_translation(EYE) });
        let (out, _) = CubeRig::run(&params, cube_rig::In { at }, cx).unwrap();
        let rig: &Rig = &out.rig;
        for sort in [Sort::Depth, Sort::Distance] {
            let settings = Settings { sort, ..Settings::default() };
            let alone = || rig.cameras.iter().map(|c| render(splats, c, &settings, cx).unwrap()).collect();
            let together = || render_all(splats, &rig.cameras, None, &settings, cx).unwrap();
            let ways: [(&str, &(dyn Fn() -> Vec<Rendered> + Sync)); 2] =
                [("one by one", &alone), ("one pass", &together)];
            let mut best = [f64::INFINITY; 2];
            let mut work = [Work::default(); 2];
            for _ in 0..5 {
                for (which, (_, way)) in ways.iter().enumerate() {
                    let (seconds, sum) = one.install(|| {
                        let start = cpu_seconds();
                        let mut sum = Work::default();
                        way().iter().for_each(|seen| sum += seen.work);
                        (cpu_seconds() - start, sum)
                    });
                    best[which] = best[which].min(seconds);
                    work[which] = sum;
                }
            }
            for which in 0..2 {
                println!(
                    "cube of {size_px} px, by {sort:?}, {}: {:.1} CPU-ms, {:?}",
                    ways[which].0,
                    best[which] * 1e3,
                    work[which]
                );
            }
        }
    }
}
