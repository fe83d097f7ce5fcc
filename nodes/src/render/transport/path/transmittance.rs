//! What a ray of a path meets and what lies along it: objects, bodies, and a receiver that is in the way or lets light pass.

use glam::Vec3;

use super::integrator::{Integrator, Scene};
use super::path::Vertex;
use crate::geometry::bvh::{Hit, Ray};
use crate::render::transport::bsdf::Lobe;
use crate::render::transport::scene::block::Block;
use crate::render::transport::scene::media::Media;

impl Integrator<'_> {
    /// The bodies around the start of a ray of which nothing is known.
    pub(crate) fn around(&mut self, ray: Ray) -> Media {
        if !self.pass.objects || !self.scene.objects.may_hold(ray.origin) {
            return Media::default();
        }
        self.tally.rays.shadow += 1;
        self.scene.objects.around(ray, self.key, false)
    }

    /// Whether a ray that left by a lobe goes straight through what it meets.
    fn straight(&self, lobe: Lobe) -> bool {
        self.scene.objects.clear && lobe == Lobe::Diffuse
    }

    /// The nearest object along a ray that left by a lobe.
    pub(crate) fn object(&mut self, ray: Ray, key: u32, lobe: Lobe) -> Option<Vertex> {
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

    /// The weight of what is found at the end of such a ray, which is a vertex or nothing, and the media there.
    pub(crate) fn along(
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

    /// What the objects let through along a ray, by the lobe that it serves.
    /// The ray starts in `media`. One triangle may be excepted: the one that shines at the end.
    pub(crate) fn object_transmittance(
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

    /// The same, and whether an object was met, which is not recorded.
    fn objects_along(&mut self, ray: Ray, key: u32, except: Option<u32>, media: Media) -> ([Vec3; 2], bool) {
        if !self.pass.objects {
            return ([Vec3::ONE; 2], false);
        }
        self.tally.rays.shadow += 1;
        let objects = self.scene.objects;
        // What blended surfaces leave of it is known, and needs no chance.
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

    /// How far along a ray from a surface light starts that passes the receiver: it shows what is there, so what lies
    /// behind hides none of it. What is nearer than a mesh may be wrong is in its own way.
    fn start_of_light(&mut self, ray: Ray) -> f32 {
        self.tally.rays.shadow += 1;
        let Scene { receiver, objects, .. } = self.scene;
        let beyond = objects.ground.error();
        let Some(hit) = receiver.bvh.closest(ray, |hit| hit.t > beyond) else { return ray.t_max };
        hit.t + objects.touching.allowance(&ray, hit.t, receiver.normal(hit.triangle))
    }

    /// What the objects let through of light along a ray, by the lobe that it serves; `to_receiver` is the same ray for the
    /// receiver. Where that is not solid to the light, objects behind it hide none.
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

    /// An object that a ray of a lobe found, if it is not behind a receiver that lets light of the sky pass, and how far the
    /// ray goes.
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
        // In the place of the receiver it is still before it.
        let place = |hit: &Hit| hit.t - (objects.reach(hit, ray.direction) - hit.t).abs();
        let before = |vertex: &Vertex| vertex.on_object().is_none_or(|hit| place(hit) <= end);
        (object.filter(before), end)
    }

    pub(crate) fn passes(&mut self, block: Block, ray: Ray) -> bool {
        self.tally.rays.shadow += u64::from(block != Block::Pass);
        block.passes(self.scene.receiver, ray)
    }
}
