//! Tests of renders of objects with their own materials.

use std::sync::Arc;

use engine::{Kind, Notes, Up};
use glam::{DMat4, DVec3};
use nodes::kinds::path_trace::surroundings::Surroundings;
use nodes::kinds::path_trace::{self, PathTrace};
use scene::types::{Camera, Mesh, Placed, Rig};
use testkit::Data;

fn camera(eye: DVec3, target: DVec3, (width, height): (u32, u32), fov_y_deg: f64) -> Rig {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Y).normalize();
    let pose = DMat4::from_cols(
        right.extend(0.0),
        forward.cross(right).extend(0.0),
        forward.extend(0.0),
        eye.extend(1.0),
    );
    let f = f64::from(height) / 2.0 / scene::math::num::f64::tan(fov_y_deg.to_radians() / 2.0);
    let camera = Camera {
        name: "view".to_owned(),
        width_px: width,
        height_px: height,
        fx: f,
        fy: f,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
        lens: Default::default(),
        world_from_camera: pose.to_cols_array(),
    };
    Rig { cameras: vec![camera] }
}

/// Renders the object in a file of the shared data, on a floor 8 m wide under studio lamps. Returns the object
/// layer.
fn render(path: &str, scale: f64, at: DVec3, rig: Rig, samples: u32) -> (Vec<f32>, Notes) {
    let data = Data::shared(Up::PlusY, 7);
    let (object, notes) = data.object(&format!("gltf/{path}"));
    let world = DMat4::from_translation(at) * DMat4::from_scale(DVec3::splat(scale));
    let env = data.environment("hdri/studio_small_03_1k.hdr").0;
    // sRGB code 188.
    let floor = Mesh {
        positions: vec![[-4.0, 0.0, -4.0], [-4.0, 0.0, 4.0], [4.0, 0.0, 4.0], [4.0, 0.0, -4.0]],
        colours: vec![[0.5028865; 3]; 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    };
    let params = PathTrace {
        samples,
        max_bounces: 12,
        surroundings: Surroundings::OPEN,
        contact_metres: Some(0.0),
        crop: 0.0,
        ..PathTrace::default()
    };
    let inputs = path_trace::In {
        receiver: Arc::new(floor),
        objects: vec![Arc::new(Placed { object, world_from_object: world })],
        rig: Arc::new(rig),
        env,
        points: None,
    };
    let (out, _) = PathTrace::run(&params, inputs, &data.context()).unwrap();
    (out.object.0[0].picture.samples().to_vec(), notes)
}

// Every file is rendered completely.
#[test]
fn every_object_of_the_shared_data_shows() {
    for (path, scale, y, size) in [
        ("AlphaBlendModeTest.glb", 0.16, 0.02, 0.4),
        ("ClearCoatTest.glb", 0.075, 0.48, 1.1),
        ("DamagedHelmet.glb", 0.5, 0.46, 1.0),
        ("Duck.glb", 0.55, -0.055, 0.9),
        ("FlightHelmet/FlightHelmet.gltf", 1.35, 0.0, 1.0),
        ("TransmissionRoughnessTest.glb", 0.75, 0.38, 0.7),
    ] {
        let (eye, target) = (DVec3::new(0.6, 0.8, 2.2), DVec3::new(0.0, size / 2.0, 0.0));
        let (samples, notes) =
            render(path, scale, DVec3::new(0.0, y, 0.0), camera(eye, target, (40, 30), 32.0), 8);
        assert!(samples.iter().all(|v| v.is_finite() && *v >= 0.0), "{path}");
        let covered = samples.chunks(4).map(|p| f64::from(p[3])).sum::<f64>() / 1200.0;
        let light = samples.chunks(4).map(|p| f64::from(p[1])).sum::<f64>() / 1200.0;
        println!("{path}: covers {covered:.3}, mean green {light:.3}");
        assert!(covered > 0.05 && light > 0.3 * covered * 0.1, "{path}: {covered} {light}");
        assert!(!notes.is_degraded(), "{path}");
    }
}

// Mean of the object layer by Cycles 4.5 (128 samples, 192 x 144, its own reading of the file). See
// `docs/evidence/materials.md`.
#[test]
fn helmets_agree_with_cycles() {
    let helmet = camera(DVec3::new(0.7, 0.8, 1.7), DVec3::new(0.0, 0.48, 0.0), (96, 72), 36.0);
    let flight = camera(DVec3::new(0.6, 0.75, 2.0), DVec3::new(0.0, 0.42, 0.0), (96, 72), 30.0);
    let (damaged, worn) = ("DamagedHelmet.glb", "FlightHelmet/FlightHelmet.gltf");
    for (path, scale, y, rig, cycles, bound) in [
        (damaged, 0.5, 0.5, helmet, [0.229_20, 0.295_94, 0.318_57], 0.08),
        (worn, 1.3, 0.0, flight, [0.074_79, 0.060_66, 0.051_19], 0.11),
    ] {
        let (samples, _) = render(path, scale, DVec3::new(0.0, y, 0.0), rig, 32);
        for (k, cycles) in cycles.into_iter().enumerate() {
            let mean = samples.chunks(4).map(|p| f64::from(p[k])).sum::<f64>() / (96.0 * 72.0);
            println!("{path}: channel {k}: {mean:.4} of {cycles:.4}, ratio {:.4}", mean / cycles);
            assert!((mean / cycles - 1.0).abs() < bound, "{path} {k}: {mean} of {cycles}");
        }
    }
}
