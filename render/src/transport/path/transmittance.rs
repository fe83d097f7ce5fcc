//! Hits and transmittance along the rays of a path: objects, media, and a receiver that blocks light or lets
//! it pass.

use glam::Vec3;

use super::integrator::{Integrator, Scene};
use super::path::Vertex;
use crate::geometry::bvh::{Hit, Ray};
use crate::transport::bsdf::Lobe;
use crate::transport::scene::block::Block;
use crate::transport::scene::media::Media;

impl Integrator<'_> {
    /// Bodies that contain the origin of a ray. They are found without knowledge of the path that led to this
    /// point.
    pub fn around(&mut self, ray: Ray) -> Media {
        if !self.pass.objects || !self.scene.objects.may_hold(ray.origin) {
            return Media::default();
        }
        self.tally.rays.shadow += 1;
        self.scene.objects.around(ray, self.key, false)
    }

    /// True if rays of a lobe pass straight through transmissive surfaces.
    fn straight(&self, lobe: Lobe) -> bool {
        self.scene.objects.clear && lobe == Lobe::Diffuse
    }

    /// Nearest hit on an object along a ray that was scattered by `lobe`.
    pub fn object(&mut self, ray: Ray, key: u32, lobe: Lobe) -> Option<Vertex> {
        if !self.pass.objects {
            return None;
        }
        self.tally.rays.scattered += 1;
        let objects = self.scene.objects;
        if self.straight(lobe) {
            return objects.closest_straight(ray, key).map(Vertex::Straight);
        }
        objects.bvh.closest(ray, |hit| objects.accepts(hit, key, false)).map(Vertex::Object)
    }

    /// Transmittance of objects and media along a ray that was scattered by `lobe`, and the media at the end of the
    /// ray. The end is the vertex `end`, or the maximum distance of the ray if `end` is `None`.
    pub fn along(
        &mut self,
        mut ray: Ray,
        key: u32,
        lobe: Lobe,
        end: Option<&Vertex>,
        media: Media,
    ) -> (Vec3, Media) {
        if !self.pass.objects {
            return (Vec3::ONE, media);
        }
        ray.t_max = end.map_or(ray.t_max, Vertex::distance);
        let hit = end.and_then(Vertex::on_object);
        let (weight, media) = match self.straight(lobe) {
            true => self.scene.objects.along_straight(ray, key, hit, media),
            false => self.scene.objects.within(media, hit, ray.t_max),
        };
        self.tally.touched |= hit.is_some() || weight != Vec3::ONE;
        (weight, media)
    }

    /// Transmittance of the objects along a ray that starts in `media`, per class of lobes. `except` is a triangle
    /// to ignore, such as the emitter at the end of the ray.
    pub fn object_transmittance(
        &mut self,
        ray: Ray,
        key: u32,
        except: Option<u32>,
        media: Media,
    ) -> [Vec3; 2] {
        let (left, touched) = self.objects_along(ray, key, except, media);
        self.tally.touched |= touched;
        left
    }

    /// Same as [`object_transmittance`](Self::object_transmittance). Also returns whether an object was hit,
    /// without recording it.
    fn objects_along(&mut self, ray: Ray, key: u32, except: Option<u32>, media: Media) -> ([Vec3; 2], bool) {
        if !self.pass.objects {
            return ([Vec3::ONE; 2], false);
        }
        self.tally.rays.shadow += 1;
        let objects = self.scene.objects;
        // The coverage of blended surfaces is applied as a factor, without random decisions.
        let (mut left, mut is_clear) = (1.0, false);
        objects.bvh.any(ray, |hit| {
            if Some(hit.triangle) != except {
                let coverage = objects.coverage(hit, false);
                left *= 1.0 - coverage;
                is_clear |= coverage > 0.0 && objects.clear && objects.part(hit.triangle).0.clear;
            }
            left == 0.0
        });
        let plain = if left > 0.0 { left * objects.within(media, None, ray.t_max).0 } else { Vec3::ZERO };
        let left = if is_clear || (left == 0.0 && objects.clear) {
            [objects.transmittance(ray, key, except, media), plain]
        } else {
            [plain; 2]
        };
        (left, plain != Vec3::ONE)
    }

    /// Distance along a ray beyond which objects do not block environment light, if the receiver lets this light
    /// pass. It is the distance to the first receiver surface: the panorama shows this surface in the direction of
    /// the ray, so objects behind it cannot block the light. Receiver surfaces that are closer to the origin of the
    /// ray than the error of the mesh are ignored. If the ray hits no surface, the result is the length of the ray.
    fn start_of_light(&mut self, ray: Ray) -> f32 {
        self.tally.rays.shadow += 1;
        let Scene { receiver, objects, .. } = self.scene;
        let beyond = objects.ground.error();
        let Some(hit) = receiver.bvh.closest(ray, |hit| hit.t > beyond) else { return ray.t_max };
        hit.t + objects.touching.allowance(&ray, hit.t, receiver.normal(hit.triangle))
    }

    /// Transmittance of the objects for environment light along a ray, per class of lobes. Both rays have the same
    /// direction; `to_receiver` starts at the origin for tests against the receiver, and `to_objects` at the origin
    /// for tests against objects. Unless `solid` is true, objects behind the receiver block no light.
    pub(crate) fn sky_transmittance(
        &mut self,
        (to_receiver, to_objects): (Ray, Ray),
        solid: bool,
        key: u32,
        media: Media,
    ) -> [Vec3; 2] {
        let (all, touched) = self.objects_along(to_objects, key, None, media);
        let behind = if solid || all == [Vec3::ONE; 2] {
            None
        } else {
            Some(self.start_of_light(to_receiver)).filter(|start| *start < to_objects.t_max)
        };
        match behind {
            Some(t_max) => self.object_transmittance(Ray { t_max, ..to_objects }, key, None, media),
            None => {
                self.tally.touched |= touched;
                all
            }
        }
    }

    /// Returns `object`, or `None` if it is behind a receiver that lets environment light pass. Also returns the
    /// length of the ray up to that receiver.
    pub(crate) fn before_the_light(
        &mut self,
        object: Option<Vertex>,
        ray: Ray,
        block: Block,
    ) -> (Option<Vertex>, f32) {
        let objects = self.scene.objects;
        let solid = block == Block::Solid || self.scene.rules.printed;
        if solid || !self.pass.objects || !(object.is_some() || objects.clear) {
            return (object, ray.t_max);
        }
        let end = self.start_of_light(ray);
        // An object that coincides with the receiver is in front of it.
        let place = |hit: &Hit| hit.t - (objects.reach(hit, ray.direction) - hit.t).abs();
        let before = |vertex: &Vertex| vertex.on_object().is_none_or(|hit| place(hit) <= end);
        (object.filter(before), end)
    }

    pub(crate) fn passes(&mut self, block: Block, ray: Ray) -> bool {
        self.tally.rays.shadow += u64::from(block != Block::Pass);
        block.passes(self.scene.receiver, ray)
    }
}
