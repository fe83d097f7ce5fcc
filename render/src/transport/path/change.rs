//! Change that the objects make to the light that leaves a point of the receiver.
//!
//! The light without objects is known from other samples, so only the difference is estimated. Light samples are
//! taken only in the part of the sky that the objects can block, and scattered rays are sent towards the objects
//! themselves. If no ray hits an object, the difference is exactly 0.

use glam::Vec3;
use scene::math::color::luminance;

use super::first_vertex::FirstVertex;
use super::integrator::{Integrator, Pass, Scene};
use super::path::{PathState, ShadingPoint, Vertex};
use crate::geometry::bvh::{Hit, Ray, Steps};
use crate::geometry::sampling::{Points, unit};
use crate::transport::bsdf::Lobe;
use crate::transport::scene::block::Block;
use crate::transport::scene::surface::Surface;
use crate::transport::sky::cone::Cone;
use crate::transport::sky::cone::{TOWARDS, Towards};
use crate::transport::sky::environment::DrawnDirection;

/// Number of rays per steradian towards objects that emit no more light than the sky.
const RAYS: f32 = 1.0;

/// Parameters for sampling the change at the first vertex.
#[derive(Debug, Clone, Copy)]
pub struct ChangeSampling<'a> {
    /// Sampled directions of the part of the sky that the objects can block.
    pub drawn: &'a [DrawnDirection],
    /// Results of the rays of the path without objects at its first vertex, under near light, if they are already
    /// traced.
    pub known: Option<&'a FirstVertex>,
    /// Probability that a sample estimates the change; see [`estimates_change`].
    pub probability: f32,
    /// Point from which the cone of directions to the objects is computed.
    pub start: Vec3,
    /// Bounding box of the objects.
    pub objects: [Vec3; 2],
    /// Number of rays per steradian towards the objects; see [`rays_towards`].
    pub rays: f32,
    /// Offset added to the origin of rays to objects; see [`Surface::lift`].
    pub lift: Vec3,
}

/// Decides at random whether a sample estimates the change. Returns true with the given probability.
pub fn estimates_change(points: &Points, probability: f32) -> bool {
    probability >= 1.0 || unit(points.bits(TOWARDS + 2)[0]) < probability
}

/// True if the change is the difference of two whole paths; see [`Integrator::change`].
pub(crate) fn is_paired(scene: &Scene<'_>) -> bool {
    scene.rules.near.is_some() || scene.receiver.is_glossy()
}

/// Sampling of rays from a first vertex towards the objects.
fn towards(sampling: &ChangeSampling<'_>) -> Towards {
    Towards::within(Cone::between([sampling.start; 2], sampling.objects), sampling.rays)
}

impl<'a> Integrator<'a> {
    /// Radiance with objects minus radiance without objects, at a receiver hit of a camera ray.
    pub fn change(&mut self, hit: Hit, ray: Ray, sampling: &ChangeSampling<'_>) -> Vec3 {
        if is_paired(&self.scene) {
            self.paired_estimate(hit, ray, sampling)
        } else if estimates_change(&self.pass.points, sampling.probability) {
            self.separate_estimate(hit, ray, sampling) / sampling.probability
        } else {
            Vec3::ZERO
        }
    }

    /// Estimates the change of a matte receiver under distant light. The light that the objects block and the light
    /// that they add are estimated by separate samples.
    fn separate_estimate(&mut self, mut hit: Hit, ray: Ray, sampling: &ChangeSampling<'_>) -> Vec3 {
        let (sky, rules) = (self.scene.sky, self.scene.rules);
        let (mut light, mut throughput) = (Vec3::ZERO, Vec3::ONE);
        let mut lift = sampling.lift;
        let lamps_in_it = !self.scene.objects.emitters.is_empty();
        for bounce in 0..=rules.max_bounces {
            // The receiver is matte, so the viewer of later vertices does not matter.
            let surface = self.receiver_surface(&hit, -ray.direction, lift);
            let surface = Surface { media: [self.around(surface.upright()); 2], ..surface };
            let at = ShadingPoint::new(surface, bounce, self.key);
            let surface = &at.surface;

            // Light of the sky that the objects block.
            let own;
            let drawn = if at.is_first() {
                sampling.drawn
            } else {
                own = self.lights(sky.distributions(surface.bsdf.lit_side()), at.pair, None);
                own.as_slice()
            };
            let mut taken = Vec3::ZERO;
            for (number, drawn) in drawn.iter().enumerate() {
                taken += self.blocked_light(surface, drawn, at.key.wrapping_add(number as u32));
            }
            light -= rules.clamped(bounce, throughput * taken);

            // Light that they add: their emission, by light samples,
            let towards = match (at.is_first(), &surface.cover) {
                (true, None) => towards(sampling),
                (true, Some(_)) => Towards::NOWHERE,
                (false, _) => self.towards_lamps(surface),
            };
            let lamps = self.sample_emitters(&at, &towards);
            light += rules.clamped(bounce, throughput * lamps);

            // the light that they scatter, by rays towards them,
            let points = branch(self.pass.points, bounce);
            if let Some(ray) = towards.ray(&points) {
                let seen = surface.bsdf.eval(ray)[Lobe::Diffuse as usize];
                if seen.pdf > 0.0 {
                    let pdf = seen.pdf + towards.pdf;
                    let share = if lamps_in_it { seen.pdf / pdf } else { 1.0 };
                    let how = (throughput * seen.value / pdf, share, pdf);
                    let pass = Pass { points: points.branch(TOWARDS), ..self.pass };
                    light += self.with(pass, |own| own.difference(&at, ray, how, at.key ^ 3, true).0);
                }
            }

            // and by rays in all directions, which also find changes of the rest of the receiver.
            let Some((_, ray, scatter)) = surface.bsdf.sample(&self.pass.points, at.pair + 1) else { break };
            let (scatter_weight, share) = (scatter.value / scatter.pdf, towards.share(ray, scatter.pdf));
            let own = if lamps_in_it { share } else { 1.0 };
            let how = (throughput * scatter_weight * share, own, scatter.pdf + towards.pdf(ray));
            let (change, landed) = self.difference(&at, ray, how, at.key ^ 1, false);
            light += change;
            if !rules.visibility(Lobe::Diffuse).lands
                && let Some(unlit) = self.unlit(surface.spawn_ray(ray))
            {
                let way = Ray { t_max: unlit.t, ..surface.ray_to_objects(ray) };
                if self.object(way, at.key ^ 1, Lobe::Diffuse).is_none() {
                    let end = Vertex::Receiver(unlit);
                    let (passed, media) =
                        self.along(way, at.key ^ 1, Lobe::Diffuse, Some(&end), surface.medium(ray));
                    let throughput = (throughput * scatter_weight * passed, 1.0);
                    light += self.lamps_beyond(Some(unlit), ray, bounce, throughput, media);
                }
            }
            let Some(next) = landed else { break };
            let Some(left) = self.russian_roulette(bounce, throughput * scatter_weight, 1.0) else { break };
            (hit, throughput, lift) = (next, left, Vec3::ZERO);
        }
        light
    }

    /// Estimates the change from two whole paths, one with and one without the objects, that share their random
    /// numbers. Used under near light, where objects also block the light that receiver points emit, and if the
    /// receiver is glossy. Rays towards the objects find their light, which scattered rays rarely hit.
    fn paired_estimate(&mut self, hit: Hit, ray: Ray, sampling: &ChangeSampling<'_>) -> Vec3 {
        let lamps = !self.scene.objects.emitters.is_empty();
        let known = sampling.known;
        let pass = Pass { lift: sampling.lift, towards: towards(sampling), known, ..self.pass };
        if known.is_none() && !lamps {
            // Most paths touch no object, which takes fewer rays to find out than the light.
            self.with(Pass { touch_only: true, ..pass }, |own| own.radiance(Vertex::Receiver(hit), ray));
            if !self.tally.touched {
                return Vec3::ZERO;
            }
        }
        let with = self.with(pass, |own| own.radiance(Vertex::Receiver(hit), ray));
        if !self.tally.touched {
            return Vec3::ZERO;
        }
        let pass = Pass { objects: false, ..pass };
        let without = |own: &mut Self| own.with(pass, |own| own.radiance(Vertex::Receiver(hit), ray));
        with - match known {
            None => without(self),
            // These rays were counted when the receiver alone was traced.
            Some(known) => known.light.unwrap_or_else(|| {
                let rays = self.tally.rays;
                let light = Steps::uncounted(|| without(self));
                self.tally.rays = rays;
                light
            }),
        }
    }

    /// Sampling of rays towards the objects from a receiver vertex after the first, if the objects emit light; see
    /// [`Pass::towards`].
    pub(crate) fn towards_lamps(&self, surface: &Surface) -> Towards {
        let objects = self.scene.objects;
        match objects.bvh.bounds() {
            Some(bounds) if !objects.emitters.is_empty() && surface.cover.is_none() => {
                let cone = Cone::between([surface.position; 2], bounds.into());
                Towards::within(cone, rays_towards(&self.scene))
            }
            _ => Towards::NOWHERE,
        }
    }

    /// Light that arrives along a ray sampled towards the objects. `onwards` computes the light of the rest of the
    /// path, which starts at the hit on an object.
    pub(crate) fn sent(
        &mut self,
        at: &ShadingPoint,
        towards: &Towards,
        (throughput, share): (Vec3, f32),
        onwards: fn(&mut Self, Vertex, PathState) -> Vec3,
    ) -> Vec3 {
        let (surface, bounce, key) = (&at.surface, at.bounce, at.key ^ 3);
        let points = branch(self.pass.points, bounce);
        let Some(direction) = towards.ray(&points) else { return Vec3::ZERO };
        let seen = surface.bsdf.eval(direction)[Lobe::Diffuse as usize];
        if seen.pdf <= 0.0 {
            return Vec3::ZERO;
        }
        let (ray, to_objects) = (surface.ray_to_receiver(direction), surface.ray_to_objects(direction));
        let Some(vertex) = self.object(to_objects, key, Lobe::Diffuse) else { return Vec3::ZERO };
        let Some(hit) = vertex.on_object().copied() else { return Vec3::ZERO };
        let before = Ray { t_max: self.scene.objects.reach(&hit, direction), ..ray };
        if !self.passes(Block::Solid, before) {
            return Vec3::ZERO;
        }
        let (passed, media) =
            self.along(to_objects, key, Lobe::Diffuse, Some(&vertex), surface.medium(direction));
        let pdf = seen.pdf + towards.pdf;
        let throughput = throughput * passed * seen.value / pdf;
        let mis_weight = self.mis_weight(&hit, ray, pdf);
        let share = share * seen.pdf / pdf;
        let state = PathState { direction, bounce: bounce + 1, throughput, share, mis_weight, media };
        let pass = Pass { points: points.branch(TOWARDS), ..self.pass };
        self.with(pass, |own| onwards(own, vertex, state))
    }

    /// Light that the objects block, estimated from one light sample. The radiance of the sample is computed last,
    /// since most samples hit no object.
    fn blocked_light(&mut self, surface: &Surface, drawn: &DrawnDirection, key: u32) -> Vec3 {
        let scatter = surface.bsdf.eval(drawn.direction)[Lobe::Diffuse as usize];
        if scatter.value == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let ray = surface.spawn_ray(drawn.direction);
        let to_objects = surface.ray_to_objects(drawn.direction);
        let (block, media) =
            (self.scene.rules.visibility(Lobe::Diffuse).shadow, surface.medium(ray.direction));
        let [straight, _] = self.sky_transmittance((ray, to_objects), block == Block::Solid, key, media);
        if straight == Vec3::ONE || !self.passes(block, ray) {
            return Vec3::ZERO;
        }
        let light = self.scene.sky.light(drawn);
        (Vec3::ONE - straight) * scatter.value * light.radiance / light.pdf
    }

    /// Radiance along a scattered ray with objects, minus the radiance without objects. If no object affects the
    /// ray, returns 0 and the ray's hit on the receiver. If `only` is true, the caller needs only the difference,
    /// and the hit may be missing. The tuple argument contains the throughput, its share (see [`PathState::share`])
    /// and the density of the ray.
    fn difference(
        &mut self,
        at: &ShadingPoint,
        direction: Vec3,
        (throughput, share, pdf): (Vec3, f32, f32),
        key: u32,
        only: bool,
    ) -> (Vec3, Option<Hit>) {
        let (rules, surface, bounce) = (self.scene.rules, &at.surface, at.bounce);
        let ray = surface.spawn_ray(direction);
        let to_objects = surface.ray_to_objects(direction);
        // Most rays towards objects miss them, wherever the receiver is.
        let plain = !self.scene.objects.clear && surface.medium(direction).is_empty();
        let sought = (only && plain).then(|| self.object(to_objects, key, Lobe::Diffuse));
        if let Some(None) = sought {
            return (Vec3::ZERO, None);
        }
        let lands = bounce < rules.max_bounces && rules.visibility(Lobe::Diffuse).lands;
        let landed = if lands { self.receiver_hit(ray) } else { None };
        let (objects, receiver) = (self.scene.objects, self.scene.receiver);
        let allowance = |l: &Hit| objects.touching.allowance(&ray, l.t, receiver.normal(l.triangle));
        let t_max = landed.map_or(ray.t_max, |l| l.t + allowance(&l));
        let mut to_objects = Ray { t_max, ..to_objects };
        let before = |hit: &Hit| landed.is_none_or(|l| hit.t - objects.slack(hit, direction) <= l.t);
        let object = match sought {
            Some(found) => found.filter(|vertex| vertex.distance() <= t_max),
            None => self.object(to_objects, key, Lobe::Diffuse),
        };
        let mut object = object.filter(|vertex| vertex.on_object().is_none_or(before));
        if !rules.visibility(Lobe::Diffuse).lands {
            let block = rules.visibility(Lobe::Diffuse).block;
            (object, to_objects.t_max) = self.before_the_light(object, ray, block);
        }
        let found = object.or(landed.map(Vertex::Receiver));
        let start = surface.medium(direction);
        let (passed, media) = self.along(to_objects, key, Lobe::Diffuse, found.as_ref(), start);
        if object.is_none() && passed == Vec3::ONE {
            return (Vec3::ZERO, landed);
        }
        let way = PathState { direction, bounce: bounce + 1, throughput, share, mis_weight: 1.0, media };
        let mut change = Vec3::ZERO;
        if let Some(vertex) = found {
            let mis_weight = match vertex {
                Vertex::Object(hit) | Vertex::Straight(hit) => self.mis_weight(&hit, ray, pdf),
                Vertex::Receiver(_) => 1.0,
            };
            change +=
                self.path_radiance(vertex, PathState { throughput: throughput * passed, mis_weight, ..way });
        }
        if let Some(hit) = landed {
            let without = Pass { objects: false, ..self.pass };
            change -= self.with(without, |own| own.path_radiance(Vertex::Receiver(hit), way));
        }
        (change, None)
    }

    fn receiver_hit(&mut self, ray: Ray) -> Option<Hit> {
        self.tally.rays.scattered += 1;
        self.scene.receiver.bvh.closest(ray, |_| true)
    }
}

/// Number of rays per steradian towards the objects. If the objects emit light, this number increases with the
/// ratio of the mean radiance of their bounding box to the mean radiance of the sky.
pub fn rays_towards(scene: &Scene<'_>) -> f32 {
    let (power, bounds) = (scene.objects.emitters.power, scene.objects.bvh.bounds());
    let Some((low, high)) = bounds.filter(|_| power > 0.0) else { return RAYS };
    let [x, y, z] = (high - low).as_dvec3().to_array();
    let own = power / (2.0 * (x * y + y * z + z * x));
    let sky = f64::from(luminance(scene.sky.power.map(|v| v as f32))) / (4.0 * std::f64::consts::PI);
    RAYS * (1.0 + own / sky) as f32
}

/// Random numbers for rays towards the objects from the vertex after `bounce` scatterings.
fn branch(points: Points, bounce: u32) -> Points {
    if bounce == 0 { points } else { points.branch(TOWARDS + bounce) }
}
