//! Light of the kind `lamp` on a floor, traced by `path-trace`, compared with the integral of its closed form.

#![allow(clippy::unwrap_used, reason = "a test")]

use std::f64::consts::PI;
use std::sync::Arc;

use engine::{Context, Kind, Scene, Up};
use glam::{DMat4, DVec3};
use nodes::kinds::lamp::{self, Lamp, LampShape};
use nodes::kinds::path_trace::surroundings::Surroundings;
use nodes::kinds::path_trace::{self, PathTrace};
use scene::math::num;
use scene::types::{Camera, Environment, Images, Mesh, Pose, Rig};

const ALBEDO: f32 = 0.5;
const LUMENS: f64 = 500.0;
const NITS: f64 = 120.0;
/// Half the side of the square of the floor that the camera sees, in metres.
const HALF: f64 = 8.0;
const PIXELS: u32 = 64;
const HEIGHT: f64 = 1.0;

fn floor() -> Mesh {
    let far = 30.0;
    Mesh {
        positions: vec![[-far, -far, 0.0], [far, -far, 0.0], [far, far, 0.0], [-far, far, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        colours: vec![[ALBEDO; 3]; 4],
        ..Mesh::default()
    }
}

/// A camera above the floor that looks straight down.
fn camera() -> Camera {
    let up = 40.0;
    let focal = f64::from(PIXELS) / (2.0 * HALF) * up;
    Camera::centred("v", [PIXELS; 2], focal, [DVec3::X, -DVec3::Y, -DVec3::Z], DVec3::Z * up)
}

fn samples(images: &Images) -> Vec<f64> {
    images.0[0].picture.samples().iter().map(|v| f64::from(*v)).collect()
}

/// Lumens that fall on the part of the floor that the camera sees, for a small lamp: the integral of the illuminance
/// over the floor.
fn expected(shape: LampShape) -> f64 {
    let steps = 800;
    let step = 2.0 * HALF / f64::from(steps);
    let at = |i: i32| -HALF + (f64::from(i) + 0.5) * step;
    let mut sum = 0.0;
    for y in 0..steps {
        for x in 0..steps {
            let square = at(x) * at(x) + at(y) * at(y) + HEIGHT * HEIGHT;
            let distance = square.sqrt();
            let cosine = HEIGHT / distance;
            // Candela: a sphere is equally bright on all sides, a disc or a panel sheds everything below.
            let intensity = match shape {
                LampShape::Sphere => LUMENS / (4.0 * PI),
                _ => LUMENS / PI * cosine,
            };
            sum += intensity * cosine / square;
        }
    }
    sum * step * step
}

/// The lamp lights the floor, and the lumens that arrive are those of the integral. The statistical error is below
/// 0.2 %. This test fails if the back of a disc or a panel is open, or if the area of the lamp is taken twice.
#[test]
fn the_lumens_of_a_lamp_arrive_on_the_floor() {
    let cx =
        Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 3, exhaustive: false }, ".");
    for shape in [LampShape::Disc, LampShape::Sphere, LampShape::Panel] {
        let p = Lamp {
            shape,
            radius_metres: 0.04,
            panel_metres: [0.06, 0.08],
            lumens: Some(LUMENS),
            white_nits: NITS,
            colour: [1.0, 0.7, 0.4],
            ..Lamp::default()
        };
        let pose = Pose { world_from_local: DMat4::from_translation(DVec3::Z * HEIGHT) };
        let (lamp, _) = Lamp::run(&p, lamp::In { pose: Arc::new(pose) }, &cx).unwrap();
        let inputs = path_trace::In {
            receiver: Arc::new(floor()),
            objects: vec![lamp.placed],
            rig: Arc::new(Rig { cameras: vec![camera()] }),
            env: Arc::new(Environment::constant(Up::PlusZ, [1e-3; 3], 16)),
            points: None,
        };
        let params = PathTrace {
            samples: 64,
            max_bounces: 0,
            surroundings: Surroundings::OPEN,
            contact_metres: Some(0.0),
            crop: 0.0,
            ..PathTrace::default()
        };
        let (out, _) = PathTrace::run(&params, inputs, &cx).unwrap();
        let (with, without) = (samples(&out.with), samples(&out.without));
        let change = with.chunks_exact(3).zip(without.chunks_exact(3)).map(|(with, without)| {
            let rgb: [f32; 3] = std::array::from_fn(|c| (with[c] - without[c]) as f32);
            scene::math::color::luminance(rgb)
        });
        let area = (2.0 * HALF / f64::from(PIXELS)) * (2.0 * HALF / f64::from(PIXELS));
        let arrived = num::ordered_sum(change) * area * NITS * PI / f64::from(ALBEDO);
        let ratio = arrived / expected(shape);
        assert!((ratio - 1.0).abs() < 0.01, "{shape:?}: {arrived} lm, {ratio} of the integral");
        let middle = 3 * (PIXELS * PIXELS / 2 + PIXELS / 2) as usize;
        assert!(with[middle] > 10.0 * without[middle], "{shape:?} does not light the floor");
    }
}
