//! Frame of the scene: world axes and units, with the origin at the first camera.

use glam::{DVec3, Vec3};

/// Converts a length from metres to world units.
pub fn scene_units(metres: f64, metres_per_unit: f64) -> f32 {
    (metres / metres_per_unit) as f32
}

/// Converts a world position to the frame of the scene.
pub fn in_scene_frame(point: DVec3, origin: DVec3) -> Vec3 {
    (point - origin).as_vec3()
}
