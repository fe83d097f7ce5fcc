//! Measures how the rendering time grows with the number of splats, and how much elapsed time a second thread saves
//! and how much CPU time it adds.

use std::sync::Mutex;

use fearless_simd::Level;
use glam::DVec3;
use render::splat::{Clock, Settings, Work, render_at};
use scene::types::{Camera, Splats};

use testkit::{process_seconds, thread_seconds};

use crate::{Bench, millions};

/// Number of runs. Only the shortest run counts.
const RUNS: u32 = 15;

/// The `count` splats nearest to the point `middle`, in file order.
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
        "one view of 640x480 pixels of the splats nearest to a point 5 m in front of the camera, minimum of {RUNS} runs\n"
    );
    println!(
        "| splats | seen | M evaluations | M blends | threads | CPU ms | project | sort | bin | blend | free | busier thread ms | wall ms |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    let pools = [1, 2].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap());
    for count in [10_000, 30_000, 100_000, 300_000, garden.len()] {
        let scene = crop(&garden, middle, count);
        for (threads, pool) in (1..).zip(&pools) {
            let mut best = Run::NONE;
            let (mut work, mut wall) = (Work::default(), f64::INFINITY);
            for _ in 0..RUNS {
                let start = std::time::Instant::now();
                let (run, done) = pool.install(|| Run::of(&scene, &camera, bench));
                wall = wall.min(start.elapsed().as_secs_f64() * 1e3);
                (best, work) = (best.less(run), done);
            }
            let row = |[of_all, project, sort, bin, blend, free]: [f64; 6]| {
                format!("{of_all:.1} | {project:.1} | {sort:.1} | {bin:.1} | {blend:.1} | {free:.1}")
            };
            println!(
                "| {} | {} | {:.2} | {:.2} | {threads} | {} | {:.1} | {wall:.1} |",
                scene.len(),
                work.projected,
                millions(work.evaluations),
                millions(work.blends),
                row(best.all()),
                best.busier()[0],
            );
        }
    }
}

/// CPU time of each stage of rendering a picture, in milliseconds: project, sort, bin, blend, and freeing memory.
#[derive(Clone, Copy)]
struct Run {
    /// For each stage: CPU time of the drawing thread, and of all threads together.
    stages: [[f64; 2]; 5],
}

impl Run {
    const NONE: Self = Self { stages: [[f64::INFINITY; 2]; 5] };

    fn of(scene: &Splats, camera: &Camera, bench: &Bench) -> (Self, Work) {
        let laps = Mutex::new(Vec::new());
        let clock = || {
            laps.lock().unwrap().push([thread_seconds(), process_seconds()]);
            0.0
        };
        let how: (Level, Clock<'_>) = (Level::new(), &clock);
        let seen = render_at(scene, camera, None, &Settings::default(), &bench.cx, how).unwrap();
        clock();
        let laps = laps.into_inner().unwrap();
        let stages = std::array::from_fn(|i| [0, 1].map(|of| (laps[i + 1][of] - laps[i][of]) * 1e3));
        (Self { stages }, seen.work)
    }

    /// Returns the sum of the stages, followed by the stages.
    fn with_sum(stages: [f64; 5]) -> [f64; 6] {
        let [project, sort, bin, blend, free] = stages;
        [stages.iter().sum(), project, sort, bin, blend, free]
    }

    fn all(&self) -> [f64; 6] {
        Self::with_sum(self.stages.map(|[_, all]| all))
    }

    /// The sum and each stage, counting only the busier of two threads in each stage. This is the elapsed time if
    /// two cores are free.
    fn busier(&self) -> [f64; 6] {
        Self::with_sum(self.stages.map(|[own, all]| own.max(all - own)))
    }

    fn less(self, other: Self) -> Self {
        if other.busier()[0] < self.busier()[0] { other } else { self }
    }
}
