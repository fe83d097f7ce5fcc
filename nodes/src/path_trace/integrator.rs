//! The estimator: light that arrives along a camera ray.

use glam::Vec3;

use super::bsdf::{Lobe, Scatter};
use super::change::Towards;
use super::environment::{Distributions, DrawnDirection, EnvironmentLight, LightSample, TIERS};
use super::film::Rays;
use super::light_draws::wanted;
use super::media::Media;
use super::near_field::{ArrivingLight, NearFieldLight};
use super::objects::Objects;
use super::receiver::{Receiver, Surface};
use super::visibility::{Block, Rules};
use crate::bvh::{Hit, Ray};
use crate::sampling::{Points, hash, unit};

/// Pairs of dimensions used by one vertex of a path: light, direction, choice of lobe, survival.
pub(super) const PAIRS: u32 = 4;
/// First of the pairs for light of the objects: choice and place, for each vertex.
const LAMPS: u32 = 1 << 16;
/// First of the pairs for what objects take from the light of a place, for each vertex.
const DIMMING: u32 = 3 << 17;
/// Most light samples of a vertex.
const MANY: usize = 5;
/// Light samples at the first vertex where the receiver is the light.
const NEAR_LIGHTS: u32 = 4;
/// Width of rays of a matte surface for each unit of their length: its many rays blur what they see anyway.
const BLUR: f32 = 0.05;
/// Paths this long or longer may end at random.
const ROULETTE_FROM: u32 = 3;

/// The light samples of a vertex.
#[derive(Debug, Default)]
pub(super) struct FewDraws {
    draws: [DrawnDirection; MANY],
    count: usize,
}

impl FewDraws {
    #[inline]
    fn push(&mut self, drawn: DrawnDirection) {
        self.draws[self.count] = drawn;
        self.count += 1;
    }

    #[inline]
    pub(super) fn as_slice(&self) -> &[DrawnDirection] {
        &self.draws[..self.count]
    }
}

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
}

/// Where a path is.
#[derive(Debug, Clone, Copy)]
pub enum Vertex {
    /// On the receiver.
    Receiver(Hit),
    /// On an object, met by a camera ray or a specular one.
    Object(Hit),
    /// On an object, met by a ray of a matte surface, which goes straight on where anything passes it.
    Straight(Hit),
}

impl Vertex {
    /// Length of the ray that found it.
    fn distance(&self) -> f32 {
        match self {
            Self::Receiver(hit) | Self::Object(hit) | Self::Straight(hit) => hit.t,
        }
    }

    /// Where it is on an object.
    pub(super) fn on_object(&self) -> Option<&Hit> {
        match self {
            Self::Receiver(_) => None,
            Self::Object(hit) | Self::Straight(hit) => Some(hit),
        }
    }
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

/// How a path came to a vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct PathState {
    /// Unit direction of the ray that found the vertex.
    pub direction: Vec3,
    /// How often light was scattered before.
    pub bounce: u32,
    /// Throughput (beta): what of the light from the vertex comes to the eye.
    pub throughput: Vec3,
    /// The share of the throughput that it has beside rays which find the same, so that it does not end the path.
    pub share: f32,
    /// Weight of what the vertex emits, beside light samples of the one before.
    pub mis_weight: f32,
    /// What the ray was in at the vertex.
    pub media: Media,
}

/// Balance of two strategies by the squares of their densities (Veach 1997, power heuristic).
fn power_heuristic(a: f32, b: f32) -> f32 {
    // Densities of a sun in one texel overflow when squared in f32; their ratio does not.
    if a > b {
        let r = b / a;
        1.0 / (1.0 + r * r)
    } else if b > 0.0 {
        let r = a / b;
        r * r / (1.0 + r * r)
    } else {
        0.0
    }
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

    /// The bodies around the start of a ray of which nothing is known.
    pub(super) fn around(&mut self, ray: Ray) -> Media {
        if !self.objects || !self.scene.objects.may_hold(ray.origin) {
            return Media::default();
        }
        self.rays.shadow += 1;
        self.scene.objects.around(ray, self.key, false)
    }

    /// Whether a ray that left by a lobe goes straight through what it meets.
    fn straight(&self, lobe: Lobe) -> bool {
        self.scene.objects.clear && lobe == Lobe::Diffuse
    }

    /// The nearest object along a ray that left by a lobe.
    pub(super) fn object(&mut self, ray: Ray, key: u32, lobe: Lobe) -> Option<Vertex> {
        if !self.objects {
            return None;
        }
        self.rays.scattered += 1;
        let objects = self.scene.objects;
        if self.straight(lobe) {
            return objects.closest_straight(ray, key).map(Vertex::Straight);
        }
        objects.bvh.closest(ray, |hit| objects.accepts(hit, key, false)).map(Vertex::Object)
    }

    /// The weight of what is found at the end of such a ray, which is a vertex or nothing, and the media there.
    pub(super) fn along(
        &mut self,
        mut ray: Ray,
        key: u32,
        lobe: Lobe,
        end: Option<&Vertex>,
        media: Media,
    ) -> (Vec3, Media) {
        if !self.objects {
            return (Vec3::ONE, media);
        }
        ray.t_max = end.map_or(ray.t_max, Vertex::distance);
        let hit = end.and_then(Vertex::on_object);
        let (weight, media) = match self.straight(lobe) {
            true => self.scene.objects.along_straight(ray, key, hit, media),
            false => self.scene.objects.within(media, hit, ray.t_max),
        };
        self.touched |= hit.is_some() || weight != Vec3::ONE;
        (weight, media)
    }

    /// What the objects let through along a ray, by the lobe that it serves.
    /// The ray starts in `media`. One triangle may be excepted: the one that shines at the end.
    pub(super) fn object_transmittance(
        &mut self,
        ray: Ray,
        key: u32,
        except: Option<u32>,
        media: Media,
    ) -> [Vec3; 2] {
        if !self.objects {
            return [Vec3::ONE; 2];
        }
        self.rays.shadow += 1;
        let objects = self.scene.objects;
        if !objects.bvh.any(ray, |hit| Some(hit.triangle) != except && objects.accepts(hit, key, false)) {
            let (left, _) = objects.within(media, None, ray.t_max);
            self.touched |= left != Vec3::ONE;
            return [left; 2];
        }
        self.touched = true;
        let straight =
            if objects.clear { objects.transmittance(ray, key, except, media) } else { Vec3::ZERO };
        [straight, Vec3::ZERO]
    }

    /// Light of the objects that a light sample brings to a surface, moved by `lift` for them, beside scattered rays and
    /// those `towards` the objects. The receiver hides it like any body.
    pub(super) fn sample_emitters(
        &mut self,
        (surface, lift): (&Surface, Vec3),
        key: u32,
        bounce: u32,
        towards: &Towards,
    ) -> Vec3 {
        let objects = self.scene.objects;
        if !self.objects || objects.emitters.is_empty() {
            return Vec3::ZERO;
        }
        let pair = LAMPS + 2 * bounce;
        let emitter = objects.sample_emitter(self.points.bits(pair)[0], self.points.bits(pair + 1));
        let to = emitter.position - (surface.position + lift);
        let distance = to.length();
        let direction = to / distance;
        // By solid angle; a lamp seen from the edge, or where the surface is, gives nothing.
        let pdf = emitter.pdf * distance * distance / emitter.normal.dot(direction).abs();
        let lobes = surface.bsdf.eval(direction);
        if !(pdf > 0.0 && pdf.is_finite()) || lobes.iter().all(|s| s.value == Vec3::ZERO) {
            return Vec3::ZERO;
        }
        // Past the receiver it is as far from where the surface is.
        let start = surface.ray_to_receiver(direction).origin;
        let way = emitter.way(start + lift);
        let ray = Ray { origin: start, t_max: way.t_max - objects.slack(&emitter.hit, direction), ..way };
        if !objects.accepts(&emitter.hit, key, false) || !self.passes(Block::Solid, ray) {
            return Vec3::ZERO;
        }
        self.touched = true;
        let ray = emitter.way(surface.ray_to_objects(direction, lift).origin);
        let unshaded =
            self.object_transmittance(ray, key, Some(emitter.hit.triangle), surface.medium(direction));
        // Rays to the objects are sent for diffuse lobes.
        let also = [towards.pdf(direction), 0.0];
        let weighed = |((s, unshaded), also): ((&Scatter, Vec3), f32)| {
            unshaded * s.value * power_heuristic(pdf, s.pdf + also)
        };
        let arrived: Vec3 = lobes.iter().zip(unshaded).zip(also).map(weighed).sum();
        arrived * objects.emission_towards(&emitter.hit, -direction) / pdf
    }

    /// The MIS weight of what shines at a hit that a scattered ray of some density found.
    pub(super) fn mis_weight(&mut self, hit: &Hit, ray: Ray, pdf: f32) -> f32 {
        let emitter_pdf = self.scene.objects.emitters.pdf(hit);
        let before = hit.t - self.scene.objects.slack(hit, ray.direction);
        if emitter_pdf == 0.0 || !self.passes(Block::Solid, Ray { t_max: before, ..ray }) {
            // What is never sampled as a lamp shines in full, if at all.
            return if emitter_pdf == 0.0 { 1.0 } else { 0.0 };
        }
        let cosine = self.scene.objects.normal(hit.triangle).dot(ray.direction).abs();
        power_heuristic(pdf, emitter_pdf * hit.t * hit.t / cosine.max(1e-12))
    }

    /// How far along a ray from a surface light starts that passes the receiver: it shows what is there, so what lies
    /// behind hides none of it. What is nearer than a mesh may be wrong is in its own way.
    fn start_of_light(&mut self, ray: Ray) -> f32 {
        self.rays.shadow += 1;
        let Scene { receiver, objects, .. } = self.scene;
        let beyond = objects.ground.error();
        let Some(hit) = receiver.bvh.closest(ray, |hit| hit.t > beyond) else { return ray.t_max };
        hit.t + objects.touching.allowance(&ray, hit.t, receiver.normal(hit.triangle))
    }

    /// What the objects let through of light along a ray, by the lobe that it serves; `to_receiver` is the same ray for the
    /// receiver. Where that is not solid to the light, objects behind it hide none.
    pub(super) fn sky_transmittance(
        &mut self,
        (to_receiver, to_objects): (Ray, Ray),
        solid: bool,
        key: u32,
        media: Media,
    ) -> [Vec3; 2] {
        let touched = self.touched;
        let all = self.object_transmittance(to_objects, key, None, media);
        if solid || all == [Vec3::ONE; 2] {
            return all;
        }
        let t_max = self.start_of_light(to_receiver);
        if t_max >= to_objects.t_max {
            return all;
        }
        self.touched = touched;
        self.object_transmittance(Ray { t_max, ..to_objects }, key, None, media)
    }

    /// An object that a ray of a lobe found, if it is not behind a receiver that lets light of the sky pass, and how far the
    /// ray goes.
    pub(super) fn before_the_light(
        &mut self,
        object: Option<Vertex>,
        ray: Ray,
        block: Block,
    ) -> (Option<Vertex>, f32) {
        let objects = self.scene.objects;
        let solid = block == Block::Solid || self.scene.rules.printed;
        if solid || !self.objects || !(object.is_some() || objects.clear) {
            return (object, ray.t_max);
        }
        let end = self.start_of_light(ray);
        // In the place of the receiver it is still before it.
        let place = |hit: &Hit| hit.t - (objects.reach(hit, ray.direction) - hit.t).abs();
        let before = |vertex: &Vertex| vertex.on_object().is_none_or(|hit| place(hit) <= end);
        (object.filter(before), end)
    }

    pub(super) fn passes(&mut self, block: Block, ray: Ray) -> bool {
        self.rays.shadow += u64::from(block != Block::Pass);
        block.passes(self.scene.receiver, ray)
    }

    /// Light samples for a vertex. The first of a path takes several of each tier: they cost less than another
    /// path, and what the picture shows of their noise is not blurred by anything. Later ones take one.
    pub(super) fn lights(
        &self,
        distributions: Distributions<'_>,
        pair: u32,
        several: Option<[u32; TIERS]>,
    ) -> FewDraws {
        let sky = self.scene.sky;
        let mut found = FewDraws::default();
        match several {
            Some(lights) => {
                let mut rest = wanted(distributions, lights, self.points, pair);
                if let Some(first) = rest.next() {
                    let mut all = [first; MANY];
                    let count = all[1..].iter_mut().zip(rest).map(|(slot, next)| *slot = next).count();
                    sky.draw_each(&all[..=count], |drawn| found.push(drawn));
                }
            }
            None if distributions.iter().any(|distribution| distribution.power > 0.0) => {
                let (tier, point) = sky.tier(distributions, self.points.bits(pair));
                let numbers = sky.numbers(distributions, None);
                found.push(sky.draw_one(tier, distributions[tier], numbers[tier], point));
            }
            None => {}
        }
        found
    }

    /// What the objects leave of the light that a place of the receiver throws back: the panorama was taken
    /// without them. One light sample for the place decides, in proportion to its light as good as that is;
    /// the way to it is that of the point of capture.
    fn dimming(
        &mut self,
        near: &NearFieldLight<'_>,
        (light, place): &ArrivingLight,
        (points, pair): (Points, u32),
        key: u32,
    ) -> Vec3 {
        let Some(place) = place.filter(|_| self.objects && !near.is_lamp(light.radiance)) else {
            return Vec3::ONE;
        };
        let light = self.scene.sky.sample_one(Some(place.normal), points.bits(DIMMING + pair));
        let Some(light) = light.filter(|light| light.direction.dot(place.normal) > 0.0) else {
            return Vec3::ONE;
        };
        // From below what lies on the place.
        let below = self.scene.objects.covers(place.position, place.normal).map(|below| -below);
        let start = place.position + place.normal * below.unwrap_or(place.margin);
        let ray = Ray::new(start, light.direction);
        let media = self.around(ray);
        // That light comes from a place of the receiver, too, or from the sky.
        self.sky_transmittance((ray, ray), false, key ^ 4, media)[0]
    }

    /// What a light sample brings to a surface. `near` are the receiver as the light, if it is, and the points
    /// of the sample.
    fn light_sample(
        &mut self,
        surface: &Surface,
        lift: Vec3,
        arriving: &ArrivingLight,
        near: Option<(&NearFieldLight<'_>, (Points, u32))>,
        key: u32,
    ) -> Vec3 {
        let (sample, place) = arriving;
        let lobes = surface.bsdf.eval(sample.direction);
        let useful = |s: &Scatter| s.value != Vec3::ZERO;
        if sample.radiance == Vec3::ZERO || !lobes.iter().any(useful) {
            return Vec3::ZERO;
        }
        let ray = NearFieldLight::towards(surface.ray_to_receiver(sample.direction), place.as_ref());
        let to_objects = Ray { t_max: ray.t_max, ..surface.ray_to_objects(sample.direction, lift) };
        let media = surface.medium(sample.direction);
        let mut unshaded = match place {
            Some(_) => self.object_transmittance(to_objects, key, None, media),
            None => self.sky_transmittance((ray, to_objects), self.scene.rules.is_solid(), key, media),
        };
        if let Some((near, points)) = near {
            let dimming = self.dimming(near, arriving, points, key);
            unshaded = unshaded.map(|passes| passes * dimming);
        }
        if unshaded == [Vec3::ZERO; 2] {
            return Vec3::ZERO;
        }
        let mut arrived = Vec3::ZERO;
        // Lobes that see the receiver alike share one ray.
        let mut told: Option<(Block, bool)> = None;
        for ((lobe, scatter), unshaded) in
            [Lobe::Diffuse, Lobe::Specular].into_iter().zip(&lobes).zip(unshaded)
        {
            if !useful(scatter) || unshaded == Vec3::ZERO {
                continue;
            }
            let block = self.scene.rules.visibility(lobe).shadow;
            let passes = match (told, near) {
                (Some((b, passes)), _) if b == block => passes,
                (_, None) => self.passes(block, ray),
                (_, Some((near, _))) => {
                    self.rays.shadow += 1;
                    near.reaches(ray, place.as_ref())
                }
            };
            told = Some((block, passes));
            if passes {
                arrived += unshaded * scatter.value * power_heuristic(sample.pdf, scatter.pdf);
            }
        }
        arrived * sample.radiance / sample.pdf
    }

    /// The same for a matte surface and a light that is far: light samples bring it all of that.
    fn matte_light_sample(&mut self, surface: &Surface, lift: Vec3, sample: &LightSample, key: u32) -> Vec3 {
        let scatter = surface.bsdf.eval(sample.direction)[Lobe::Diffuse as usize];
        if sample.radiance == Vec3::ZERO || scatter.value == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let ray = surface.ray_to_receiver(sample.direction);
        let to_objects = surface.ray_to_objects(sample.direction, lift);
        let (block, media) =
            (self.scene.rules.visibility(Lobe::Diffuse).shadow, surface.medium(ray.direction));
        let [unshaded, _] = self.sky_transmittance((ray, to_objects), block == Block::Solid, key, media);
        if unshaded == Vec3::ZERO || !self.passes(block, ray) {
            return Vec3::ZERO;
        }
        unshaded * scatter.value * sample.radiance / sample.pdf
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
            light += rules.clamped(bounce, throughput * surface.emission * mis_weight);
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
            if let Some(near) = near.filter(|_| landed.is_some() || object.is_none()) {
                self.rays.scattered += 1;
                if let Some(arriving) = near.eval(ray, side, landed.as_ref()) {
                    let dimming = self.dimming(&near, &arriving, (self.points, pair + 1), key);
                    let arrived = arriving.0.radiance
                        * power_heuristic(scatter.pdf, near_lights as f32 * arriving.0.pdf);
                    light += rules.clamped(bounce, throughput * scatter_weight * dimming * arrived);
                    light += self.lamps_beyond(
                        landed,
                        direction,
                        bounce,
                        (throughput * scatter_weight, share),
                        media,
                    );
                    break;
                }
            } else if object.is_none() && to_sky {
                let found = sky.eval(distributions, sky.numbers(distributions, several), direction);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_weights_sum_to_one() {
        for (a, b) in [(1.0, 2.0), (3e30, 1.0), (1e-30, 3e30), (0.5, 0.5), (7.0, 0.0)] {
            assert!((power_heuristic(a, b) + power_heuristic(b, a) - 1.0).abs() < 1e-6, "{a} {b}");
        }
        assert_eq!(power_heuristic(0.0, 0.0), 0.0);
    }
}
