//! Light that objects add to a receiver that emits near light, or that lets environment light pass.
//!
//! In both cases a path ends at its first hit of the receiver, since the panorama shows the place with all of
//! its interreflections. The panorama does not show the light that objects add. Light of their emitters is
//! therefore traced from surface to surface, in a scene without any other light. Light that objects scatter
//! returns to the surfaces around them, so that the ground in a mirror is as bright as the ground itself.

use glam::Vec3;

use super::integrator::{Integrator, Pass};
use super::near_field::ArrivingLight;
use super::path::{PathState, ShadingPoint, Vertex};
use crate::geometry::bvh::{Hit, Ray};
use crate::transport::bsdf::Bsdf;
use crate::transport::scene::block::Block;
use crate::transport::scene::media::Media;
use crate::transport::sky::cone::Towards;

impl Integrator<'_> {
    /// Hit on the receiver along a ray that the receiver lets pass. `None` if there is no hit, or if no object
    /// emits light.
    pub(crate) fn unlit(&mut self, ray: Ray) -> Option<Hit> {
        if !self.pass.objects || !self.pass.lamps || self.scene.objects.emitters.is_empty() {
            return None;
        }
        self.tally.rays.scattered += 1;
        self.scene.receiver.bvh.closest(ray, |_| true)
    }

    /// Light of emitters that is reflected at the receiver hit of a scattered ray. 0 if there is no hit.
    pub(crate) fn lamps_beyond(
        &mut self,
        landed: Option<Hit>,
        direction: Vec3,
        bounce: u32,
        (throughput, share): (Vec3, f32),
        media: Media,
    ) -> Vec3 {
        let Some(hit) = landed.filter(|_| bounce < self.scene.rules.max_bounces) else { return Vec3::ZERO };
        if !self.pass.objects || !self.pass.lamps || self.scene.objects.emitters.is_empty() {
            return Vec3::ZERO;
        }
        let state = PathState { direction, bounce: bounce + 1, throughput, share, mis_weight: 1.0, media };
        self.lamp_radiance(Vertex::Receiver(hit), state, true)
    }

    /// Light that objects scatter to the receiver point that a ray hits, and that this point reflects along the
    /// ray, under near light. Light that the objects emit is not included. The reflectance of the point is
    /// estimated from the radiance that the panorama shows there; the albedo of the mesh is not used.
    pub(crate) fn objects_beyond(
        &mut self,
        landed: Option<Hit>,
        (light, place): &ArrivingLight,
        direction: Vec3,
        bounce: u32,
        (throughput, share): (Vec3, f32),
        media: Media,
    ) -> Vec3 {
        let bounce = bounce + 1;
        let (Some(hit), Some(place), Some(light_points)) = (landed, place, self.scene.light_points) else {
            return Vec3::ZERO;
        };
        if !self.pass.objects || bounce > self.scene.rules.max_bounces {
            return Vec3::ZERO;
        }
        let surface = self.surface(&Vertex::Receiver(hit), (-direction, 0.0), Vec3::ZERO, media);
        let at = ShadingPoint::new(surface, bounce, self.key);
        let white = Bsdf::matte(place.normal, Vec3::ONE);
        let Some((lobe, direction, _)) = white.sample(&self.pass.points, at.pair + 1) else {
            return Vec3::ZERO;
        };
        let to_objects = at.surface.ray_to_objects(direction);
        let found = self.object(to_objects, at.key ^ 1, lobe);
        let Some((vertex, hit)) = found.and_then(|vertex| Some((vertex, *vertex.on_object()?))) else {
            return Vec3::ZERO;
        };
        let t_max = self.scene.objects.reach(&hit, direction);
        if !self.passes(Block::Solid, Ray { t_max, ..at.surface.ray_to_receiver(direction) }) {
            return Vec3::ZERO;
        }
        let start = at.surface.medium(direction);
        let (passed, media) = self.along(to_objects, at.key ^ 1, lobe, Some(&vertex), start);
        if self.may_stop() {
            return Vec3::ZERO;
        }
        let albedo = light_points.albedo(place.position, place.normal, light.radiance);
        let throughput = throughput * passed * albedo;
        let Some(throughput) = self.russian_roulette(bounce, throughput, share) else { return Vec3::ZERO };
        let state = PathState { direction, bounce: bounce + 1, throughput, share, mis_weight: 1.0, media };
        let pass = Pass { lamps: false, ..self.pass };
        self.with(pass, |own| own.path_radiance(vertex, state))
    }

    /// Radiance of a path in a scene in which emitters are the only lights and the receiver is solid. If `sends` is
    /// true, additional rays from the receiver towards the objects find translucent surfaces around emitters.
    fn lamp_radiance(&mut self, mut vertex: Vertex, state: PathState, sends: bool) -> Vec3 {
        let (objects, receiver, rules) = (self.scene.objects, self.scene.receiver, self.scene.rules);
        let PathState { bounce: start, mut throughput, mut share, mut mis_weight, mut media, .. } = state;
        let (mut out, mut light) = (-state.direction, Vec3::ZERO);
        for bounce in start..=rules.max_bounces + 1 {
            let surface = self.surface(&vertex, (out, 0.0), Vec3::ZERO, media);
            light += rules.clamped(bounce.saturating_sub(1), throughput * surface.emission * mis_weight);
            if bounce > rules.max_bounces {
                break;
            }
            let at = ShadingPoint::new(surface, bounce, self.key);
            let surface = &at.surface;
            let towards = match vertex {
                Vertex::Receiver(_) if sends => self.towards_lamps(surface),
                _ => Towards::NOWHERE,
            };
            let lamps = self.sample_emitters(&at, &towards);
            light += rules.clamped(bounce, throughput * lamps);
            let onwards = |own: &mut Self, vertex, state| own.lamp_radiance(vertex, state, false);
            light += self.sent(&at, &towards, (throughput, share), onwards);
            let Some((lobe, direction, scatter)) = surface.bsdf.sample(&self.pass.points, at.pair + 1) else {
                break;
            };
            let ray = surface.ray_to_receiver(direction);
            let to_objects = surface.ray_to_objects(direction);
            let object = self.object(to_objects, at.key ^ 1, lobe);
            let reach = object
                .as_ref()
                .and_then(Vertex::on_object)
                .map_or(ray.t_max, |hit| objects.reach(hit, direction));
            self.tally.rays.scattered += 1;
            let landed = receiver.bvh.closest(Ray { t_max: reach, ..ray }, |_| true);
            let Some(found) = landed.map(Vertex::Receiver).or(object) else { break };
            let passed;
            (passed, media) =
                self.along(to_objects, at.key ^ 1, lobe, Some(&found), surface.medium(direction));
            mis_weight = match found {
                Vertex::Object(hit) | Vertex::Straight(hit) => {
                    let own = towards.share(direction, scatter.pdf);
                    (throughput, share) = (throughput * own, share * own);
                    self.mis_weight(&hit, ray, scatter.pdf + towards.pdf(direction))
                }
                Vertex::Receiver(_) => 1.0,
            };
            throughput *= passed * scatter.value / scatter.pdf;
            (vertex, out) = (found, -direction);
            let Some(left) = self.russian_roulette(bounce, throughput, share) else { break };
            throughput = left;
        }
        self.tally.touched |= light != Vec3::ZERO;
        light
    }
}
