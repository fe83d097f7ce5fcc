//! The local frame of a surface point.

use glam::Vec3;

use crate::geometry::sampling::circle;

/// Orthonormal frame, as the columns of a matrix.
#[derive(Debug, Clone, Copy)]
pub struct Frame([Vec3; 3]);

impl Frame {
    /// Creates a frame whose third axis is a unit vector (Duff et al. 2017).
    pub fn around(n: Vec3) -> Self {
        let sign = 1.0_f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let b = n.x * n.y * a;
        Self([
            Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
            Vec3::new(b, sign + n.y * n.y * a, -n.y),
            n,
        ])
    }

    /// Creates a frame whose third axis is a unit vector, and whose first axis is as close as possible to
    /// `tangent`.
    pub fn along(n: Vec3, tangent: Vec3) -> Self {
        match (tangent - n * n.dot(tangent)).try_normalize() {
            Some(t) => Self([t, n.cross(t), n]),
            None => Self::around(n),
        }
    }

    /// The third axis.
    pub fn normal(&self) -> Vec3 {
        self.0[2]
    }

    /// Transforms a direction of the scene to this frame.
    pub(super) fn to(&self, d: Vec3) -> Vec3 {
        Vec3::new(d.dot(self.0[0]), d.dot(self.0[1]), d.dot(self.0[2]))
    }

    /// Transforms a direction from this frame to the scene.
    pub(in crate::transport) fn from(&self, d: Vec3) -> Vec3 {
        self.0[0] * d.x + self.0[1] * d.y + self.0[2] * d.z
    }

    /// Transforms the direction to a viewer into this frame. If the result is below the horizon, it is moved above
    /// it.
    pub(super) fn viewer(&self, out: Vec3) -> Vec3 {
        let local = self.to(out);
        Vec3::new(local.x, local.y, local.z.max(1e-4)).normalize()
    }
}

/// A cosine-distributed direction in local coordinates, chosen by two random numbers.
pub(super) fn cosine([u, v]: [f32; 2]) -> Vec3 {
    let (sin, cos) = circle(u);
    let r = v.sqrt();
    Vec3::new(r * cos, r * sin, (1.0 - v).max(0.0).sqrt())
}
