//! A point of a surface as light transport sees it.

use glam::Vec3;

use super::media::Media;
use crate::geometry::bvh::Ray;
use crate::render::transport::bsdf::Bsdf;

/// A point of a surface as light transport sees it.
#[derive(Debug, Clone, Copy)]
pub struct Surface {
    /// Where, in the frame of the scene.
    pub position: Vec3,
    /// Unit geometric normal on the side of the viewer.
    pub normal: Vec3,
    /// How far rays must start off the surface not to meet it again.
    pub margin: f32,
    /// How it scatters.
    pub bsdf: Bsdf,
    /// What it emits towards the viewer.
    pub emission: Vec3,
    /// What is on the side of the viewer, and on the other.
    pub media: [Media; 2],
    /// How far below it rays to objects start, where one lies on it: see [`super::touching`].
    pub cover: Option<f32>,
    /// How far off it rays to the receiver start, where it lies on that, or under it: see [`crate::render::transport::ground::contact`].
    pub bed: Option<Vec3>,
    /// Added to the start of rays to objects: see [`crate::render::transport::ground::contact`].
    pub lift: Vec3,
}

impl Surface {
    /// A ray that leaves the surface.
    #[inline]
    pub fn spawn_ray(&self, direction: Vec3) -> Ray {
        let side = self.margin.copysign(direction.dot(self.normal));
        Ray::new(self.position + self.normal * side, direction)
    }

    /// A ray that leaves the surface and may meet the receiver.
    #[inline]
    pub fn ray_to_receiver(&self, direction: Vec3) -> Ray {
        match self.bed {
            Some(off) => Ray::new(self.position + off, direction),
            None => self.spawn_ray(direction),
        }
    }

    /// The place that looks for light of the receiver.
    #[inline]
    pub fn looks_from(&self) -> Vec3 {
        self.position + self.bed.unwrap_or_default()
    }

    /// A ray that leaves the surface from its lifted start and may meet objects.
    #[inline]
    pub fn ray_to_objects(&self, direction: Vec3) -> Ray {
        let ray = match self.cover {
            Some(below) => Ray::new(self.position - self.normal * below, direction),
            None => self.spawn_ray(direction),
        };
        Ray { origin: ray.origin + self.lift, ..ray }
    }

    /// A ray to the objects along the normal.
    pub fn upright(&self) -> Ray {
        self.ray_to_objects(self.normal)
    }

    /// What a ray is in that leaves the surface.
    pub fn medium(&self, direction: Vec3) -> Media {
        self.media[usize::from(direction.dot(self.normal) < 0.0)]
    }
}
