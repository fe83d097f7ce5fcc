//! How time grows with the scene, and what a second thread costs and gives.

use fearless_simd::Level;
use glam::DVec3;
use nodes::splat::{Clock, Settings, render_at};
use nodes::types::Splats;

use crate::{Bench, cpu_seconds, millions, thread_seconds};

/// Runs of which the least time counts.
const RUNS: u32 = 15;

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

pub fn table(bench: &Bench) {
    let garden = bench.garden();
    let camera = bench.camera("garden_A2_tilted");
    let forward = camera.world_from_camera().z_axis.truncate();
    let middle = camera.eye() + forward * 5.0;
    println!(
        "one view at 640x480 of the splats nearest to a point 5 m before the camera, least of {RUNS} runs\n"
    );
    println!(
        "| splats | seen | M evaluations | M blends | threads | CPU ms | project | sort | bin | blend | busiest thread ms | wall ms |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let pools = [1, 2].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap());
    for count in [10_000, 30_000, 100_000, 300_000, garden.len()] {
        let scene = crop(&garden, middle, count);
        for (threads, pool) in (1..).zip(&pools) {
            let settings = Settings::default();
            let draw = || {
                pool.install(|| {
                    let how: (Level, Clock<'_>) = (Level::new(), &cpu_seconds);
                    render_at(&scene, &camera, None, &settings, &bench.cx, how).unwrap()
                })
            };
            let first = draw();
            let (mut stages, mut busiest, mut wall) = ([0.0; 4], f64::INFINITY, f64::INFINITY);
            let mut least = f64::INFINITY;
            for _ in 0..RUNS {
                let each = || pool.broadcast(|_| thread_seconds());
                let (before, start) = (each(), std::time::Instant::now());
                let seen = draw();
                wall = wall.min(start.elapsed().as_secs_f64() * 1e3);
                let after = each();
                let most = after.iter().zip(&before).map(|(after, before)| after - before);
                busiest = busiest.min(most.fold(0.0, f64::max) * 1e3);
                let total: f64 = seen.seconds.iter().sum();
                if total < least {
                    (least, stages) = (total, seen.seconds.map(|s| s * 1e3));
                }
            }
            let [project, sort, bin, blend] = stages;
            println!(
                "| {} | {} | {:.2} | {:.2} | {threads} | {:.1} | {project:.1} | {sort:.1} | {bin:.1} | {blend:.1} | {busiest:.1} | {wall:.1} |",
                scene.len(),
                first.work.projected,
                millions(first.work.evaluations),
                millions(first.work.blends),
                least * 1e3,
            );
        }
    }
}
