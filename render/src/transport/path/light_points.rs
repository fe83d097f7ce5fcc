//! Virtual lights: points of the receiver and the sky that represent near light, used to find the share of a
//! point's light that objects block.
//!
//! A receiver point under near light has the radiance that the panorama shows, captured without the objects. The
//! objects block the same share of this radiance as of the irradiance at the point. If the objects add irradiance,
//! the radiance of the point grows in proportion. Both computations divide the incoming light into parts: each
//! virtual light represents a piece of the receiver around it, or of the sky, by its radiance, area and normal
//! (Keller 1997, virtual point lights).

use std::f32::consts::TAU;
use std::f64::consts::PI;

use fearless_simd::{Level, dispatch};
use glam::{DVec3, Vec3};
use scene::math::num;

use super::wide_lights::{LANES, LightPoint, WideLights};
use crate::geometry::bvh::Ray;
use crate::geometry::sampling::{Points, circle, fraction, stream};
use crate::transport::bsdf::Frame;
use crate::transport::scene::receiver::Receiver;
use crate::transport::sky::cone::Cone;
use crate::transport::sky::environment::EnvironmentLight;

/// Number of virtual lights.
const POINTS: usize = 1024;
/// Number of lights in a block. Each choice weighs the lights of one block, and every block covers all directions.
const BLOCK: usize = 32;
/// One virtual light in this many is sampled with a uniformly distributed direction, since surfaces that are dark
/// but near contribute too.
const SPREAD: u32 = 4;

/// The virtual lights.
#[derive(Debug)]
pub struct LightPoints {
    lights: Vec<LightPoint>,
    /// The same lights in groups of eight. The last group may have empty lanes.
    wide: Vec<WideLights>,
    /// SIMD level. Every level gives the same bits.
    level: Level,
}

// A block is a whole number of groups.
const _: () = assert!(BLOCK.is_multiple_of(LANES));

/// Direction and distance from a point to a virtual light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WayToLight {
    /// Unit direction.
    pub direction: Vec3,
    /// Distance from the point to the light.
    pub distance: f32,
}

impl LightPoints {
    /// Memory use in bytes.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&*self.lights) + size_of_val(&*self.wide)) as u64
    }

    /// Samples lights that are visible from a point of capture, most of them with about equal power at that point.
    /// Traces one ray per light.
    pub fn new(receiver: &Receiver, sky: &EnvironmentLight, eye: Vec3) -> Self {
        let point = |number: u32| {
            let points = Points::new(stream(0, 0, 0), number / SPREAD);
            let light = match number % SPREAD {
                0 => sky.eval_one(None, anywhere(points.pair(0))),
                twig => sky.sample_one(None, points.twig(twig, SPREAD).bits(1))?,
            };
            let any = 1.0 / SPREAD as f32;
            let pdf = (1.0 - any) * light.pdf + any / (2.0 * TAU);
            let (radiance, solid_angle) = (light.radiance, 1.0 / (pdf * POINTS as f32));
            let Some(hit) = receiver.bvh.closest(Ray::new(eye, light.direction), |_| true) else {
                return Some(LightPoint { at: light.direction, normal: None, radiance, size: solid_angle });
            };
            let (position, facing, _) = receiver.geometry(&hit);
            let cosine = facing.dot(light.direction);
            let normal = if cosine > 0.0 { -facing } else { facing };
            let size = solid_angle * hit.t * hit.t / cosine.abs().max(1e-6);
            Some(LightPoint { at: position, normal: Some(normal), radiance, size })
        };
        Self::of((0..POINTS as u32).filter_map(point).collect())
    }

    fn of(lights: Vec<LightPoint>) -> Self {
        let wide = lights.chunks(LANES).map(WideLights::new).collect();
        Self { lights, wide, level: Level::new() }
    }

    /// Chooses a light for each channel from one block of lights, in proportion to its contribution to a point. For
    /// a piece of the sky, the direction is random within the piece. One random number serves all channels, so that
    /// they usually choose the same light. Occlusion by the receiver is ignored. An entry is `None` if the block
    /// has no light of this channel on the side of the normal.
    pub fn choose(
        &self,
        place: Vec3,
        normal: Vec3,
        [block, choice]: [u32; 2],
        within: [f32; 2],
    ) -> [Option<WayToLight>; 3] {
        let blocks = self.lights.len().div_ceil(BLOCK);
        let at = ((u64::from(block) * blocks as u64) >> 32) as usize;
        let Some(block) = self.lights.chunks(BLOCK).nth(at) else { return [None; 3] };
        let mut sums = [DVec3::ZERO; BLOCK];
        let mut sum = DVec3::ZERO;
        let wide = self.wide[at * (BLOCK / LANES)..].iter().take(BLOCK / LANES);
        dispatch!(self.level, simd => {
            for (lights, slots) in wide.zip(sums.chunks_exact_mut(LANES)) {
                let light = lights.irradiance(simd, place, normal);
                for (lane, slot) in slots.iter_mut().enumerate() {
                    sum += DVec3::from_array([0, 1, 2].map(|k| f64::from(light[k][lane])));
                    *slot = sum;
                }
            }
        });
        let wanted = sum * fraction(choice);
        [0, 1, 2].map(|k| {
            let chosen = block.get(sums.iter().position(|up_to| up_to[k] > wanted[k])?)?;
            let way = chosen.seen_from(place);
            let direction = if chosen.normal.is_some() { way.direction } else { chosen.within(within) };
            Some(WayToLight { direction, ..way })
        })
    }

    /// Share of its incident light that a point reflects, at most 1 per channel. It is computed from the radiance
    /// that the panorama shows, and is the albedo of the point if the panorama is accurate. Occlusion by the
    /// receiver is ignored.
    pub fn albedo(&self, place: Vec3, normal: Vec3, radiance: Vec3) -> Vec3 {
        let mut irradiance = Vec3::ZERO;
        dispatch!(self.level, simd => {
            for lights in &self.wide {
                let [red, green, blue] = lights.irradiance(simd, place, normal);
                for ((red, green), blue) in red.into_iter().zip(green).zip(blue) {
                    irradiance += Vec3::new(red, green, blue);
                }
            }
        });
        let albedo = radiance * (0.5 * TAU) / irradiance;
        Vec3::select(irradiance.cmpgt(Vec3::ZERO), albedo, Vec3::ZERO).min(Vec3::ONE)
    }

    /// Upper bound of the probability that a chosen direction lies in a cone of solid angle `solid_angle`, for any
    /// such cone within `cone`.
    pub fn most_chosen(&self, cone: &Cone, solid_angle: f64) -> f64 {
        let angle = |solid_angle: f64| num::f64::acos(1.0 - (solid_angle / (2.0 * PI)).min(2.0));
        // For a piece of the sky: the direction of its centre, its angular radius, and its largest share within the
        // narrow cone.
        let pieces = self.lights.iter().filter(|point| point.normal.is_none()).map(|point| {
            let size = f64::from(point.size);
            (point.at.as_dvec3(), angle(size), (solid_angle / size).min(1.0))
        });
        let reach = angle(2.0 * PI * (1.0 - f64::from(cone.cosine)));
        let between = |a: DVec3, b: DVec3| num::f64::acos(a.dot(b).clamp(-1.0, 1.0)) - 1e-3;
        let there: Vec<(DVec3, f64, f64)> =
            pieces.filter(|piece| between(piece.0, cone.axis.as_dvec3()) <= reach + piece.1).collect();
        // No two pieces that overlap one narrow cone are farther apart.
        let around = |(middle, edge, _): &(DVec3, f64, f64)| -> f64 {
            let apart = |other: &&(DVec3, f64, f64)| {
                between(*middle, other.0) <= 2.0 * angle(solid_angle) + edge + other.1
            };
            there.iter().filter(apart).map(|(.., most)| most).sum()
        };
        let most = there.iter().map(around).fold(0.0, f64::max);
        (most / self.lights.len().div_ceil(BLOCK).max(1) as f64).min(1.0)
    }
}

impl LightPoint {
    /// Direction in the light's piece of the sky, chosen by two random numbers. The piece is represented by a cone
    /// of the same solid angle.
    fn within(&self, [u, v]: [f32; 2]) -> Vec3 {
        let (sin, cos) = circle(u);
        let below = v * (self.size / TAU).min(1.0);
        let radius = (below * (2.0 - below)).max(0.0).sqrt();
        Frame::around(self.at).from(Vec3::new(radius * cos, radius * sin, 1.0 - below))
    }

    /// Direction and distance to the light from a point.
    fn seen_from(&self, place: Vec3) -> WayToLight {
        if self.normal.is_none() {
            return WayToLight { direction: self.at, distance: f32::INFINITY };
        }
        let to = self.at - place;
        let distance = to.length();
        WayToLight { direction: to / distance, distance }
    }
}

/// A uniform direction of the sphere, from two random numbers.
fn anywhere([u, v]: [f32; 2]) -> Vec3 {
    let (z, (sin, cos)) = (1.0 - 2.0 * v, circle(u));
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * cos, radius * sin, z)
}

#[cfg(test)]
mod tests {
    use engine::Up;

    use super::*;
    use scene::types::Environment;
    use testing::direction;

    /// For any normal, the probability that the chosen direction lies in a cone of the sky is at most the bound.
    #[test]
    fn the_chance_of_a_choice_is_bounded() {
        let mut env = Environment::constant(Up::PlusZ, [0.3, 0.4, 0.6], 256);
        (0..16).for_each(|i| {
            env.image.pixel_mut(160 + i % 4, 24 + i / 4).copy_from_slice(&[900.0, 850.0, 700.0]);
        });
        let nothing = Receiver::new(&scene::types::Mesh::default(), DVec3::ZERO);
        let points = LightPoints::new(&nothing, &EnvironmentLight::new(&env), Vec3::ZERO);
        for (axis, cosine) in [(Vec3::new(0.44, 0.4, 0.8).normalize(), 0.95), (Vec3::Z, 0.97), (Vec3::X, 0.9)]
        {
            let bound = points.most_chosen(&Cone { axis, cosine }, 2.0 * PI * (1.0 - f64::from(cosine)));
            for i in 0..40 {
                let normal = direction(Points::new(9, i).pair(0));
                let inside = (0..1000).filter(|&k| {
                    let way = points.choose(
                        Vec3::ZERO,
                        normal,
                        Points::new(i, k).bits(0),
                        Points::new(i, k).pair(1),
                    );
                    way.iter().flatten().any(|way| way.direction.dot(axis) >= cosine)
                });
                let share = inside.count() as f64 / 1000.0;
                assert!(share <= bound + 0.02, "{normal}: {share} of {bound}");
            }
        }
        assert!(points.most_chosen(&Cone { axis: Vec3::Z, cosine: 0.9 }, 1e-5) < 1e-3);
    }
}
