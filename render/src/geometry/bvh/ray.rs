//! Rays, and their intersections with triangles.

use glam::Vec3;

/// A ray: the points `origin + t * direction` for `t` up to `t_max`.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Start point. A hit at the start point itself does not count.
    pub origin: Vec3,
    /// Direction, of any length. Distances along the ray are in units of this length.
    pub direction: Vec3,
    /// Maximum distance, which may be infinite.
    pub t_max: f32,
}

impl Ray {
    /// Creates a ray without a maximum distance.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_max: f32::INFINITY }
    }
}

/// Intersection of a ray with a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance along the ray, in units of the length of the direction of the ray.
    pub t: f32,
    /// Index of the triangle among those given to [`Bvh::build`](super::Bvh::build).
    pub triangle: u32,
    /// Barycentric weight of vertex 1.
    pub b1: f32,
    /// Barycentric weight of vertex 2.
    pub b2: f32,
    /// True if the ray hits the back of the triangle, which is the side from which the vertices run clockwise.
    pub back: bool,
}
