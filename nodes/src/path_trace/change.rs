//! What the objects change of the light that leaves a point of the receiver.
//!
//! The light without the objects is known from samples of its own, so only the difference is estimated, and
//! only where there is one: light samples go to the part of the sky that the objects can hide, scattered rays
//! to the objects themselves. Where no ray meets an object the difference is 0, bit for bit.

use glam::Vec3;

use super::bsdf::Lobe;
use super::environment::DrawnDirection;
use super::integrator::{Integrator, PAIRS, PathState, Vertex};
use super::light_distribution::Cone;
use super::receiver::Surface;
use crate::bvh::{Hit, Ray};
use crate::sampling::{Points, circle, hash, unit};

/// First of the pairs of dimensions for rays to the objects: direction, whether one is sent, and whether the
/// sample asks for a change at all.
const TOWARDS: u32 = 1 << 17;
/// Rays to the objects for each steradian in which they are seen.
const RAYS: f32 = 1.0;

/// Where the objects are for the first vertex.
#[derive(Debug, Clone, Copy)]
pub struct ChangeSampling<'a> {
    /// Directions of the part of the sky that they can hide.
    pub drawn: &'a [DrawnDirection],
    /// Probability that the sample asks for a change: see [`asks`].
    pub probability: f32,
    /// Where rays to them start.
    pub start: Vec3,
    /// The box around them.
    pub objects: [Vec3; 2],
    /// Added to the start of rays to them: see [`super::contact`].
    pub lift: Vec3,
}

/// Whether a sample asks for a change, of which samples do so with a probability.
pub fn asks(points: &Points, probability: f32) -> bool {
    probability >= 1.0 || unit(points.bits(TOWARDS + 2)[0]) < probability
}

/// First of the pairs of dimensions for light samples of the first vertex.
pub const FIRST_LIGHTS: u32 = 1;

impl Integrator<'_> {
    /// Radiance with the objects less radiance without, at a hit of the receiver by a ray of the camera.
    pub fn change(&mut self, hit: Hit, ray: Ray, sampling: &ChangeSampling<'_>) -> Vec3 {
        if self.scene.rules.near.is_some() {
            self.paired_estimate(hit, ray, sampling.lift)
        } else if asks(&self.points, sampling.probability) {
            self.separate_estimate(hit, sampling) / sampling.probability
        } else {
            Vec3::ZERO
        }
    }

    /// What the objects take and give, each by samples of its own.
    fn separate_estimate(&mut self, mut hit: Hit, sampling: &ChangeSampling<'_>) -> Vec3 {
        let (sky, rules) = (self.scene.sky, self.scene.rules);
        let (mut light, mut throughput) = (Vec3::ZERO, Vec3::ONE);
        let mut lift = sampling.lift;
        for bounce in 0..=rules.max_bounces {
            let surface = self.receiver_surface(&hit, lift);
            let surface = Surface { media: [self.around(surface.upright(lift)); 2], ..surface };
            let pair = FIRST_LIGHTS + bounce * PAIRS;
            let key = hash(self.key, pair);
            let first = bounce == 0;

            // Light of the sky that they take away.
            let own;
            let drawn = if first {
                sampling.drawn
            } else {
                own = self.lights(sky.distributions(surface.bsdf.lit_side()), pair, None);
                own.as_slice()
            };
            let mut taken = Vec3::ZERO;
            for (number, drawn) in drawn.iter().enumerate() {
                taken += self.blocked_light(&surface, lift, drawn, key.wrapping_add(number as u32));
            }
            light -= rules.clamped(bounce, throughput * taken);

            // Light that they give: their own, by samples of it,
            let lamps = self.sample_emitters(&surface, key ^ 2, bounce);
            light += rules.clamped(bounce, throughput * lamps);

            // and what they scatter, by rays to where they are
            let cone = match first && self.scene.objects.emitters.is_empty() && surface.cover.is_none() {
                true => Cone::between([sampling.start; 2], sampling.objects),
                false => Cone::ALL,
            };
            let cone_pdf = cone_pdf(&cone);
            if cone_pdf > 0.0 && unit(self.points.bits(TOWARDS + 1)[0]) < cone_pdf * cone.solid_angle() {
                let ray = towards(&cone, self.points.pair(TOWARDS));
                let seen = surface.bsdf.eval(ray)[Lobe::Diffuse as usize];
                if seen.pdf > 0.0 {
                    let throughput = throughput * seen.value / (seen.pdf + cone_pdf);
                    let points = self.points;
                    self.points = points.branch(TOWARDS);
                    light += self.difference(&surface, lift, ray, (throughput, seen.pdf), key ^ 3, bounce).0;
                    self.points = points;
                }
            }

            // and by rays in all directions, which find how the rest of the receiver changes too.
            let Some((_, ray, scatter)) = surface.bsdf.sample(&self.points, pair + 1) else { break };
            let inside = cone_pdf > 0.0 && ray.dot(cone.axis) >= cone.cosine;
            let scatter_weight = scatter.value / scatter.pdf;
            let mis_weight = if inside { scatter.pdf / (scatter.pdf + cone_pdf) } else { 1.0 };
            let how = (throughput * scatter_weight * mis_weight, scatter.pdf);
            let (change, landed) = self.difference(&surface, lift, ray, how, key ^ 1, bounce);
            light += change;
            if !rules.visibility(Lobe::Diffuse).lands
                && let Some(unlit) = self.unlit(surface.spawn_ray(ray))
            {
                let way = Ray { t_max: unlit.t, ..surface.ray_to_objects(ray, lift) };
                if self.object(way, key ^ 1, Lobe::Diffuse).is_none() {
                    let end = Vertex::Receiver(unlit);
                    let (passed, media) =
                        self.along(way, key ^ 1, Lobe::Diffuse, Some(&end), surface.medium(ray));
                    let throughput = throughput * scatter_weight * passed;
                    light += self.lamps_beyond(Some(unlit), ray, bounce, throughput, media);
                }
            }
            let Some(next) = landed else { break };
            let Some(left) = self.russian_roulette(bounce, throughput * scatter_weight) else { break };
            (hit, throughput, lift) = (next, left, Vec3::ZERO);
        }
        light
    }

    /// The same by whole paths with and without the objects, which share their random numbers: where the
    /// receiver is the light, objects also take from what its places give.
    fn paired_estimate(&mut self, hit: Hit, ray: Ray, lift: Vec3) -> Vec3 {
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
    fn blocked_light(&mut self, surface: &Surface, lift: Vec3, drawn: &DrawnDirection, key: u32) -> Vec3 {
        let scatter = surface.bsdf.eval(drawn.direction)[Lobe::Diffuse as usize];
        if scatter.value == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let ray = surface.spawn_ray(drawn.direction);
        let to_objects = surface.ray_to_objects(drawn.direction, lift);
        let [straight, _] = self.object_transmittance(to_objects, key, None, surface.medium(ray.direction));
        if straight == Vec3::ONE || !self.passes(self.scene.rules.visibility(Lobe::Diffuse).shadow, ray) {
            return Vec3::ZERO;
        }
        let light = self.scene.sky.light(drawn);
        (Vec3::ONE - straight) * scatter.value * light.radiance / light.pdf
    }

    /// What comes along a scattered ray with the objects, less what comes without, where they come in its way;
    /// where they do not, the receiver that it lands on. `how` is the weight of what is found, and the
    /// density of the ray.
    fn difference(
        &mut self,
        surface: &Surface,
        lift: Vec3,
        direction: Vec3,
        (throughput, pdf): (Vec3, f32),
        key: u32,
        bounce: u32,
    ) -> (Vec3, Option<Hit>) {
        let rules = self.scene.rules;
        let ray = surface.spawn_ray(direction);
        let lands = bounce < rules.max_bounces && rules.visibility(Lobe::Diffuse).lands;
        let landed = if lands { self.receiver_hit(ray) } else { None };
        let (objects, receiver) = (self.scene.objects, self.scene.receiver);
        let allowance = |l: &Hit| objects.touching.allowance(&ray, l.t, receiver.normal(l.triangle));
        let t_max = landed.map_or(ray.t_max, |l| l.t + allowance(&l));
        let to_objects = Ray { t_max, ..surface.ray_to_objects(direction, lift) };
        let before = |hit: &Hit| landed.is_none_or(|l| hit.t - objects.slack(hit, direction) <= l.t);
        let object = self.object(to_objects, key, Lobe::Diffuse);
        let object = object.filter(|vertex| vertex.on_object().is_none_or(before));
        let found = object.or(landed.map(Vertex::Receiver));
        let start = surface.medium(direction);
        let (passed, media) = self.along(to_objects, key, Lobe::Diffuse, found.as_ref(), start);
        if object.is_none() && passed == Vec3::ONE {
            return (Vec3::ZERO, landed);
        }
        let way = PathState { direction, bounce: bounce + 1, throughput, mis_weight: 1.0, media };
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
            self.objects = false;
            change -= self.path_radiance(Vertex::Receiver(hit), way);
            self.objects = true;
        }
        (change, None)
    }

    fn receiver_hit(&mut self, ray: Ray) -> Option<Hit> {
        self.rays.scattered += 1;
        self.scene.receiver.bvh.closest(ray, |_| true)
    }
}

/// Density of rays to the objects: so many a steradian, at most one in all; 0 where they may be anywhere.
fn cone_pdf(cone: &Cone) -> f32 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::stream;
    use crate::testing::chi_square;

    /// Chi-square of rays to the objects against their density, by rings and sectors of the cone, and of how often one is
    /// sent.
    /// Mutation: `below` to `v * below` in `towards`, or the lower bound of `RAYS` left out of `cone_pdf` (each seen red).
    #[test]
    fn rays_to_the_objects_fill_their_cone_evenly() {
        let axis = Vec3::new(0.48, -0.6, 0.64);
        for cosine in [0.1_f32, 0.7, 0.96, 1.0 - 1e-5] {
            let cone = Cone { axis, cosine };
            let across = axis.any_orthonormal_vector();
            let (n, mut counts) = (100_000, vec![0.0; 12 * 12 + 1]);
            for i in 0..n {
                let points = Points::new(stream(4, i, 0), 0);
                let sent = unit(points.bits(TOWARDS + 1)[0]) < cone_pdf(&cone) * cone.solid_angle();
                let ray = towards(&cone, points.pair(TOWARDS)).as_dvec3();
                assert!((ray.length() - 1.0).abs() < 1e-5);
                // What is above 1 - cosine is taken from the chord, which keeps its digits.
                let below = 0.5 * (ray - axis.as_dvec3()).length_squared() / f64::from(1.0 - cosine);
                let [x, y] = [across, axis.cross(across)].map(|side| ray.dot(side.as_dvec3()));
                let turns = crate::num::atan2(y, x) / std::f64::consts::TAU + 0.5;
                let [ring, sector] = [below, turns].map(|at| ((12.0 * at) as usize).min(11));
                counts[if sent { ring * 12 + sector } else { 144 }] += 1.0;
            }
            let sent = f64::from(cone_pdf(&cone) * cone.solid_angle());
            assert!(sent <= 1.0 + 1e-6);
            let mut expected = vec![f64::from(n) * sent / 144.0; 144];
            expected.push(f64::from(n) * (1.0 - sent).max(0.0));
            let z = chi_square(&counts, &expected);
            assert!(z < 4.0, "{cosine}: {z}");
        }
    }
}
