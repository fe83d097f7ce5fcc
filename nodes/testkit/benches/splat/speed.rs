//! Measures the CPU time of each stage of rendering a view on one thread, for every instruction set that this
//! machine supports. For comparison, also measures the speed of the blending arithmetic alone, on one tile that
//! stays in the L1 cache.

use fearless_simd::Level;
use render::splat::{Clock, Rendered, Settings, calibrate, render_at};

use testkit::thread_seconds;

use crate::{Bench, millions};

/// Number of runs. Only the shortest run counts, since other programs may slow down the others.
const RUNS: usize = 9;

fn levels() -> Vec<(&'static str, Level)> {
    #[cfg(target_arch = "x86_64")]
    {
        let best = Level::new();
        let all = [
            ("SSE2", best.as_sse2().map(Level::Sse2)),
            ("AVX2", best.as_avx2().map(Level::Avx2)),
            ("AVX-512", best.as_avx512().map(Level::Avx512)),
        ];
        all.into_iter().filter_map(|(name, level)| Some((name, level?))).collect()
    }
    #[cfg(not(target_arch = "x86_64"))]
    vec![("best", Level::new())]
}

pub fn table(bench: &Bench) {
    let scene = bench.garden();
    let settings = Settings::default();
    println!(
        "{} splats, 640x480, `Exact`, `F32`, one thread; G is 10^9 evaluations per CPU second\n",
        scene.len()
    );
    println!(
        "| view | instructions | CPU ms | project | sort | bin | blend | seen | M evaluations | M blends | G, one tile | G, blend | share |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for name in ["garden_A", "garden_A2_tilted"] {
        let camera = bench.camera(name);
        for (level_name, level) in levels() {
            let draw = || {
                let how: (Level, Clock<'_>) = (level, &thread_seconds);
                render_at(&scene, &camera, None, &settings, &bench.cx, how).unwrap()
            };
            let total = |seen: &Rendered| seen.seconds.iter().sum::<f64>();
            // In turns, so that other programs on the machine affect both alike.
            let (mut peak, mut best) = (0.0_f64, None);
            for _ in 0..RUNS {
                peak = peak.max(calibrate(20_000, level, &thread_seconds, &bench.cx));
                let seen = bench.one.install(draw);
                if best.as_ref().is_none_or(|least| total(&seen) < total(least)) {
                    best = Some(seen);
                }
            }
            let best = best.unwrap();
            let [project, sort, bin, blend] = best.seconds.map(|s| s * 1e3);
            let rate = best.work.evaluations as f64 / (blend * 1e-3);
            println!(
                "| {name} | {level_name} | {:.1} | {project:.1} | {sort:.1} | {bin:.1} | {blend:.1} | {} | {:.2} | {:.2} | {:.2} | {:.2} | {:.0} % |",
                total(&best) * 1e3,
                best.work.projected,
                millions(best.work.evaluations),
                millions(best.work.blends),
                peak / 1e9,
                rate / 1e9,
                100.0 * rate / peak
            );
        }
    }
}
