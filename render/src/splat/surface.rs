//! A surface that limits the splats of a panorama: only splats in front of it are drawn.

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};
use scene::types::{Data, Image, Mesh};

use crate::geometry::bvh::{Bvh, Ray};

/// Triangles of a surface, in coordinates relative to the eye of a panorama.
pub struct Surface(Bvh);

impl Surface {
    /// Surface of a mesh as seen from `eye`. Both are in world units.
    pub fn new(mesh: &Mesh, eye: DVec3) -> Self {
        let corner = |i: u32| (mesh.position(i) - eye).as_vec3();
        let corners: Vec<[Vec3; 3]> = mesh.triangles.iter().map(|t| t.map(corner)).collect();
        Self(Bvh::build(&corners))
    }

    /// Distance to the surface in the direction of each pixel, in world units; +inf if there is no surface. Both
    /// sides of a triangle count.
    pub(super) fn distances(
        &self,
        width: usize,
        height: usize,
        direction: impl Fn(usize, usize) -> DVec3 + Send + Sync,
        cx: &Context,
    ) -> Result<Image<Data>, NodeError> {
        cx.count("rays", (width * height) as u64);
        let rows = cx.for_each_tile(height, |y| {
            let distance = |x| {
                let ray = Ray::new(Vec3::ZERO, direction(x, y).as_vec3());
                self.0.closest(ray, |_| true).map_or(f32::INFINITY, |hit| hit.t)
            };
            (0..width).map(distance).collect::<Vec<f32>>()
        })?;
        Ok(Image::from_samples(width, height, 1, rows.concat()))
    }
}
