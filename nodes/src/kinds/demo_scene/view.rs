//! The frame of the world, and the camera.

use glam::DVec3;

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
