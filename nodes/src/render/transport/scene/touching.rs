//! Where objects lie in the very place of the receiver: a rug on a floor, a picture on a wall.
//!
//! Of two surfaces in one place rounding would choose which a ray meets. Here the object lies on the receiver: it is
//! in front of it, whatever comes to the receiver passes it, and what passes it comes to the receiver. That is what
//! an object shows that lies a millimetre higher. Surfaces of bodies are left to [`super::media`]: of glass that
//! stands on a floor the lower face is none.

use glam::Vec3;

use super::aabb::Aabb;
use crate::geometry::bvh::Ray;

/// The triangles of objects that may lie in the place of the receiver.
#[derive(Debug, Clone, Default)]
pub struct Touching {
    /// Whether each triangle does; empty where none does.
    pub(crate) triangles: Vec<bool>,
    /// The box around them, with [`reach`](Self::reach) around it.
    pub(crate) held: Option<Aabb>,
    /// How far from one another two surfaces in one place may be found.
    pub(crate) reach: f32,
}

impl Touching {
    /// How far the points of a place must be taken to reach to lie below what lies on them; 0 where nothing does.
    pub fn depth(&self, low: Vec3, high: Vec3) -> f32 {
        let there = self.held.is_some_and(|held| held.meets(&Aabb { low, high }));
        if there { 2.0 * self.reach } else { 0.0 }
    }

    /// How far beyond a place of the receiver that a ray meets what lies on it may be met.
    pub fn allowance(&self, ray: &Ray, t: f32, normal: Vec3) -> f32 {
        let position = ray.origin + ray.direction * t;
        let there = self.held.is_some_and(|held| held.holds(position));
        if there { self.reach / normal.dot(ray.direction).abs().max(0.01) } else { 0.0 }
    }

    pub(crate) fn holds(&self, triangle: u32) -> bool {
        self.triangles.get(triangle as usize).is_some_and(|holds| *holds)
    }

    /// A ray across a place where surfaces may lie on one another.
    pub(crate) fn across(&self, position: Vec3, normal: Vec3) -> Ray {
        Ray { t_max: 2.0 * self.reach, ..Ray::new(position + normal * self.reach, -normal) }
    }
}
