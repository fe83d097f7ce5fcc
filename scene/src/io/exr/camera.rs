//! Matrices of a camera in the standard attributes of OpenEXR.

use glam::{DMat4, DVec3, DVec4};

use crate::types::Camera;

/// The attributes `worldToCamera` and `worldToNDC`, for row vectors: a point `p` becomes `p M`, and the numbers are
/// listed row by row (`M44f` of Imath). Both follow RenderMan, as the OpenEXR standard does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraMatrices {
    /// From the world to the camera: x right, y up, z forward, in world units. This space is left-handed.
    pub world_to_camera: [f32; 16],
    /// From the world to the picture: after the division by w, (0, 0) is its upper left corner and (1, 1) its lower
    /// right corner. z is 1 - 1 / depth, so that the matrix can be inverted.
    pub world_to_ndc: [f32; 16],
}

impl CameraMatrices {
    /// The matrices of a camera.
    pub fn of(camera: &Camera) -> Self {
        let from_world = camera.camera_from_world();
        let up = DMat4::from_scale(DVec3::new(1.0, -1.0, 1.0));
        let [width, height] = [camera.width_px, camera.height_px].map(f64::from);
        // Columns for x, y, z and 1.
        let picture = DMat4::from_cols(
            DVec4::new(camera.fx / width, 0.0, 0.0, 0.0),
            DVec4::new(0.0, camera.fy / height, 0.0, 0.0),
            DVec4::new(camera.cx / width, camera.cy / height, 1.0, 1.0),
            DVec4::new(0.0, 0.0, -1.0, 0.0),
        );
        // The columns of a matrix for column vectors are the rows of the matrix for row vectors.
        let rows = |matrix: DMat4| matrix.to_cols_array().map(|v| v as f32);
        Self { world_to_camera: rows(up * from_world), world_to_ndc: rows(picture * from_world) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of the world fall on the pixels that the camera shows them in, and a camera that looks along +y with z
    /// up has x right, y up and z forward.
    #[test]
    fn points_fall_on_their_pixels() {
        let eye = DVec3::new(1.0, -4.0, 2.0);
        let camera = Camera {
            fx: 50.0,
            fy: 60.0,
            cx: 30.0,
            cy: 22.0,
            ..Camera::centred("v", [64, 48], 55.0, [DVec3::X, -DVec3::Z, DVec3::Y], eye)
        };
        let matrices = CameraMatrices::of(&camera);
        let times = |p: DVec3, m: &[f32; 16]| -> [f64; 4] {
            let p = [p.x, p.y, p.z, 1.0];
            std::array::from_fn(|column| (0..4).map(|row| p[row] * f64::from(m[4 * row + column])).sum())
        };
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        let axes = times(eye + DVec3::new(0.25, 2.0, 0.5), &matrices.world_to_camera);
        assert!(near(&axes, &[0.25, 0.5, 2.0, 1.0]), "{axes:?}");
        for (x, y, depth) in [(30.0, 22.0, 1.0), (0.0, 0.0, 3.0), (64.0, 48.0, 0.5)] {
            let way = DVec3::new((x - 30.0) / 50.0, 1.0, -(y - 22.0) / 60.0) * depth;
            let [u, v, z, w] = times(eye + way, &matrices.world_to_ndc);
            assert!(near(&[u / w, v / w, z / w, w], &[x / 64.0, y / 48.0, 1.0 - 1.0 / depth, depth]));
        }
    }
}
