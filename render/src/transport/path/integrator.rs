//! Estimator of radiance along a camera ray.

use glam::Vec3;

use super::first_vertex::FirstVertex;
use super::light_points::LightPoints;
use super::near_field::NearFieldLight;
use super::path::{Path, PathState, ShadingPoint, Vertex, first_pair};
use super::rays::Rays;
use super::visibility::Rules;
use crate::geometry::bvh::{Hit, Ray};
use crate::geometry::sampling::{Points, unit};
use crate::transport::scene::media::Media;
use crate::transport::scene::objects::Objects;
use crate::transport::scene::receiver::Receiver;
use crate::transport::scene::surface::Surface;
use crate::transport::sky::cone::Towards;
use crate::transport::sky::environment::{Distributions, DrawnDirection, EnvironmentLight};

/// Growth of the footprint per unit of length for rays from matte surfaces. The mean over these rays is blurred
/// anyway, since there are many of them.
pub(crate) const BLUR: f32 = 0.05;
/// Number of the first vertex of a path at which Russian roulette applies. Vertices are numbered from 1.
const ROULETTE_FROM: u32 = 3;

/// Scene that all rays share.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The receiver mesh.
    pub receiver: &'a Receiver,
    /// The inserted objects.
    pub objects: &'a Objects,
    /// The environment.
    pub sky: &'a EnvironmentLight,
    /// The visibility of the receiver for each kind of ray.
    pub rules: &'a Rules,
    /// Virtual lights; used under near light with objects.
    pub light_points: Option<&'a LightPoints>,
}

/// Settings for the paths of a sample, and for the sampling of their first vertex. A sub-path with other
/// settings gets a changed copy, by `Integrator::with`.
#[derive(Debug, Clone, Copy)]
pub struct Pass<'a> {
    /// Random numbers.
    pub points: Points,
    /// True if the objects are present.
    pub objects: bool,
    /// True if the light that the objects emit is included.
    pub lamps: bool,
    /// Light distributions of the first vertex. `None` uses the distributions for its normal.
    pub distributions: Option<Distributions<'a>>,
    /// Light samples of the first vertex, if they are already drawn.
    pub drawn: Option<&'a [DrawnDirection]>,
    /// Results of the rays of the first vertex without the objects, under near light, if they are already traced.
    pub(crate) known: Option<&'a FirstVertex>,
    /// True if only [`Tally::touched`] is wanted. Rays that affect only the light are not traced, the light is
    /// meaningless, and paths end when an object is touched. Used under near light.
    pub(crate) touch_only: bool,
    /// Offset added to the origin of rays to objects from the first vertex; see [`Surface::lift`].
    pub lift: Vec3,
    /// Sampling of rays from the first vertex towards the objects, in addition to scattered rays.
    pub(crate) towards: Towards,
    /// Growth of the camera ray's footprint per unit of length, for the textures of objects.
    pub spread: f32,
}

impl Pass<'_> {
    /// Settings for paths with or without the objects, with no special sampling of the first vertex.
    pub fn new(points: Points, objects: bool) -> Self {
        Self {
            points,
            objects,
            lamps: true,
            distributions: None,
            drawn: None,
            known: None,
            touch_only: false,
            lift: Vec3::ZERO,
            towards: Towards::NOWHERE,
            spread: 0.0,
        }
    }
}

/// Counts and flags for the paths of a sample.
#[derive(Debug, Clone, Copy, Default)]
pub struct Tally {
    /// Numbers of rays cast.
    pub rays: Rays,
    /// True if a ray hit an object.
    pub touched: bool,
    /// True if the limit on bounces ended a path on an object while the path still carried more than half of its
    /// light.
    pub cut: bool,
}

/// Traces the paths of one sample of one pixel. Random numbers depend only on the sample and the vertex, so
/// paths with and without objects are identical until they hit an object.
#[derive(Debug)]
pub struct Integrator<'a> {
    pub(crate) scene: Scene<'a>,
    pub(crate) key: u32,
    pub(crate) pass: Pass<'a>,
    /// Counts and flags for the paths so far.
    pub tally: Tally,
}

impl<'a> Scene<'a> {
    /// Near light, if it is used.
    pub(crate) fn near(&self) -> Option<NearFieldLight<'a>> {
        let near =
            |eye| NearFieldLight { receiver: self.receiver, sky: self.sky, eye: Vec3::from_array(eye) };
        self.rules.near.map(near)
    }
}

impl<'a> Integrator<'a> {
    /// Starts the paths of a sample with hash key `key`.
    pub fn new(scene: Scene<'a>, key: u32, pass: Pass<'a>) -> Self {
        let objects = pass.objects && !scene.objects.is_empty();
        Self { scene, key, pass: Pass { objects, ..pass }, tally: Tally::default() }
    }

    /// Runs `trace` with other settings and returns its result. The tally includes the rays that `trace` casts.
    pub(crate) fn with<'b, T>(&mut self, pass: Pass<'b>, trace: impl FnOnce(&mut Integrator<'b>) -> T) -> T
    where
        'a: 'b,
    {
        let mut sub = Integrator { scene: self.scene, key: self.key, pass, tally: self.tally };
        let result = trace(&mut sub);
        self.tally = sub.tally;
        result
    }

    /// True if a path that only looks for objects has touched one.
    pub(crate) fn may_stop(&self) -> bool {
        self.pass.touch_only && self.tally.touched
    }

    /// Receiver surface at a hit that lies outside all bodies, seen from the unit direction `out`. Rays from it to
    /// objects start at the offset `lift`.
    pub(crate) fn receiver_surface(&self, hit: &Hit, out: Vec3, lift: Vec3) -> Surface {
        let surface = self.scene.receiver.surface(hit, out);
        let covers = || self.scene.objects.covers(surface.position + lift, surface.normal);
        let cover = if self.pass.objects { covers() } else { None };
        Surface { cover, lift, ..surface }
    }

    pub(crate) fn surface(
        &mut self,
        vertex: &Vertex,
        (out, width): (Vec3, f32),
        lift: Vec3,
        media: Media,
    ) -> Surface {
        let (hit, straight) = match vertex {
            Vertex::Receiver(hit) => {
                return Surface { media: [media; 2], ..self.receiver_surface(hit, out, lift) };
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
            // Where two bodies touch, the path sees one of the two surfaces and may be outside the first body.
            surface.media[1] = self.around(surface.spawn_ray(-surface.normal));
        }
        surface
    }

    /// Radiance along a camera ray of unit direction, given its first vertex. Media in front of the receiver are
    /// ignored.
    pub fn radiance(&mut self, first: Vertex, ray: Ray) -> Vec3 {
        let (mut throughput, mut media) = (Vec3::ONE, Media::default());
        let objects = self.scene.objects;
        match &first {
            _ if !self.pass.objects || objects.bodies.is_empty() => {}
            Vertex::Receiver(hit) => {
                let surface = self.receiver_surface(hit, -ray.direction, self.pass.lift);
                media = self.around(surface.upright());
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

    /// Radiance that a vertex sends back along a path.
    pub(crate) fn path_radiance(&mut self, vertex: Vertex, state: PathState) -> Vec3 {
        let spread = if state.bounce == 0 { self.pass.spread } else { BLUR };
        let mut path = Path { vertex, state, width: 0.0, spread, touches: false, light: Vec3::ZERO };
        while self.step(&mut path).is_some() {}
        path.light
    }

    /// Adds the light of the current vertex and advances the path. `None` if the path ends.
    fn step(&mut self, path: &mut Path) -> Option<()> {
        let rules = self.scene.rules;
        let PathState { bounce, throughput, share, mis_weight, media, direction } = path.state;
        path.width += path.spread * path.vertex.distance();
        let lift = if bounce == 0 { self.pass.lift } else { Vec3::ZERO };
        let surface = self.surface(&path.vertex, (-direction, path.width), lift, media);
        let at = ShadingPoint::new(surface, bounce, self.key);
        // Emission found by a ray is light of the previous vertex.
        let emitted = self.emitted(&path.vertex, &at, -direction);
        path.light += rules.clamped(bounce.saturating_sub(1), throughput * emitted * mis_weight);
        if bounce > rules.max_bounces {
            self.tally.cut |= path.vertex.on_object().is_some() && throughput.max_element() > 0.5;
            return None;
        }
        path.light += rules.clamped(bounce, throughput * self.lit(&at));
        if self.may_stop() {
            return None;
        }
        let towards = self.towards_objects(&path.vertex, &at);
        path.light += rules.clamped(bounce, throughput * self.sample_emitters(&at, &towards));
        path.light += self.sent(&at, &towards, (throughput, share), Self::path_radiance);
        let scattered = self.scatter(path, &at)?;
        if self.may_stop() {
            return None;
        }
        self.collect(path, &at, &scattered)?;
        self.go_on(path, &towards, scattered)
    }

    /// Emission of a vertex towards `out`.
    fn emitted(&self, vertex: &Vertex, at: &ShadingPoint, out: Vec3) -> Vec3 {
        let objects = self.scene.objects;
        match vertex.on_object() {
            _ if !self.pass.lamps => Vec3::ZERO,
            // Light samples use the emission of the material under its layers; so must the rays that they are
            // weighted against, or small lamps would count twice.
            Some(hit) if !at.is_first() && !objects.emitters.is_empty() => objects.emission_towards(hit, out),
            _ => at.surface.emission,
        }
    }

    /// Sampling of rays from a vertex towards the objects, in addition to scattered rays.
    fn towards_objects(&self, vertex: &Vertex, at: &ShadingPoint) -> Towards {
        match vertex {
            _ if !at.is_first() || !self.pass.objects => Towards::NOWHERE,
            Vertex::Receiver(_) if at.surface.cover.is_none() => self.pass.towards,
            Vertex::Receiver(_) => Towards::NOWHERE,
            Vertex::Object(_) | Vertex::Straight(_) => self.scene.objects.shades.towards(at.surface.position),
        }
    }

    /// Throughput after Russian roulette. `None` if the path ends. The factor `share` of the throughput (see
    /// `PathState::share`) has no effect on the survival probability.
    pub fn russian_roulette(&self, bounce: u32, throughput: Vec3, share: f32) -> Option<Vec3> {
        russian_roulette(&self.pass.points, bounce, throughput, share)
    }
}

/// Throughput after Russian roulette with the random numbers of a sample; see [`Integrator::russian_roulette`].
pub(crate) fn russian_roulette(points: &Points, bounce: u32, throughput: Vec3, share: f32) -> Option<Vec3> {
    if bounce + 1 < ROULETTE_FROM {
        return Some(throughput);
    }
    let survival = (throughput.max_element() / share).clamp(0.05, 0.95);
    (unit(points.bits(first_pair(bounce) + 3)[0]) < survival).then(|| throughput / survival)
}
