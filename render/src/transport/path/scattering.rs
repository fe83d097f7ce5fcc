//! Scattered rays of a path.

use glam::Vec3;

use super::direct_light::power_heuristic;
use super::first_vertex::FirstVertex;
use super::integrator::{BLUR, Integrator};
use super::path::{Path, ShadingPoint, Vertex};
use crate::geometry::bvh::{Hit, Ray};
use crate::transport::bsdf::Lobe;
use crate::transport::scene::block::Block;
use crate::transport::scene::media::Media;
use crate::transport::sky::cone::Towards;

/// Scattered ray and its hits.
pub(crate) struct Scattered {
    lobe: Lobe,
    /// The ray, shortened to the part in which it may hit the receiver.
    ray: Ray,
    /// Density of the direction of the ray.
    pdf: f32,
    /// Weight of the light along the ray: BSDF over density, times transmittance.
    weight: Vec3,
    /// Hit of the ray on an object. `None` if there is no hit, or if it lies behind a receiver that lets
    /// environment light pass.
    object: Option<Vertex>,
    /// Hit on the receiver before any object. `None` if nothing was hit, or if the receiver was not tested.
    landed: Option<Hit>,
    /// Media at the end of the ray.
    media: Media,
    /// True if `object` is a hit on another primitive whose surface coincides with the surface at which the ray was
    /// scattered, such as the table on which a glass stands.
    touches: bool,
}

impl Scattered {
    /// Density of the direction if the lobe is specular, otherwise 0.
    fn glossy_pdf(&self) -> f32 {
        if self.lobe == Lobe::Specular { self.pdf } else { 0.0 }
    }
}

impl<'a> Integrator<'a> {
    /// Results of the scattered ray of a vertex, if they are already known and the ray hits no object.
    fn known(&self, at: &ShadingPoint, object: Option<&Vertex>) -> Option<&'a FirstVertex> {
        self.pass.known.filter(|_| at.is_first() && object.is_none())
    }

    /// True if light samples find all environment light of a vertex, so that scattered rays only search for
    /// surfaces.
    fn is_matte(&self, at: &ShadingPoint) -> bool {
        at.surface.bsdf.is_matte() && self.scene.rules.near.is_none()
    }

    /// Scatters a ray. `None` if the surface scatters no light, or if no light could be found along the ray.
    pub(crate) fn scatter(&mut self, path: &Path, at: &ShadingPoint) -> Option<Scattered> {
        let (rules, surface) = (self.scene.rules, &at.surface);
        let (go_on, matte) = (at.bounce < rules.max_bounces, self.is_matte(at));
        if matte && !self.pass.objects && !(go_on && rules.visibility(Lobe::Diffuse).lands) {
            return None;
        }
        let (lobe, direction, scatter) = surface.bsdf.sample(&self.pass.points, at.pair + 1)?;
        let visibility = rules.visibility(lobe);
        let ray = surface.ray_to_receiver(direction);
        let mut to_objects = surface.ray_to_objects(direction);
        let touching = match (&path.vertex, lobe) {
            (Vertex::Object(hit), Lobe::Specular)
                if !path.touches
                    && self.scene.objects.parts.len() > 1
                    && direction.dot(surface.normal) < 0.0 =>
            {
                self.tally.rays.scattered += 1;
                self.scene.objects.touching(hit, surface, direction, at.key ^ 1).map(Vertex::Object)
            }
            _ => None,
        };
        let touches = touching.is_some();
        let mut object = touching.or_else(|| self.object(to_objects, at.key ^ 1, lobe));
        if !visibility.lands {
            (object, to_objects.t_max) = self.before_the_light(object, ray, visibility.block);
        }
        let landed = if let Some(known) = self.known(at, object.as_ref()) {
            known.landed
        } else if visibility.lands && (go_on || (!matte && visibility.block == Block::Solid)) {
            self.tally.rays.scattered += 1;
            let on_object = object.as_ref().and_then(Vertex::on_object);
            let reach = on_object.map_or(f32::INFINITY, |hit| self.scene.objects.reach(hit, direction));
            self.scene.receiver.bvh.closest(Ray { t_max: reach, ..ray }, |_| true)
        } else {
            None
        };
        let found = landed.map(Vertex::Receiver).or(object);
        let start = surface.medium(direction);
        let (passed, media) = self.along(to_objects, at.key ^ 1, lobe, found.as_ref(), start);
        let weight = passed * scatter.value / scatter.pdf;
        Some(Scattered { lobe, ray, pdf: scatter.pdf, weight, object, landed, media, touches })
    }

    /// Adds the environment light along a scattered ray. `None` if the path ends in the environment.
    pub(crate) fn collect(
        &mut self,
        path: &mut Path,
        at: &ShadingPoint,
        scattered: &Scattered,
    ) -> Option<()> {
        let Scattered { ray, weight, object, landed, media, .. } = *scattered;
        let (rules, bounce, direction) = (self.scene.rules, at.bounce, ray.direction);
        let carried = (path.state.throughput * weight, path.state.share);
        match self.scene.near() {
            Some(near)
                if (landed.is_some() || object.is_none())
                    && !landed.is_some_and(|hit| self.goes_on_at(scattered.lobe, bounce, hit.triangle)) =>
            {
                let arriving = match self.known(at, object.as_ref()) {
                    Some(known) => known.found,
                    None => {
                        self.tally.rays.scattered += 1;
                        let samples = near.samples(at.surface.bsdf.lit_side(), near.lights(at.is_first()));
                        near.eval(ray, &samples, landed.as_ref(), scattered.glossy_pdf())
                    }
                };
                if let Some(arriving) = arriving {
                    let dimming = self.dimming(&near, &arriving, (self.pass.points, at.pair + 1), at.key);
                    let pdf = near.lights(at.is_first()).count() as f32 * arriving.0.pdf;
                    let arrived = arriving.0.radiance * power_heuristic(scattered.pdf, pdf);
                    path.light += rules.clamped(bounce, carried.0 * dimming * arrived);
                    path.light += self.lamps_beyond(landed, direction, bounce, carried, media);
                    path.light += self.objects_beyond(landed, &arriving, direction, bounce, carried, media);
                    return None;
                }
            }
            None if object.is_none() && !self.is_matte(at) => {
                path.light += rules.clamped(bounce, carried.0 * self.sky_found(at, scattered));
            }
            _ => {}
        }
        if !rules.visibility(scattered.lobe).lands && object.is_none() {
            let unlit = self.unlit(ray);
            path.light += self.lamps_beyond(unlit, direction, bounce, carried, media);
        }
        Some(())
    }

    /// True if a ray that a lobe scatters after `bounce` scatterings goes on at a triangle of the receiver under near
    /// light, instead of ending in the light that the panorama shows there. This is the case for specular rays that
    /// meet glossy triangles: the panorama shows their reflections as seen from the point of capture only.
    pub(crate) fn goes_on_at(&self, lobe: Lobe, bounce: u32, triangle: u32) -> bool {
        let glossy = lobe == Lobe::Specular && self.scene.receiver.gloss(triangle).is_some();
        glossy && bounce < self.scene.rules.max_bounces
    }

    /// Light of the sky along a scattered ray, weighted against light samples.
    fn sky_found(&mut self, at: &ShadingPoint, scattered: &Scattered) -> Vec3 {
        let (sky, distributions) = (self.scene.sky, self.sky_distributions(at));
        let numbers = sky.numbers(distributions, self.several(at));
        let found = sky.eval(distributions, numbers, scattered.ray.direction);
        let found = sky.seen(found, scattered.glossy_pdf());
        if found.radiance == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let visibility = self.scene.rules.visibility(scattered.lobe);
        let passes = match (visibility.block, visibility.lands) {
            (Block::Solid, true) => scattered.landed.is_none(),
            (block, _) => self.passes(block, scattered.ray),
        };
        if passes { found.radiance * power_heuristic(scattered.pdf, found.pdf) } else { Vec3::ZERO }
    }

    /// Advances a path to the hit of its scattered ray. `None` if there is no hit, or if Russian roulette
    /// ends the path.
    pub(crate) fn go_on(&mut self, path: &mut Path, towards: &Towards, scattered: Scattered) -> Option<()> {
        let Scattered { lobe, ray, pdf, weight, object, landed, media, touches } = scattered;
        path.vertex = landed.map(Vertex::Receiver).or(object)?;
        let state = &mut path.state;
        state.mis_weight = match path.vertex {
            Vertex::Object(hit) | Vertex::Straight(hit) => {
                let towards = if lobe == Lobe::Diffuse { towards } else { &Towards::NOWHERE };
                let own = towards.share(ray.direction, pdf);
                (state.throughput, state.share) = (state.throughput * own, state.share * own);
                self.mis_weight(&hit, ray, pdf + towards.pdf(ray.direction))
            }
            Vertex::Receiver(_) => 1.0,
        };
        state.throughput *= weight;
        (state.direction, state.media) = (ray.direction, media);
        path.touches = touches;
        if lobe == Lobe::Diffuse {
            path.spread = f32::max(path.spread, BLUR);
        }
        state.throughput = self.russian_roulette(state.bounce, state.throughput, state.share)?;
        state.bounce += 1;
        Some(())
    }
}
