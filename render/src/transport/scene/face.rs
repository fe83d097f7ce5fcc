//! Triangle, and the offset of rays that leave it.

use glam::Vec3;

use crate::geometry::bvh::Hit;

/// Offset at which rays must start from a triangle so that they do not hit it again. It covers the rounding errors
/// of corners, barycentrics and ray origin, each of which is a few units in the last place of the largest
/// coordinate.
pub fn margin([a, b, c]: &[Vec3; 3]) -> f32 {
    a.abs().max(b.abs()).max(c.abs()).max_element() * (8.0 * f32::EPSILON)
}

/// Position, unit normal by winding, and offset of rays, at a hit.
pub(crate) fn geometry(corners: &[Vec3; 3], hit: &Hit) -> (Vec3, Vec3, f32) {
    let face = Face::new(*corners);
    (face.at(hit), face.normal, face.margin)
}

/// Triangle, with the values that all of its points share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Face {
    pub(crate) corners: [Vec3; 3],
    /// Unit normal of the triangle; its side is given by the winding of `corners`.
    pub(crate) normal: Vec3,
    /// Offset of rays that leave the triangle; see [`margin`].
    pub(crate) margin: f32,
}

impl Face {
    pub(crate) fn new(corners: [Vec3; 3]) -> Self {
        let [a, b, c] = corners;
        let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
        Self { corners, normal, margin: margin(&corners) }
    }

    #[inline]
    pub(crate) fn at(&self, hit: &Hit) -> Vec3 {
        let [a, b, c] = self.corners;
        a * (1.0 - hit.b1 - hit.b2) + b * hit.b1 + c * hit.b2
    }
}
