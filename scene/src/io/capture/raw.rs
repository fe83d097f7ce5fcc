//! A camera as stored in a file.

use glam::{DMat3, DMat4, DVec3};

use super::distortion::Bend;

/// A camera as stored in a file.
#[derive(Debug, Clone)]
pub struct Raw {
    /// Name of the camera's picture, possibly with folder and extension.
    pub picture: String,
    /// Width of the picture in pixels.
    pub width: u64,
    /// Height of the picture in pixels.
    pub height: u64,
    /// Focal lengths fx and fy, and principal point cx and cy, in pixels.
    pub lens: [f64; 4],
    /// Lens distortion, if the camera has any.
    pub distortion: Option<Bend>,
    /// Pose of the camera, whose x axis points right, y down and z forward.
    pub world_from_camera: DMat4,
}

/// Camera pose, from COLMAP's rotation (a quaternion) and translation, which map from world to camera. `None` if
/// the quaternion has no direction.
pub fn from_colmap(q: [f64; 4], t: [f64; 3]) -> Option<DMat4> {
    let [w, x, y, z] = q;
    let length = (w * w + x * x + y * y + z * z).sqrt();
    if !(length > 0.0 && length.is_finite()) {
        return None;
    }
    let world_from_camera =
        DMat3::from_quat(glam::DQuat::from_xyzw(x / length, y / length, z / length, w / length)).transpose();
    let eye = -(world_from_camera * DVec3::from_array(t));
    Some(DMat4::from_cols(
        world_from_camera.x_axis.extend(0.0),
        world_from_camera.y_axis.extend(0.0),
        world_from_camera.z_axis.extend(0.0),
        eye.extend(1.0),
    ))
}
