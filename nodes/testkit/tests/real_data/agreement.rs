//! Tests of the comparison of splats and meshes: real and synthetic places, as they are and with faults.

use std::sync::Arc;

use engine::Kind;
use glam::{DMat3, DVec3};
use nodes::kinds::demo_scene::{self, DemoScene, Setting};
use nodes::kinds::load_mesh::ColourEncoding;
use nodes::math::equirect::axes;
use nodes::render::agreement::{Comparison, Finding, Place, compare};
use nodes::types::frame::Similarity;
use nodes::types::{Camera, Mesh, Splats};

use super::data;

/// A place with its mesh, wanted cameras and the middle of an object.
struct Scene {
    name: &'static str,
    splats: Arc<Splats>,
    mesh: Arc<Mesh>,
    cameras: Vec<Camera>,
    around: DVec3,
    /// A wall: points in front of it have a greater value along the axis.
    wall: (DVec3, f64),
}

fn bench() -> Scene {
    Scene {
        name: "bench case",
        splats: data().splats("bench-case/point_cloud.ply", &[], false),
        mesh: data().mesh("bench-case/mesh_proxy.ply", ColourEncoding::Auto).0,
        cameras: data().cameras("bench-case/case.json", "views", &[]).cameras.clone(),
        around: DVec3::new(0.4, 0.3, 0.45),
        wall: (DVec3::NEG_Y, -4.9),
    }
}

fn demo(name: &'static str, place: Setting, around: DVec3, wall: (DVec3, f64)) -> Scene {
    let params = DemoScene { place, width_px: 480, height_px: 270, truth_width_px: 16, ..DemoScene::default() };
    let made = DemoScene::run(&params, demo_scene::In {}, &data().context()).unwrap().0;
    Scene { name, splats: made.splats, mesh: made.proxy, cameras: made.rig.cameras.clone(), around, wall }
}

fn scenes() -> Vec<Scene> {
    vec![
        bench(),
        demo("demo courtyard", Setting::Courtyard, DVec3::new(0.0, 0.0, 0.3), (DVec3::NEG_Y, -4.6)),
        demo("demo room", Setting::Room, DVec3::new(0.0, 0.0, 0.7), (DVec3::NEG_Y, -1.9)),
    ]
}

fn compared(scene: &Scene, mesh: &Mesh, splats: &Splats) -> Option<Comparison> {
    let place = Place {
        splats,
        mesh,
        cameras: &scene.cameras,
        around: &[scene.around],
        axes: axes(engine::Up::PlusZ),
        metre: 1.0,
    };
    compare(&place, &data().context()).unwrap()
}

fn row(scene: &Scene, fault: &str, found: &Comparison, seconds: f64) {
    let best = found.best.map_or_else(String::new, |best| {
        let o = best.by.offset;
        format!(
            "{:.2}: x{:.4}, {:.1} deg, ({:.2}, {:.2}, {:.2})",
            best.agreement, best.by.scale, best.turn_deg, o.x, o.y, o.z
        )
    });
    println!(
        "| {} | {fault} | {:.3} | {best} | {:.4} {} {:.1} | {:.4} {} {:.1} | {:?} | {:?} | {seconds:.2} s |",
        scene.name, found.agreement, found.debris.share, found.debris.view, found.debris.at, found.missing.share, found.missing.view, found.missing.at, found.visible, found.findings()
    );
}

fn placed(mesh: &Mesh, by: &Similarity) -> Mesh {
    let at = |i: usize| by.point(mesh.position(i as u32)).as_vec3().to_array();
    let positions = (0..mesh.positions.len()).map(at).collect();
    Mesh { positions, positions_low: Vec::new(), ..mesh.clone() }
}

fn turn(axis: usize, quarters: usize) -> Similarity {
    let one = [
        DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
        DMat3::from_cols(DVec3::NEG_Z, DVec3::Y, DVec3::X),
        DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z),
    ][axis];
    let rotation = (0..quarters).fold(DMat3::IDENTITY, |all, _| one * all);
    Similarity { rotation, ..Similarity::IDENTITY }
}

/// A mesh with cubes in the air: their triangles are this share of all.
fn with_debris(scene: &Scene, share: f64, side: f64, reach: f64) -> Mesh {
    let mut mesh = (*scene.mesh).clone();
    let count = (share * mesh.triangles.len() as f64 / 12.0).ceil() as u32;
    let random = |i: u32, k: u32| nodes::geometry::sampling::fraction(nodes::geometry::sampling::hash(i, k));
    for i in 0..count {
        let spread = DVec3::new(random(i, 0) - 0.5, random(i, 1) - 0.5, random(i, 2) * 0.5) * (2.0 * reach);
        let middle = DVec3::new(scene.around.x, scene.around.y, scene.around.z) + spread;
        let first = mesh.positions.len() as u32;
        for corner in 0..8 {
            let sign = [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { 0.5 } else { -0.5 });
            mesh.positions.push((middle + DVec3::from_array(sign) * side).as_vec3().to_array());
            if !mesh.colours.is_empty() {
                mesh.colours.push([0.5; 3]);
            }
        }
        for [a, b, c, d] in [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]] {
            mesh.triangles.extend([[a, b, c], [a, c, d]].map(|t| t.map(|v| first + v)));
        }
    }
    mesh
}

fn without_wall(scene: &Scene) -> Mesh {
    let mut mesh = (*scene.mesh).clone();
    let (axis, at) = scene.wall;
    let middle = |t: &[u32; 3]| t.iter().map(|&i| scene.mesh.position(i)).sum::<DVec3>() / 3.0;
    // Floors and side walls stay: a wall faces along the axis.
    let faces = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| scene.mesh.position(i));
        (b - a).cross(c - a).normalize_or_zero().dot(axis).abs() > 0.5
    };
    mesh.triangles.retain(|t| middle(t).dot(axis) > at || !faces(t));
    mesh
}

#[test]
fn explore() {
    for scene in scenes() {
        let check = |fault: &str, mesh: &Mesh| {
            let begin = std::time::Instant::now();
            let found = compared(&scene, mesh, &scene.splats).unwrap();
            row(&scene, fault, &found, begin.elapsed().as_secs_f64());
        };
        check("", &scene.mesh);
        for scale in [0.01, 0.1, 0.5, 2.0, 100.0] {
            check(&format!("scale {scale}"), &placed(&scene.mesh, &Similarity { scale, ..Similarity::IDENTITY }));
        }
        for axis in 0..3 {
            for quarters in 1..4 {
                check(&format!("turn {axis} {quarters}"), &placed(&scene.mesh, &turn(axis, quarters)));
            }
        }
        for offset in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z] {
            let by = Similarity { offset: offset * 0.5, ..Similarity::IDENTITY };
            check(&format!("shift {offset}"), &placed(&scene.mesh, &by));
        }
        for (side, reach) in [(0.1, 2.0), (0.3, 2.0), (0.3, 4.0)] {
            check(&format!("debris {side} {reach}"), &with_debris(&scene, 0.05, side, reach));
        }
        check("wall", &without_wall(&scene));
    }
}
