//! Tests of the estimated up direction and floor height. Every scene of the shared data is tested after each of the
//! six rotations that map z to an axis, and after ten arbitrary rotations. `tests/tables/level.py` makes a table
//! from the output.

use std::sync::Arc;

use engine::{InputFile, Kind};
use glam::{DMat3, DQuat, DVec3};
use nodes::kinds::demo_scene::{self, DemoScene, Setting};
use nodes::kinds::load_splats::{self, LoadSplats};
use render::geometry::level::{self, LevelEstimate};
use scene::io::splats::{Frame, Row, Turn};
use scene::math::num;
use scene::types::Splats;

use super::data;

/// A scene. If they are known, its true up direction and the true height of its floor, in the frame of the scene.
struct Known {
    name: &'static str,
    splats: Arc<Splats>,
    truth: Option<(DVec3, f64)>,
    /// Maximum permitted errors of the up direction, in degrees, and of the floor height, in world units.
    bounds: (f64, f64),
}

fn file(name: &'static str, path: &str, truth: Option<(DVec3, f64)>, bounds: (f64, f64)) -> Known {
    let cx = data().context();
    let params = LoadSplats {
        path: InputFile(path.to_owned()),
        more: Vec::new(),
        strict: false,
        max_extent: 1e6,
        level: 0,
        frame: Frame::AsStored,
        matrix: None,
    };
    let splats = LoadSplats::run(&params, load_splats::In {}, &cx).unwrap().0.splats;
    Known { name, splats, truth, bounds }
}

fn demo(name: &'static str, place: Setting, floor: (f64, f64)) -> Known {
    let cx = data().context();
    let params = DemoScene {
        place,
        splats: 60_000,
        width_px: 320,
        height_px: 200,
        truth_width_px: 16,
        ..DemoScene::default()
    };
    let splats = DemoScene::run(&params, demo_scene::In {}, &cx).unwrap().0.splats;
    Known { name, splats, truth: Some((DVec3::Z, floor.0)), bounds: (1.0, floor.1) }
}

/// Scenes with their true values, from `README.md` of the data. For the garden, whose ground rises and falls by
/// 0.3, the true floor is the ground under the middle of the capture. Four scenes have no true values, so no
/// estimate for them may be confident: a failed phone capture, a failed training, 1000 splats of a scene, and a
/// chart.
fn scenes() -> Vec<Known> {
    let (y, z) = (DVec3::Y, DVec3::Z);
    vec![
        file("garden_sog", "splats/garden_sog", Some((z, -1.07)), (3.0, 0.35)),
        file("playbot_sog", "splats/playbot_sog/2_0", Some((-y, 0.0)), (1.0, 0.05)),
        file("bench-case", "bench-case/point_cloud.ply", Some((z, 0.0)), (1.0, 0.02)),
        demo("demo room", Setting::Room, (0.0, 0.03)),
        demo("demo courtyard", Setting::Courtyard, (0.0, 0.03)),
        file("trials/place", "trials/place.ply", Some((z, 0.0)), (1.0, 0.02)),
        file("trials/place_down_y", "trials/place_down_y.ply", Some((-y, 0.0)), (1.0, 0.02)),
        file("trials/place_unit_cube", "trials/place_unit_cube.ply", Some((z, 0.0)), (1.0, 0.02)),
        file("biker", "splats/biker.spz", Some((y, 0.0)), (5.0, 0.1)),
        file("arkit-room", "splats/arkit-room.splat", None, (0.0, 0.0)),
        file("sh3-7k", "splats/sh3-7k.inria.ply", None, (0.0, 0.0)),
        file("train-1000", "splats/train-1000.inria.ply", None, (0.0, 0.0)),
        file("trials/chart", "trials/chart.ply", None, (0.0, 0.0)),
    ]
}

/// The six rotations that map z to an axis, and ten arbitrary rotations.
fn rotations() -> Vec<DMat3> {
    let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let mut all: Vec<DMat3> = axes.map(|a| DMat3::from_quat(DQuat::from_rotation_arc(DVec3::Z, a))).into();
    all.extend((0..10).map(|i| {
        let t = f64::from(i);
        let q = DQuat::from_xyzw(
            num::f64::sin(t * 2.3),
            num::f64::cos(t * 1.7 + 1.0),
            num::f64::sin(t * 0.9 + 2.0),
            num::f64::cos(t * 3.1),
        );
        DMat3::from_quat(q.normalize())
    }));
    all
}

fn turned(splats: &Splats, rotation: DMat3) -> Splats {
    let mut splats = splats.clone();
    let (turn, n) = (Turn::new(rotation, 1.0, DVec3::ZERO), splats.sh_len());
    for i in 0..splats.len() {
        let mut row = Row {
            mean: splats.means[i],
            mean_low: splats.means_low.get(i).copied().unwrap_or_default(),
            quat: splats.quats[i],
            scale: splats.scales[i],
            opacity: splats.opacities[i],
        };
        turn.apply(&mut row, &mut splats.sh[i * n..(i + 1) * n]);
        (splats.means[i], splats.quats[i]) = (row.mean, row.quat);
    }
    splats.means_low.clear();
    splats
}

fn degrees(a: DVec3, b: DVec3) -> f64 {
    num::atan2(a.cross(b).length(), a.dot(b)).to_degrees()
}

/// Error of the estimated floor height at the point of the floor below the middle of the scene, measured along the
/// true up direction.
fn floor_off(found: &LevelEstimate, up: DVec3, floor: f64) -> f64 {
    let (own, centre) = (DVec3::from_array(found.up), DVec3::from_array(found.centre));
    (centre.dot(up) - floor) - (centre.dot(own) - found.floor)
}

/// Every fourth of sixteen positions, and all of them if `LIGHTHARMONY_POSITIONS` is `all`.
#[test]
fn up_and_floor_of_all_scenes_in_several_positions() {
    let step = if std::env::var("LIGHTHARMONY_POSITIONS").is_ok_and(|which| which == "all") { 1 } else { 4 };
    let (mut sure, mut known) = (0, 0);
    for scene in scenes() {
        let (mut right, mut unsure, mut wrong) = (0, 0, 0);
        let (mut worst, mut worst_floor, mut least) = (0.0_f64, 0.0_f64, 1.0_f64);
        for rotation in rotations().into_iter().step_by(step) {
            let found = level::of_splats(&turned(&scene.splats, rotation), None).expect("splats");
            least = least.min(found.confidence);
            let good = scene.truth.is_some_and(|(up, floor)| {
                let up = rotation * up;
                let (off, off_floor) =
                    (degrees(DVec3::from_array(found.up), up), floor_off(&found, up, floor).abs());
                if found.is_floor_sure() {
                    (worst, worst_floor) = (worst.max(off), worst_floor.max(off_floor));
                }
                off <= scene.bounds.0 && off_floor <= scene.bounds.1
            });
            match (found.is_floor_sure(), good) {
                (true, true) => right += 1,
                (true, false) => wrong += 1,
                (false, _) => unsure += 1,
            }
        }
        println!(
            "level | {} | {} | {right} | {unsure} | {wrong} | {least:.3} | {worst:.2} | {worst_floor:.3} |",
            scene.name,
            if scene.truth.is_some() { "yes" } else { "no" },
        );
        assert_eq!(wrong, 0, "{}: wrong and sure", scene.name);
        if scene.truth.is_some() {
            (sure, known) = (sure + right, known + right + unsure);
        }
    }
    println!("level of known scenes: {sure} of {known} right and sure");
    assert!(sure * 100 >= known * 88, "{sure} of {known}");
}
