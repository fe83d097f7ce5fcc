//! The frame of the world, and the camera.

use glam::DVec3;
use scene::math::num;
use scene::types::{Camera, Rig};

/// Conversion from metres in the frame of the scene to world units.
pub(super) struct WorldFrame {
    pub(super) axes: [DVec3; 3],
    pub(super) per_metre: f64,
}

impl WorldFrame {
    pub(super) fn turn(&self, v: DVec3) -> DVec3 {
        self.axes[0] * v.x + self.axes[1] * v.y + self.axes[2] * v.z
    }

    pub(super) fn point(&self, p: DVec3) -> DVec3 {
        self.turn(p) * self.per_metre
    }
}

/// The camera in the frame of the scene.
pub(super) struct DemoCamera {
    pub(super) eye: DVec3,
    pub(super) right: DVec3,
    pub(super) down: DVec3,
    pub(super) forward: DVec3,
    pub(super) focal: f64,
    pub(super) width: f64,
    pub(super) height: f64,
}

/// Horizontal angles by which the cameras of the capture are turned from the middle of the place, in degrees.
const TURNS: [f64; 4] = [0.0, 28.0, -8.0, -28.0];
/// Focal length of the cameras of the capture, as a multiple of the width of the picture.
const FOCAL: f64 = 0.625;

/// `count` cameras along the closed way through `places`, which are the positions of the capture in the frame of
/// the scene. Their pictures are `width_px` pixels wide.
pub(super) fn capture(places: &[DVec3], (count, width_px): (usize, u32), world: &WorldFrame) -> Rig {
    let middle = DVec3::new(0.0, 0.1, 0.55);
    let size = [width_px, (width_px * 2 / 3).max(1)];
    let camera = |i: usize| {
        let along = (i * places.len()) as f64 / count as f64;
        let (at, share) = (along as usize % places.len(), along.fract());
        let eye = places[at].lerp(places[(at + 1) % places.len()], share);
        let (sin, cos) = num::sin_cos_deg(TURNS[i % TURNS.len()]);
        let way = middle - eye;
        let forward = DVec3::new(cos * way.x - sin * way.y, sin * way.x + cos * way.y, way.z).normalize();
        let right = forward.cross(DVec3::Z).normalize();
        let axes = [right, forward.cross(right), forward].map(|axis| world.turn(axis));
        let focal = FOCAL * f64::from(width_px);
        Camera::centred(&format!("capture{i:03}"), size, focal, axes, world.point(eye))
    };
    Rig { cameras: (0..count).map(camera).collect() }
}
