//! How time and memory grow with the scene, and what a second thread costs. For the memory, set
//! `MALLOC_MMAP_THRESHOLD_=65536`: what the allocator keeps of an earlier run would hide a peak.

use std::sync::atomic::{AtomicBool, Ordering};

use engine::Artifact;
use fearless_simd::Level;
use glam::DVec3;
use nodes::splat::{Settings, render_clocked};
use nodes::types::Splats;

use crate::{Bench, cpu_seconds};

/// Runs that a time is the mean of.
const RUNS: u32 = 10;

/// The `count` splats nearest to a point, in file order.
fn crop(scene: &Splats, middle: DVec3, count: usize) -> Splats {
    let mut order: Vec<usize> = (0..scene.len()).collect();
    order.sort_by(|a, b| {
        let distance = |i: usize| (scene.mean(i) - middle).length_squared();
        distance(*a).total_cmp(&distance(*b)).then(a.cmp(b))
    });
    order.truncate(count);
    order.sort_unstable();
    let each = scene.sh_len();
    Splats {
        means: order.iter().map(|i| scene.means[*i]).collect(),
        means_low: order.iter().filter_map(|i| scene.means_low.get(*i).copied()).collect(),
        quats: order.iter().map(|i| scene.quats[*i]).collect(),
        scales: order.iter().map(|i| scene.scales[*i]).collect(),
        opacities: order.iter().map(|i| scene.opacities[*i]).collect(),
        sh: order.iter().flat_map(|i| &scene.sh[i * each..(i + 1) * each]).copied().collect(),
        ..*scene
    }
}

/// What this process holds, in MiB.
fn held() -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|rest| rest.split_whitespace().next()?.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}

/// The most that is held while `work` runs beyond what is held before it, in MiB, looked at every
/// half millisecond.
fn peak(mut work: impl FnMut()) -> f64 {
    let (before, done) = (held(), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let watch = scope.spawn(|| {
            let mut most = before;
            while !done.load(Ordering::Relaxed) {
                most = held().max(most);
                std::thread::sleep(std::time::Duration::from_micros(500));
            }
            most
        });
        work();
        done.store(true, Ordering::Relaxed);
        watch.join().unwrap() - before
    })
}

pub fn table(bench: &Bench) {
    let garden = bench.garden();
    let camera = bench.camera("garden_A2_tilted");
    let forward = camera.world_from_camera().z_axis.truncate();
    let middle = camera.eye() + forward * 5.0;
    println!(
        "\n| splats | seen | M blends | threads | CPU ms | project | sort | bin | blend | data MiB | peak beyond it MiB |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    // Threads that end take their CPU time with them.
    let pools = [1, 2].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap());
    for count in [10_000, 30_000, 100_000, 300_000, garden.len()] {
        let scene = crop(&garden, middle, count);
        for (threads, pool) in (1..).zip(&pools) {
            let draw = || {
                let settings = Settings::default();
                let clock = &cpu_seconds;
                pool.install(|| {
                    render_clocked(&scene, &camera, &settings, &bench.cx, Level::new(), clock).unwrap()
                })
            };
            let first = draw();
            let peak = peak(|| (0..3).for_each(|_| drop(draw())));
            // The kernel counts in ticks: means of many, not the least.
            let mut sums = [0.0; 4];
            for _ in 0..RUNS {
                sums.iter_mut().zip(draw().seconds).for_each(|(sum, s)| *sum += s);
            }
            let [project, sort, bin, blend] = sums.map(|s| s * 1e3 / f64::from(RUNS));
            println!(
                "| {} | {} | {:.2} | {threads} | {:.1} | {project:.1} | {sort:.1} | {bin:.1} | {blend:.1} | {:.1} | {peak:.1} |",
                scene.len(),
                first.work.projected,
                first.work.blends as f64 / 1e6,
                project + sort + bin + blend,
                scene.bytes() as f64 / (1 << 20) as f64,
            );
        }
    }
}
