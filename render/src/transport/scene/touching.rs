//! Objects that coincide with the receiver: a rug on a floor, a picture on a wall.
//!
//! Which of two coincident surfaces a ray hits would otherwise depend on rounding. Here the object counts as in
//! front of the receiver: rays to the receiver pass through the object first, and rays through the object reach the
//! receiver, as if the object lay a millimetre higher. Surfaces of bodies, such as the lower face of a glass that
//! stands on a floor, are handled in [`super::media`].

use glam::Vec3;

use super::aabb::Aabb;
use crate::geometry::bvh::Ray;

/// Triangles of objects that may coincide with the receiver.
#[derive(Debug, Clone, Default)]
pub struct Touching {
    /// True for each triangle that may coincide; empty if there is no such triangle.
    pub(crate) triangles: Vec<bool>,
    /// Bounding box of the triangles that may coincide, enlarged by [`reach`](Self::reach).
    pub(crate) held: Option<Aabb>,
    /// Maximum distance at which two surfaces count as coincident.
    pub(crate) reach: f32,
}

impl Touching {
    /// Distance by which the points of a box must be lowered to be below objects that lie on them. 0 if there are
    /// no such objects.
    pub fn depth(&self, low: Vec3, high: Vec3) -> f32 {
        let there = self.held.is_some_and(|held| held.meets(&Aabb { low, high }));
        if there { 2.0 * self.reach } else { 0.0 }
    }

    /// Distance beyond a receiver hit within which a ray may still hit an object that lies on the receiver.
    pub fn allowance(&self, ray: &Ray, t: f32, normal: Vec3) -> f32 {
        let position = ray.origin + ray.direction * t;
        let there = self.held.is_some_and(|held| held.holds(position));
        if there { self.reach / normal.dot(ray.direction).abs().max(0.01) } else { 0.0 }
    }

    pub(crate) fn holds(&self, triangle: u32) -> bool {
        self.triangles.get(triangle as usize).is_some_and(|holds| *holds)
    }

    /// Short ray along the negative normal, through a point at which surfaces may coincide.
    pub(crate) fn across(&self, position: Vec3, normal: Vec3) -> Ray {
        Ray { t_max: 2.0 * self.reach, ..Ray::new(position + normal * self.reach, -normal) }
    }
}
