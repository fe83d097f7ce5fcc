//! The estimator: light that arrives along a camera ray.

use glam::Vec3;

use super::bsdf::Lobe;
use super::change::Towards;
use super::direct_light::{MANY, power_heuristic};
use super::environment::{Distributions, DrawnDirection, EnvironmentLight};
use super::film::Rays;
use super::light_points::LightPoints;
use super::media::Media;
use super::near_field::NearFieldLight;
use super::objects::Objects;
use super::path::{PathState, Vertex};
use super::receiver::{Receiver, Surface};
use super::visibility::{Block, Rules};
use crate::bvh::{Hit, Ray};
use crate::sampling::{Points, hash, unit};

/// Pairs of dimensions used by one vertex of a path: light, direction, choice of lobe, survival.
pub(super) const PAIRS: u32 = 4;
/// Light samples at the first vertex where the receiver is the light.
const NEAR_LIGHTS: u32 = 4;
/// Width of rays of a matte surface for each unit of their length: its many rays blur what they see anyway.
const BLUR: f32 = 0.05;
/// Paths this long or longer may end at random.
const ROULETTE_FROM: u32 = 3;

/// What all rays share.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The place.
    pub receiver: &'a Receiver,
    /// What was inserted.
    pub objects: &'a Objects,
    /// The light.
    pub sky: &'a EnvironmentLight,
    /// How the receiver treats each sort of ray.
    pub rules: &'a Rules,
    /// The light as points of the receiver, if that is the light and there are objects.
    pub light_points: Option<&'a LightPoints>,
}

/// The paths of one sample of one pixel. The random numbers depend on the sample and the vertex alone, so
/// that paths with and without objects stay the same until an object comes in the way.
#[derive(Debug)]
pub struct Integrator<'a> {
    pub(super) scene: Scene<'a>,
    pub(super) points: Points,
    pub(super) key: u32,
    /// Whether the objects are there.
    pub(super) objects: bool,
    /// Whether what shines of them does.
    pub(super) lamps: bool,
    /// Where the first vertex looks for light of the sky, if that is known better than by its normal.
    pub distributions: Option<Distributions<'a>>,
    /// The light samples of the first vertex, if they are drawn.
    pub drawn: Option<&'a [DrawnDirection]>,
    /// Added to the start of rays to objects from the first vertex: see [`super::contact`].
    pub lift: Vec3,
    /// Rays from the first vertex to where the objects are, beside others.
    pub(super) towards: Towards,
    /// Width of the camera's ray for each unit of its length, for the textures of objects.
    pub spread: f32,
    /// Rays cast so far.
    pub rays: Rays,
    /// Whether a ray met an object.
    pub touched: bool,
    /// Whether a path ended on an object, for it was too long, with over half of its light to come.
    pub cut: bool,
}

impl<'a> Scene<'a> {
    /// The receiver as the light, if it is.
    pub(super) fn near(&self) -> Option<NearFieldLight<'a>> {
        let near =
            |eye| NearFieldLight { receiver: self.receiver, sky: self.sky, eye: Vec3::from_array(eye) };
        self.rules.near.map(near)
    }
}

impl<'a> Integrator<'a> {
    /// The paths of a sample, with or without the objects.
    pub fn new(scene: Scene<'a>, points: Points, key: u32, objects: bool) -> Self {
        let objects = objects && !scene.objects.is_empty();
        Self {
            scene,
            points,
            key,
            objects,
            lamps: true,
            distributions: None,
            drawn: None,
            lift: Vec3::ZERO,
            towards: Towards::NOWHERE,
            spread: 0.0,
            rays: Rays::default(),
            touched: false,
            cut: false,
        }
    }

    /// The surface of the receiver at a hit, moved by `lift` for objects, in no body.
    pub(super) fn receiver_surface(&self, hit: &Hit, lift: Vec3) -> Surface {
        let surface = self.scene.receiver.surface(hit);
        let cover = if self.objects { self.scene.objects.cover(&surface, lift) } else { None };
        Surface { cover, ..surface }
    }

    pub(super) fn surface(
        &mut self,
        vertex: &Vertex,
        (out, width): (Vec3, f32),
        lift: Vec3,
        media: Media,
    ) -> Surface {
        let (hit, straight) = match vertex {
            Vertex::Receiver(hit) => {
                return Surface { media: [media; 2], ..self.receiver_surface(hit, lift) };
            }
            Vertex::Object(hit) => (hit, false),
            Vertex::Straight(hit) => (hit, true),
        };
        let mut surface = self.scene.objects.surface(hit, out, straight, width, media);
        surface.bed = self.scene.objects.bed(hit, -out, &surface, self.scene.receiver);
        if surface.bed.is_none() {
            surface.bed = self.scene.objects.ground.over(self.scene.receiver, surface.position);
        }
        let [near, far] = surface.media;
        if !near.is_empty() && far.is_deeper(&near) {
            // Where two bodies touch, the path sees one of the two surfaces, and may be out of the first body.
            surface.media[1] = self.around(surface.spawn_ray(-surface.normal));
        }
        surface
    }

    /// Radiance that comes back along a ray of the camera, of unit direction, from the vertex that it found. What
    /// is before the receiver is left out, be it a body around it.
    pub fn radiance(&mut self, first: Vertex, ray: Ray) -> Vec3 {
        let (mut throughput, mut media) = (Vec3::ONE, Media::default());
        let objects = self.scene.objects;
        match &first {
            _ if !self.objects || objects.bodies.is_empty() => {}
            Vertex::Receiver(hit) => {
                let surface = self.receiver_surface(hit, self.lift);
                media = self.around(surface.upright(self.lift));
            }
            Vertex::Object(hit) | Vertex::Straight(hit) => {
                if objects.may_hold(ray.origin) {
                    media = objects.around(ray, self.key, true);
                }
                (throughput, media) = objects.within(media, Some(hit), hit.t);
            }
        }
        self.path_radiance(
            first,
            PathState { direction: ray.direction, bounce: 0, throughput, share: 1.0, mis_weight: 1.0, media },
        )
    }

    /// Radiance that a vertex sends back along a path in some state.
    pub(super) fn path_radiance(&mut self, mut vertex: Vertex, state: PathState) -> Vec3 {
        let Scene { sky, rules, .. } = self.scene;
        let near = self.scene.near();
        let PathState { bounce: start, mut throughput, mut share, mut mis_weight, mut media, .. } = state;
        // How wide the ray is at the vertex, and how fast it widens.
        let (mut width, mut spread) = (0.0, if start == 0 { self.spread } else { BLUR });
        let (mut out, mut light) = (-state.direction, Vec3::ZERO);
        // Whether the vertex is in the place of the one before.
        let mut touches = false;
        for bounce in start..=rules.max_bounces + 1 {
            width += spread * vertex.distance();
            let first = bounce == 0;
            let lift = if first { self.lift } else { Vec3::ZERO };
            let surface = self.surface(&vertex, (out, width), lift, media);
            // Light samples see a lamp as it is; so do the rays that they are weighed against, or a small one would shine twice.
            let emission = match vertex.on_object() {
                _ if !self.lamps => Vec3::ZERO,
                Some(hit) if !first && !self.scene.objects.emitters.is_empty() => {
                    self.scene.objects.emission_towards(hit, out)
                }
                _ => surface.emission,
            };
            // What a ray finds shining is light of the vertex before.
            light += rules.clamped(bounce.saturating_sub(1), throughput * emission * mis_weight);
            if bounce > rules.max_bounces {
                self.cut |= !matches!(vertex, Vertex::Receiver(_)) && throughput.max_element() > 0.5;
                break;
            }
            let pair = 1 + bounce * PAIRS;
            let key = hash(self.key, pair);
            let usual = sky.distributions(surface.bsdf.lit_side());
            let distributions = if first { self.distributions.unwrap_or(usual) } else { usual };
            let several = first.then_some(sky.lights);

            // Light sampling.
            let mut lit = Vec3::ZERO;
            let side = surface.bsdf.lit_side();
            let near_lights = if first { NEAR_LIGHTS } else { 1 };
            if let Some(near) = &near {
                for number in 0..near_lights {
                    let points = (self.points.twig(number, near_lights), pair);
                    self.rays.shadow += 1;
                    let Some(mut arriving) = near.sample(surface.looks_from(), side, points.0.bits(pair))
                    else {
                        continue;
                    };
                    arriving.0.pdf *= near_lights as f32;
                    let key = key.wrapping_add(number);
                    lit += self.light_sample(&surface, lift, &arriving, Some((near, points)), key);
                }
            } else {
                let own;
                let drawn = match self.drawn.filter(|_| first) {
                    Some(drawn) => drawn,
                    None => {
                        own = self.lights(distributions, pair, several);
                        own.as_slice()
                    }
                };
                // Looked up together, they wait for memory together.
                let mut lights = [None; MANY];
                lights.iter_mut().zip(drawn).for_each(|(light, drawn)| *light = Some(sky.light(drawn)));
                for (number, sample) in lights.iter().flatten().enumerate() {
                    let key = key.wrapping_add(number as u32);
                    lit += match surface.bsdf.is_matte() {
                        true => self.matte_light_sample(&surface, lift, sample, key),
                        false => self.light_sample(&surface, lift, &(*sample, None), None, key),
                    };
                }
            }
            light += rules.clamped(bounce, throughput * lit);

            let towards = match (first && self.objects, &vertex) {
                (true, Vertex::Receiver(_)) if surface.cover.is_none() => self.towards,
                (true, Vertex::Object(_) | Vertex::Straight(_)) => {
                    self.scene.objects.shades.towards(surface.position)
                }
                _ => Towards::NOWHERE,
            };
            let lamps = self.sample_emitters((&surface, lift), key ^ 2, bounce, &towards);
            light += rules.clamped(bounce, throughput * lamps);
            light += self.sent(
                (&surface, lift),
                &towards,
                (throughput, share, bounce),
                key ^ 3,
                Self::path_radiance,
            );

            // Scattering. Light samples bring a matte surface all light of a sky that is far, so from there a ray
            // looks for surfaces only.
            let go_on = bounce < rules.max_bounces;
            let matte = surface.bsdf.is_matte() && near.is_none();
            if matte && !self.objects && !(go_on && rules.visibility(Lobe::Diffuse).lands) {
                break;
            }
            let Some((lobe, direction, scatter)) = surface.bsdf.sample(&self.points, pair + 1) else { break };
            let visibility = rules.visibility(lobe);
            let ray = surface.ray_to_receiver(direction);
            let mut to_objects = surface.ray_to_objects(direction, lift);
            let touching = match (&vertex, lobe) {
                (Vertex::Object(hit), Lobe::Specular)
                    if !touches
                        && self.scene.objects.parts.len() > 1
                        && direction.dot(surface.normal) < 0.0 =>
                {
                    self.rays.scattered += 1;
                    self.scene.objects.touching(hit, &surface, direction, key ^ 1).map(Vertex::Object)
                }
                _ => None,
            };
            touches = touching.is_some();
            let mut object = touching.or_else(|| self.object(to_objects, key ^ 1, lobe));
            if !visibility.lands {
                (object, to_objects.t_max) = self.before_the_light(object, ray, visibility.block);
            }
            let to_sky = near.is_some() || !matte;
            let landed = if visibility.lands && (go_on || (to_sky && visibility.block == Block::Solid)) {
                self.rays.scattered += 1;
                let on_object = object.as_ref().and_then(Vertex::on_object);
                let reach = on_object.map_or(f32::INFINITY, |hit| self.scene.objects.reach(hit, direction));
                self.scene.receiver.bvh.closest(Ray { t_max: reach, ..ray }, |_| true)
            } else {
                None
            };
            let found = landed.map(Vertex::Receiver).or(object);
            let passed;
            (passed, media) =
                self.along(to_objects, key ^ 1, lobe, found.as_ref(), surface.medium(direction));
            let scatter_weight = passed * scatter.value / scatter.pdf;
            let glossy_pdf = if lobe == Lobe::Specular { scatter.pdf } else { 0.0 };
            if let Some(near) = near.filter(|_| landed.is_some() || object.is_none()) {
                self.rays.scattered += 1;
                if let Some(arriving) = near.eval(ray, side, landed.as_ref(), glossy_pdf) {
                    let dimming = self.dimming(&near, &arriving, (self.points, pair + 1), key);
                    let arrived = arriving.0.radiance
                        * power_heuristic(scatter.pdf, near_lights as f32 * arriving.0.pdf);
                    light += rules.clamped(bounce, throughput * scatter_weight * dimming * arrived);
                    let throughput = (throughput * scatter_weight, share);
                    light += self.lamps_beyond(landed, direction, bounce, throughput, media);
                    light += self.objects_beyond(landed, &arriving, direction, bounce, throughput, media);
                    break;
                }
            } else if object.is_none() && to_sky {
                let found = sky.eval(distributions, sky.numbers(distributions, several), direction);
                let found = sky.seen(found, glossy_pdf);
                if found.radiance != Vec3::ZERO {
                    let passes = match (visibility.block, visibility.lands) {
                        (Block::Solid, true) => landed.is_none(),
                        (block, _) => self.passes(block, ray),
                    };
                    if passes {
                        let arrived = found.radiance * power_heuristic(scatter.pdf, found.pdf);
                        light += rules.clamped(bounce, throughput * scatter_weight * arrived);
                    }
                }
            }
            if !visibility.lands && object.is_none() {
                let unlit = self.unlit(ray);
                light +=
                    self.lamps_beyond(unlit, direction, bounce, (throughput * scatter_weight, share), media);
            }
            let Some(next) = found else { break };
            vertex = next;
            mis_weight = match vertex {
                Vertex::Object(hit) | Vertex::Straight(hit) => {
                    let towards = if lobe == Lobe::Diffuse { towards } else { Towards::NOWHERE };
                    let own = towards.share(direction, scatter.pdf);
                    (throughput, share) = (throughput * own, share * own);
                    self.mis_weight(&hit, ray, scatter.pdf + towards.pdf(direction))
                }
                Vertex::Receiver(_) => 1.0,
            };
            throughput *= scatter_weight;
            out = -direction;
            if lobe == Lobe::Diffuse {
                spread = f32::max(spread, BLUR);
            }
            let Some(left) = self.russian_roulette(bounce, throughput, share) else { break };
            throughput = left;
        }
        light
    }

    /// The throughput of a path after some bounces if it goes on, by Russian roulette; those that bring little may end at random,
    /// but for a share that says nothing of that: see [`PathState::share`].
    pub(super) fn russian_roulette(&self, bounce: u32, throughput: Vec3, share: f32) -> Option<Vec3> {
        if bounce + 1 < ROULETTE_FROM {
            return Some(throughput);
        }
        let survival = (throughput.max_element() / share).clamp(0.05, 0.95);
        (unit(self.points.bits(1 + bounce * PAIRS + 3)[0]) < survival).then(|| throughput / survival)
    }
}
