//! The equirectangular layout: the direction of each point of a panorama.
//!
//! Row 0 is up. The centre column looks forward, which is +Y if up is +z, -Z if up is +y, and +Z if up is -y. u
//! increases to the right of forward, clockwise as seen from above. Pixel centres lie at (i + 0.5) / N.

use std::f64::consts::PI;

use engine::Up;
use glam::{DMat3, DVec3};

use super::num;

/// The right, forward and up directions of a world, as unit vectors in world coordinates.
pub fn axes(up: Up) -> [DVec3; 3] {
    match up {
        Up::PlusZ => [DVec3::X, DVec3::Y, DVec3::Z],
        Up::PlusY => [DVec3::X, DVec3::NEG_Z, DVec3::Y],
        Up::MinusY => [DVec3::X, DVec3::Z, DVec3::NEG_Y],
    }
}

/// Unit direction of the point (u, v), both in [0, 1], v downwards from the zenith.
pub fn direction(up: Up, u: f64, v: f64) -> DVec3 {
    let [right, forward, above] = axes(up);
    let (sin_phi, cos_phi) = num::sin_cos(2.0 * PI * (u - 0.5));
    let (sin_theta, cos_theta) = num::sin_cos(PI * v);
    right * (sin_phi * sin_theta) + forward * (cos_phi * sin_theta) + above * cos_theta
}

/// The point (u, v) of a direction, which may have any positive length. u is in [0, 1) and v in [0, 1]; at the
/// poles u is 0.5.
pub fn uv(up: Up, direction: DVec3) -> (f64, f64) {
    let [right, forward, above] = axes(up);
    let (x, y, z) = (direction.dot(right), direction.dot(forward), direction.dot(above));
    let u = 0.5 + num::atan2(x, y) / (2.0 * PI);
    let v = num::atan2((x * x + y * y).sqrt(), z) / PI;
    (if u >= 1.0 { u - 1.0 } else { u }, v)
}

/// Exact solid angle of one pixel of row `y`, in steradians: the integral over the row, divided by the number of
/// its pixels. The sum over the whole panorama is 4 pi.
pub fn pixel_solid_angle(width: usize, height: usize, y: usize) -> f64 {
    let edge = |row: usize| num::f64::cos(PI * row as f64 / height as f64);
    2.0 * PI / width as f64 * (edge(y) - edge(y + 1))
}

/// Rotation about the up axis of a world, counter-clockwise seen from above. The world is given by its right,
/// forward and up vectors.
pub fn yaw([right, forward, up]: [DVec3; 3], degrees: f64) -> DMat3 {
    let (s, c) = num::sin_cos_deg(degrees);
    let basis = DMat3::from_cols(right, forward, up);
    let about_z = DMat3::from_cols(DVec3::new(c, s, 0.0), DVec3::new(-s, c, 0.0), DVec3::Z);
    basis * about_z * basis.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_and_points_are_inverse() {
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let [right, forward, above] = axes(up);
            assert!((right.cross(forward) - above).length() < 1e-15, "right-handed");
            for (u, v) in [(0.5, 0.5), (0.01, 0.3), (0.99, 0.7), (0.25, 0.999)] {
                let (u2, v2) = uv(up, direction(up, u, v) * 3.0);
                assert!((u - u2).abs() < 1e-12 && (v - v2).abs() < 1e-12);
            }
            assert!((direction(up, 0.5, 0.5) - forward).length() < 1e-12);
            assert!((direction(up, 0.75, 0.5) - right).length() < 1e-12);
        }
    }

    #[test]
    fn solid_angles_sum_to_the_sphere() {
        let total: f64 = (0..37).map(|y| 64.0 * pixel_solid_angle(64, 37, y)).sum();
        assert!((total - 4.0 * PI).abs() < 1e-12);
    }
}
