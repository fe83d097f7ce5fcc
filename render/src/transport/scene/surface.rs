//! Surface points for light transport.

use glam::Vec3;

use super::media::Media;
use crate::geometry::bvh::Ray;
use crate::transport::bsdf::Bsdf;

/// Surface point with the data that light transport needs.
#[derive(Debug, Clone, Copy)]
pub struct Surface {
    /// Position in the frame of the scene.
    pub position: Vec3,
    /// Unit geometric normal on the side of the viewer.
    pub normal: Vec3,
    /// Offset of rays that leave the surface; see `super::face`.
    pub margin: f32,
    /// Scattering function.
    pub bsdf: Bsdf,
    /// Emitted radiance towards the viewer.
    pub emission: Vec3,
    /// Media on the side of the viewer and on the other side.
    pub media: [Media; 2],
    /// Depth below the surface at which rays to objects start, if an object lies on the surface; see
    /// [`super::touching`].
    pub cover: Option<f32>,
    /// Offset at which rays to the receiver start, if the surface lies on the receiver or is covered by it;
    /// see [`super::supports`].
    pub bed: Option<Vec3>,
    /// Offset added to the origin of rays to objects; see [`super::supports`].
    pub lift: Vec3,
}

impl Surface {
    /// Ray that leaves the surface.
    #[inline]
    pub fn spawn_ray(&self, direction: Vec3) -> Ray {
        let side = self.margin.copysign(direction.dot(self.normal));
        Ray::new(self.position + self.normal * side, direction)
    }

    /// Ray that leaves the surface and may hit the receiver.
    #[inline]
    pub fn ray_to_receiver(&self, direction: Vec3) -> Ray {
        match self.bed {
            Some(off) => Ray::new(self.position + off, direction),
            None => self.spawn_ray(direction),
        }
    }

    /// Position from which near light is sampled. It is offset if the surface lies on the receiver.
    #[inline]
    pub fn looks_from(&self) -> Vec3 {
        self.position + self.bed.unwrap_or_default()
    }

    /// Ray that leaves the lifted surface and may hit objects.
    #[inline]
    pub fn ray_to_objects(&self, direction: Vec3) -> Ray {
        let ray = match self.cover {
            Some(below) => Ray::new(self.position - self.normal * below, direction),
            None => self.spawn_ray(direction),
        };
        Ray { origin: ray.origin + self.lift, ..ray }
    }

    /// Ray to objects along the normal.
    pub fn upright(&self) -> Ray {
        self.ray_to_objects(self.normal)
    }

    /// Media in which a ray in a direction starts.
    pub fn medium(&self, direction: Vec3) -> Media {
        self.media[usize::from(direction.dot(self.normal) < 0.0)]
    }
}
