//! Next-event estimation: light samples of the sky, of the receiver under near light, and of emitters.

use glam::Vec3;

use super::first_vertex::FirstVertex;
use super::integrator::Integrator;
use super::near_draws::{NearDraws, NearSamples};
use super::near_field::{ArrivingLight, NearFieldLight};
use super::path::ShadingPoint;
use crate::geometry::bvh::{Hit, Ray};
use crate::geometry::sampling::Points;
use crate::transport::bsdf::{Lobe, Scatter};
use crate::transport::scene::block::Block;
use crate::transport::scene::surface::Surface;
use crate::transport::sky::cone::Towards;
use crate::transport::sky::environment::{Distributions, DrawnDirection, LightSample, TIERS};
use crate::transport::sky::light_draws::wanted;

/// Index of the first pair of sample dimensions that are reserved for emitter samples. Each vertex of a path uses
/// two pairs, from `LAMPS + 2 * bounce`: one to choose an emitter, and one to choose a position on it.
const LAMPS: u32 = 1 << 16;
/// Offset between two pairs of sample dimensions. Added to the pair of a light sample or scattered ray, it gives
/// the pair that chooses the virtual light in `dimming`.
const DIMMING: u32 = 3 << 17;
/// Same as [`DIMMING`], for the pair that chooses a direction within the virtual light if this light is a piece of
/// the sky.
const DIMMING_PIECE: u32 = 7 << 16;
/// Maximum number of light samples per vertex.
const MANY: usize = 5;
/// Light samples of a vertex.
#[derive(Debug, Default)]
pub(crate) struct FewDraws {
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
    pub(crate) fn as_slice(&self) -> &[DrawnDirection] {
        &self.draws[..self.count]
    }
}

/// MIS weight of a strategy with density `a` against another strategy with density `b` (Veach 1997, power
/// heuristic).
pub(crate) fn power_heuristic(a: f32, b: f32) -> f32 {
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

impl<'a> Integrator<'a> {
    /// Light distributions of the sky for a vertex.
    pub(crate) fn sky_distributions(&self, at: &ShadingPoint) -> Distributions<'a> {
        let usual = || self.scene.sky.distributions(at.surface.bsdf.lit_side());
        self.pass.distributions.filter(|_| at.is_first()).unwrap_or_else(usual)
    }

    /// Number of light samples that a vertex takes in each tier of the sky. `None` if it takes a single sample in
    /// total.
    pub(crate) fn several(&self, at: &ShadingPoint) -> Option<[u32; TIERS]> {
        at.is_first().then_some(self.scene.sky.lights)
    }

    /// Light of the environment at a vertex, estimated by light samples.
    pub(crate) fn lit(&mut self, at: &ShadingPoint) -> Vec3 {
        match self.scene.near() {
            Some(near) => self.lit_by_receiver(&near, at),
            None => self.lit_by_sky(at),
        }
    }

    fn lit_by_receiver(&mut self, near: &NearFieldLight<'a>, at: &ShadingPoint) -> Vec3 {
        if let Some(known) = self.pass.known.filter(|_| at.is_first()) {
            return self.lit_as_known(near, at, known);
        }
        let lights = near.lights(at.is_first()).count();
        let samples = self.near_samples(near, at);
        let mut lit = Vec3::ZERO;
        for (number, arriving) in (0..lights).zip(&samples) {
            let Some(arriving) = arriving else { continue };
            let points = self.pass.points.twig(number, lights);
            let key = at.key.wrapping_add(number);
            lit += self.light_sample(at, arriving, Some((near, (points, at.pair))), key);
            if self.may_stop() {
                break;
            }
        }
        lit
    }

    /// Near light at the first vertex of a path, which is on the receiver, given the light without the objects. Only
    /// the share that the objects leave is traced.
    fn lit_as_known(&mut self, near: &NearFieldLight<'a>, at: &ShadingPoint, known: &FirstVertex) -> Vec3 {
        let (surface, lights) = (&at.surface, near.lights(at.is_first()).count());
        let mut lit = Vec3::ZERO;
        for (number, (arriving, &light)) in (0..lights).zip(known.arriving.iter().zip(&known.lit)) {
            let Some(arriving) = arriving.as_ref().filter(|_| light != Vec3::ZERO) else { continue };
            let (sample, place) = arriving;
            let key = at.key.wrapping_add(number);
            let ray = NearFieldLight::towards(surface.ray_to_receiver(sample.direction), place.as_ref());
            let to_objects = Ray { t_max: ray.t_max, ..surface.ray_to_objects(sample.direction) };
            let media = surface.medium(sample.direction);
            let [mut left, _] = self.object_transmittance(to_objects, key, None, media);
            if left != Vec3::ZERO {
                let points = self.pass.points.twig(number, lights);
                left *= self.dimming(near, arriving, (points, at.pair), key);
            }
            lit += light * left;
        }
        lit
    }

    /// Light samples of near light at a vertex, with their densities. Entries are `None` where no light comes from
    /// the lit side.
    pub(crate) fn near_samples(&mut self, near: &NearFieldLight<'a>, at: &ShadingPoint) -> NearSamples {
        let (surface, lights) = (&at.surface, near.lights(at.is_first()));
        self.tally.rays.shadow += u64::from(lights.count());
        let vertex = (surface.looks_from(), near.samples(surface.bsdf.lit_side(), lights));
        NearDraws::at_one(*near, vertex, self.pass.points, lights, at.pair)
    }

    fn lit_by_sky(&mut self, at: &ShadingPoint) -> Vec3 {
        let (sky, surface) = (self.scene.sky, &at.surface);
        let own;
        let drawn = match self.pass.drawn.filter(|_| at.is_first()) {
            Some(drawn) => drawn,
            None => {
                own = self.lights(self.sky_distributions(at), at.pair, self.several(at));
                own.as_slice()
            }
        };
        // Fetched together, so that memory accesses overlap.
        let mut lights = [None; MANY];
        lights.iter_mut().zip(drawn).for_each(|(light, drawn)| *light = Some(sky.light(drawn)));
        let mut lit = Vec3::ZERO;
        for (number, sample) in lights.iter().flatten().enumerate() {
            let key = at.key.wrapping_add(number as u32);
            lit += match surface.bsdf.is_matte() {
                true => self.matte_light_sample(surface, sample, key),
                false => self.light_sample(at, &(*sample, None), None, key),
            };
        }
        lit
    }

    /// Light of an emitter sample at a vertex, with MIS weights against scattered rays and against rays `towards`
    /// the objects. The receiver blocks this light like any solid surface.
    pub(crate) fn sample_emitters(&mut self, at: &ShadingPoint, towards: &Towards) -> Vec3 {
        let (objects, surface) = (self.scene.objects, &at.surface);
        if !self.pass.lamps || !self.pass.objects || objects.emitters.is_empty() {
            return Vec3::ZERO;
        }
        let pair = LAMPS + 2 * at.bounce;
        let emitter = objects.sample_emitter(self.pass.points.bits(pair)[0], self.pass.points.bits(pair + 1));
        let to = emitter.position - (surface.position + surface.lift);
        let distance = to.length();
        let direction = to / distance;
        // Density by solid angle. An emitter seen edge-on, or at the surface itself, contributes nothing.
        let pdf = emitter.pdf * distance * distance / emitter.normal.dot(direction).abs();
        let lobes = surface.bsdf.eval(direction);
        if !(pdf > 0.0 && pdf.is_finite()) || lobes.iter().all(|s| s.value == Vec3::ZERO) {
            return Vec3::ZERO;
        }
        // For the receiver, the ray has the same length from the offset origin.
        let start = surface.ray_to_receiver(direction).origin;
        let way = emitter.way(start + surface.lift);
        let ray = Ray { origin: start, t_max: way.t_max - objects.slack(&emitter.hit, direction), ..way };
        let coverage = objects.coverage(&emitter.hit, false);
        if coverage == 0.0 || !self.passes(Block::Solid, ray) {
            return Vec3::ZERO;
        }
        self.tally.touched = true;
        let ray = emitter.way(surface.ray_to_objects(direction).origin);
        let (except, media) = (Some(emitter.hit.triangle), surface.medium(direction));
        let unshaded = self.object_transmittance(ray, at.key ^ 2, except, media);
        // Rays towards objects serve diffuse lobes.
        let also = [towards.pdf(direction), 0.0];
        let weighed = |((s, unshaded), also): ((&Scatter, Vec3), f32)| {
            unshaded * s.value * power_heuristic(pdf, s.pdf + also)
        };
        let arrived: Vec3 = lobes.iter().zip(unshaded).zip(also).map(weighed).sum();
        arrived * objects.emission_towards(&emitter.hit, -direction) * (coverage / pdf)
    }

    /// MIS weight, against emitter samples, of the emission at a hit of a scattered ray with density `pdf`.
    pub(crate) fn mis_weight(&mut self, hit: &Hit, ray: Ray, pdf: f32) -> f32 {
        let emitter_pdf = self.scene.objects.emitters.pdf(hit);
        let before = hit.t - self.scene.objects.slack(hit, ray.direction);
        if emitter_pdf == 0.0 || !self.passes(Block::Solid, Ray { t_max: before, ..ray }) {
            // Emission that is never sampled counts fully, if at all.
            return if emitter_pdf == 0.0 { 1.0 } else { 0.0 };
        }
        let cosine = self.scene.objects.normal(hit.triangle).dot(ray.direction).abs();
        power_heuristic(pdf, emitter_pdf * hit.t * hit.t / cosine.max(1e-12))
    }

    /// Draws the light samples of a vertex. The first vertex of a path takes several per tier, because light
    /// samples cost less than another path and their noise is directly visible. Later vertices take one.
    pub(crate) fn lights(
        &self,
        distributions: Distributions<'_>,
        pair: u32,
        several: Option<[u32; TIERS]>,
    ) -> FewDraws {
        let sky = self.scene.sky;
        let mut found = FewDraws::default();
        match several {
            Some(lights) => {
                let mut rest = wanted(distributions, lights, self.pass.points, pair);
                if let Some(first) = rest.next() {
                    let mut all = [first; MANY];
                    let count = all[1..].iter_mut().zip(rest).map(|(slot, next)| *slot = next).count();
                    sky.draw_each(&all[..=count], |drawn| found.push(drawn));
                }
            }
            None if distributions.iter().any(|distribution| distribution.power > 0.0) => {
                let numbers = sky.numbers(distributions, None);
                let (tier, point) = sky.tier(numbers, self.pass.points.bits(pair));
                found.push(sky.draw_one(tier, distributions[tier], numbers[tier], point));
            }
            None => {}
        }
        found
    }

    /// Share, per channel, of the light emitted by a receiver point that remains when the objects are in place. The
    /// panorama shows the point without objects, but the objects block a part of the light that falls on the point.
    /// For each channel, the share is estimated from one virtual light, which is chosen in proportion to the light
    /// that it contributes to the point.
    pub(crate) fn dimming(
        &mut self,
        near: &NearFieldLight<'_>,
        (light, place): &ArrivingLight,
        (points, pair): (Points, u32),
        key: u32,
    ) -> Vec3 {
        let Some(place) = place.filter(|_| self.pass.objects && !near.is_lamp(light.radiance)) else {
            return Vec3::ONE;
        };
        let (choice, within) = (points.bits(DIMMING + pair), points.pair(DIMMING_PIECE + pair));
        let Some(light_points) = self.scene.light_points else { return Vec3::ONE };
        // The ray starts below objects that lie on the point.
        let below = self.scene.objects.covers(place.position, place.normal).map(|below| -below);
        let start = place.position + place.normal * below.unwrap_or(place.margin);
        let chosen = light_points.choose(place.position, place.normal, choice, within);
        let mut left = Vec3::ONE;
        let mut last = None;
        for (k, way) in chosen.into_iter().enumerate() {
            let Some(way) = way else { continue };
            // Usually all channels choose the same piece.
            let passes = match last {
                Some((same, passes)) if same == way => passes,
                _ => {
                    let ray = NearFieldLight::up_to(Ray::new(start, way.direction), way.distance);
                    let media = self.around(ray);
                    self.sky_transmittance((ray, ray), false, key ^ 4, media)[0]
                }
            };
            last = Some((way, passes));
            left[k] = passes[k];
        }
        left
    }

    /// Light that a vertex reflects from a light sample. `near` contains the near light, if it is used, and the
    /// random numbers of the sample.
    fn light_sample(
        &mut self,
        at: &ShadingPoint,
        arriving: &ArrivingLight,
        near: Option<(&NearFieldLight<'_>, (Points, u32))>,
        key: u32,
    ) -> Vec3 {
        let ((sample, place), surface) = (arriving, &at.surface);
        let mut lobes = surface.bsdf.eval(sample.direction);
        let glossy = &mut lobes[Lobe::Specular as usize];
        // Light that only scattered rays find.
        let goes_on = place.is_some_and(|p| self.goes_on_at(Lobe::Specular, at.bounce, p.triangle));
        if self.scene.sky.is_narrow(glossy.pdf) || goes_on {
            *glossy = Scatter::default();
        }
        let useful = |s: &Scatter| s.value != Vec3::ZERO;
        if sample.radiance == Vec3::ZERO || !lobes.iter().any(useful) {
            return Vec3::ZERO;
        }
        let ray = NearFieldLight::towards(surface.ray_to_receiver(sample.direction), place.as_ref());
        let to_objects = Ray { t_max: ray.t_max, ..surface.ray_to_objects(sample.direction) };
        let media = surface.medium(sample.direction);
        let mut unshaded = match place {
            Some(_) => self.object_transmittance(to_objects, key, None, media),
            None => self.sky_transmittance((ray, to_objects), self.scene.rules.is_solid(), key, media),
        };
        if let Some((near, points)) = near {
            let dimming = self.dimming(near, arriving, points, key);
            unshaded = unshaded.map(|passes| passes * dimming);
        }
        if unshaded == [Vec3::ZERO; 2] || self.pass.touch_only {
            return Vec3::ZERO;
        }
        let mut arrived = Vec3::ZERO;
        // Lobes with the same visibility share one shadow ray.
        let mut cached: Option<(Block, bool)> = None;
        for ((lobe, scatter), unshaded) in
            [Lobe::Diffuse, Lobe::Specular].into_iter().zip(&lobes).zip(unshaded)
        {
            if !useful(scatter) || unshaded == Vec3::ZERO {
                continue;
            }
            let block = self.scene.rules.visibility(lobe).shadow;
            let passes = match (cached, near) {
                (Some((b, passes)), _) if b == block => passes,
                (_, None) => self.passes(block, ray),
                (_, Some((near, _))) => {
                    self.tally.rays.shadow += 1;
                    near.reaches(ray, place.as_ref())
                }
            };
            cached = Some((block, passes));
            if passes {
                arrived += unshaded * scatter.value * power_heuristic(sample.pdf, scatter.pdf);
            }
        }
        arrived * sample.radiance / sample.pdf
    }

    /// Same as [`light_sample`](Self::light_sample) for a matte surface and distant light, for which light
    /// samples alone are enough.
    fn matte_light_sample(&mut self, surface: &Surface, sample: &LightSample, key: u32) -> Vec3 {
        let scatter = surface.bsdf.eval(sample.direction)[Lobe::Diffuse as usize];
        if sample.radiance == Vec3::ZERO || scatter.value == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let ray = surface.ray_to_receiver(sample.direction);
        let to_objects = surface.ray_to_objects(sample.direction);
        let (block, media) =
            (self.scene.rules.visibility(Lobe::Diffuse).shadow, surface.medium(ray.direction));
        let [unshaded, _] = self.sky_transmittance((ray, to_objects), block == Block::Solid, key, media);
        if unshaded == Vec3::ZERO || !self.passes(block, ray) {
            return Vec3::ZERO;
        }
        unshaded * scatter.value * sample.radiance / sample.pdf
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
