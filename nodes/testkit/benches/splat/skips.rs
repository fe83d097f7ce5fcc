//! Measures the time saved by skipping two types of work: blocks of splats outside all views, and the harmonics of
//! a scene of degree 0.

use std::sync::Arc;

use glam::DMat4;
use nodes::kinds::cube_rig::{self, CubeRig, Turn};
use render::splat::{Blocks, PanoramaCamera, Settings, Work, panorama, render_with};
use scene::types::{Camera, Pose, Splats};

use engine::{Kind, Up};

use crate::{Bench, EYE, timed};

/// Number of runs. Only the shortest run counts.
const RUNS: usize = 9;

pub fn table(bench: &Bench) {
    println!("one thread; runs with and without skipping alternate\n");
    println!("| scene | picture | M splats | skipped | CPU ms | CPU ms without skipping | saved |");
    println!("|---|---|---|---|---|---|---|");
    let mut shuffled = Splats::clone(&bench.garden());
    shuffle(&mut shuffled);
    let scenes =
        [("garden", bench.garden()), ("garden, shuffled", Arc::new(shuffled)), ("playbot", bench.playbot())];
    for (name, scene) in scenes {
        let camera = bench.camera(if name == "playbot" { "playbot_A_sh2" } else { "garden_A2_tilted" });
        let at = if name == "playbot" { camera.eye() } else { EYE };
        let faces = faces(bench, at);
        for (picture, cameras) in [("a view of 640x480", vec![camera]), ("6 faces of 256 px", faces)] {
            line(bench, name, picture, |settings| {
                let mut work = Work::default();
                let blocks = settings.skip_unseen.then(|| Blocks::of(&scene, &bench.cx).unwrap());
                cameras.iter().for_each(|c| {
                    work += render_with(&scene, blocks.as_ref(), c, None, settings, &bench.cx).unwrap().work;
                });
                work
            });
        }
        line(bench, name, "a panorama of 1024 px", |settings| {
            let around = PanoramaCamera { eye: at, up: Up::PlusZ, width_px: 1024 };
            panorama(&scene, &around, None, settings, &bench.cx).unwrap().work
        });
    }
}

fn line(bench: &Bench, scene: &str, picture: &str, draw: impl Fn(&Settings) -> Work + Sync) {
    let run = |skip_unseen| {
        bench.one.install(|| timed(1, || draw(&Settings { skip_unseen, ..Settings::default() })))
    };
    let (mut best, mut work) = ([f64::INFINITY; 2], Work::default());
    for _ in 0..RUNS {
        let (with, seconds) = run(true);
        best = [best[0].min(seconds), best[1].min(run(false).1)];
        work = with;
    }
    let all = work.visited + work.skipped;
    println!(
        "| {scene} | {picture} | {:.2} | {:.0} % | {:.1} | {:.1} | {:.0} % |",
        all as f64 / 1e6,
        100.0 * work.skipped as f64 / all as f64,
        best[0] * 1e3,
        best[1] * 1e3,
        100.0 * (1.0 - best[0] / best[1])
    );
}

fn faces(bench: &Bench, at: glam::DVec3) -> Vec<Camera> {
    let pose = Arc::new(Pose { world_from_local: DMat4::from_translation(at) });
    let params = CubeRig { height_metres: 0.0, size_px: 256, guard_deg: 3.0, turn: Turn::OffAxis };
    let (out, _) = CubeRig::run(&params, cube_rig::In { at: pose }, &bench.cx).unwrap();
    out.rig.cameras.clone()
}

/// Shuffles the splats, so that their order does not depend on their positions.
fn shuffle(splats: &mut Splats) {
    let mut state = 1_u64;
    let width = splats.sh_len();
    for last in (1..splats.len()).rev() {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let other = (state >> 33) as usize % (last + 1);
        splats.means.swap(last, other);
        if !splats.means_low.is_empty() {
            splats.means_low.swap(last, other);
        }
        splats.quats.swap(last, other);
        splats.scales.swap(last, other);
        splats.opacities.swap(last, other);
        (0..width).for_each(|k| splats.sh.swap(last * width + k, other * width + k));
    }
}
