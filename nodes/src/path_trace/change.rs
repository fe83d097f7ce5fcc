//! What the objects change of the light that leaves a point of the receiver.
//!
//! The light without the objects is known from samples of its own, so only the difference is estimated, and
//! only where there is one: light samples go to the part of the sky that the objects can hide, scattered rays
//! to the objects themselves. Where no ray meets an object the difference is 0, bit for bit.

use glam::Vec3;

use super::aim::Cone;
use super::bsdf::Lobe;
use super::light::{Drawn, Look, TIERS};
use super::scene::Surface;
use super::walk::{PAIRS, Vertex, Walk, Way};
use crate::bvh::{Hit, Ray};
use crate::sampling::{circle, hash, unit};

/// First of the pairs of dimensions for rays to the objects: direction, whether one is sent, and whether the
/// sample asks for a change at all.
const TOWARDS: u32 = 1 << 17;
/// Rays to the objects for each steradian in which they are seen.
const RAYS: f32 = 1.0;

/// Where the objects are for the first vertex.
#[derive(Debug, Clone, Copy)]
pub struct Reach<'a> {
    /// The part of the sky that they can hide.
    pub look: Look<'a>,
    /// Light samples of each tier.
    pub lights: [u32; TIERS],
    /// Odds that the sample asks for a change.
    pub odds: f32,
    /// Where rays to them start.
    pub start: Vec3,
    /// The box around them.
    pub objects: [Vec3; 2],
    /// Added to the start of rays to them: see [`super::contact`].
    pub lift: Vec3,
}

impl Walk<'_> {
    /// Radiance with the objects less radiance without, at a hit of the receiver by a ray of the camera.
    pub fn change(&mut self, hit: Hit, ray: Ray, reach: &Reach<'_>) -> Vec3 {
        if self.world.rules.near.is_some() {
            self.both(hit, ray, reach.lift)
        } else if reach.odds >= 1.0 || unit(self.points.bits(TOWARDS + 2)[0]) < reach.odds {
            self.apart(hit, reach) / reach.odds
        } else {
            Vec3::ZERO
        }
    }

    /// What the objects take and give, each by samples of its own.
    fn apart(&mut self, mut hit: Hit, reach: &Reach<'_>) -> Vec3 {
        let (sky, rules) = (self.world.sky, self.world.rules);
        let (mut light, mut weight) = (Vec3::ZERO, Vec3::ONE);
        let mut lift = reach.lift;
        for bounce in 0..=rules.max_bounces {
            let surface = self.world.receiver.surface(&hit);
            let surface = Surface { media: [self.around(surface.upright(lift)); 2], ..surface };
            let pair = 1 + bounce * PAIRS;
            let key = hash(self.key, pair);
            let first = bounce == 0;

            // Light of the sky that they take away.
            let look = if first { reach.look } else { sky.look(surface.bsdf.lit_side()) };
            let several = first.then_some(reach.lights);
            let mut taken = Vec3::ZERO;
            let lights = self.lights(look, pair, several);
            for (number, drawn) in lights.iter().flatten().enumerate() {
                taken += self.taken(&surface, lift, drawn, key.wrapping_add(number as u32));
            }
            light -= rules.clamped(bounce, weight * taken);

            // Light that they give: their own, by samples of it,
            let lamps = self.lamps(&surface, key ^ 2, bounce);
            light += rules.clamped(bounce, weight * lamps);

            // and what they scatter, by rays to where they are
            let cone = match first && self.world.objects.emitters.is_empty() {
                true => Cone::between([reach.start; 2], reach.objects),
                false => Cone::ALL,
            };
            let density = cone_density(&cone);
            if density > 0.0 && unit(self.points.bits(TOWARDS + 1)[0]) < density * cone.solid_angle() {
                let ray = towards(&cone, self.points.pair(TOWARDS));
                let seen = surface.bsdf.eval(ray)[Lobe::Diffuse as usize];
                if seen.pdf > 0.0 {
                    let weight = weight * seen.value / (seen.pdf + density);
                    let points = self.points;
                    self.points = points.branch(TOWARDS);
                    light += self.difference(&surface, lift, ray, (weight, seen.pdf), key ^ 3, bounce).0;
                    self.points = points;
                }
            }

            // and by rays in all directions, which find how the rest of the receiver changes too.
            let Some((_, ray, scatter)) = surface.bsdf.sample(&self.points, pair + 1) else { break };
            let inside = density > 0.0 && ray.dot(cone.axis) >= cone.cosine;
            let throughput = scatter.value / scatter.pdf;
            let both = if inside { scatter.pdf / (scatter.pdf + density) } else { 1.0 };
            let how = (weight * throughput * both, scatter.pdf);
            let (change, landed) = self.difference(&surface, lift, ray, how, key ^ 1, bounce);
            light += change;
            let Some(next) = landed else { break };
            let Some(left) = self.survives(bounce, weight * throughput) else { break };
            (hit, weight, lift) = (next, left, Vec3::ZERO);
        }
        light
    }

    /// The same by whole paths with and without the objects, which share their random numbers: where the
    /// receiver is the light, objects also take from what its places give.
    fn both(&mut self, hit: Hit, ray: Ray, lift: Vec3) -> Vec3 {
        self.lift = lift;
        let with = self.radiance(Vertex::Receiver(hit), ray);
        if !self.touched {
            return Vec3::ZERO;
        }
        self.objects = false;
        with - self.radiance(Vertex::Receiver(hit), ray)
    }

    /// What the objects take of the light that a light sample brings. How much that is asked last, since most
    /// samples meet no object.
    fn taken(&mut self, surface: &Surface, lift: Vec3, drawn: &Drawn, key: u32) -> Vec3 {
        let scatter = surface.bsdf.eval(drawn.direction)[Lobe::Diffuse as usize];
        if scatter.value == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let ray = surface.leave(drawn.direction);
        let to_objects = Ray { origin: ray.origin + lift, ..ray };
        let [straight, _] = self.unshaded(to_objects, key, None, surface.medium(ray.direction));
        if straight == Vec3::ONE || !self.passes(self.world.rules.sight(Lobe::Diffuse).shadow, ray) {
            return Vec3::ZERO;
        }
        let light = self.world.sky.light(drawn);
        (Vec3::ONE - straight) * scatter.value * light.radiance / light.density
    }

    /// What comes along a scattered ray with the objects, less what comes without, where they come in its way;
    /// where they do not, the receiver that it lands on. `how` is the weight of what is found, and the
    /// density of the ray.
    fn difference(
        &mut self,
        surface: &Surface,
        lift: Vec3,
        direction: Vec3,
        (weight, density): (Vec3, f32),
        key: u32,
        bounce: u32,
    ) -> (Vec3, Option<Hit>) {
        let rules = self.world.rules;
        let ray = surface.leave(direction);
        let lands = bounce < rules.max_bounces && rules.sight(Lobe::Diffuse).lands;
        let landed = if lands { self.landing(ray) } else { None };
        let to_objects = Ray { origin: ray.origin + lift, t_max: landed.map_or(ray.t_max, |l| l.t), ..ray };
        let object = self.object(to_objects, key, Lobe::Diffuse);
        let found = object.or(landed.map(Vertex::Receiver));
        let start = surface.medium(direction);
        let (passed, media) = self.along(to_objects, key, Lobe::Diffuse, found.as_ref(), start);
        if object.is_none() && passed == Vec3::ONE {
            return (Vec3::ZERO, landed);
        }
        let way = Way { direction, bounce: bounce + 1, weight, glow: 1.0, media };
        let mut change = Vec3::ZERO;
        if let Some(vertex) = found {
            let glow = match vertex {
                Vertex::Object(hit) | Vertex::Straight(hit) => self.glow(&hit, ray, density),
                Vertex::Receiver(_) => 1.0,
            };
            change += self.onward(vertex, Way { weight: weight * passed, glow, ..way });
        }
        if let Some(hit) = landed {
            self.objects = false;
            change -= self.onward(Vertex::Receiver(hit), way);
            self.objects = true;
        }
        (change, None)
    }

    fn landing(&mut self, ray: Ray) -> Option<Hit> {
        self.rays.scattered += 1;
        self.world.receiver.bvh.closest(ray, |_| true)
    }
}

/// Density of rays to the objects: so many a steradian, at most one in all; 0 where they may be anywhere.
fn cone_density(cone: &Cone) -> f32 {
    if cone.cosine > 0.0 { RAYS.min(1.0 / cone.solid_angle()) } else { 0.0 }
}

/// A direction in a cone, uniform over its solid angle.
fn towards(cone: &Cone, [u, v]: [f32; 2]) -> Vec3 {
    let (sin, cos) = circle(u);
    // From the axis up, so that narrow cones keep their precision.
    let below = v * (1.0 - cone.cosine);
    let radius = (below * (2.0 - below)).max(0.0).sqrt();
    let local = Vec3::new(radius * cos, radius * sin, 1.0 - below);
    super::bsdf::Frame::around(cone.axis).from(local)
}
