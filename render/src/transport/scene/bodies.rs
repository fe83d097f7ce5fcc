//! Transparent bodies along a ray: those that surround it, and the light that they absorb.

use std::cmp::Ordering;

use glam::Vec3;
use scene::math::num;

use super::face::margin;
use super::media::{MOST, Media};
use super::objects::{Objects, PlacedPrimitive};
use crate::geometry::bvh::{Hit, Ray};
use crate::geometry::sampling::{hash, unit};

/// Number of points per surface at which nested bodies are counted.
const SURFACE_SAMPLES: usize = 64;

/// Orders hits along a ray.
pub(crate) fn nearer(a: &Hit, b: &Hit) -> Ordering {
    a.t.total_cmp(&b.t).then(a.triangle.cmp(&b.triangle))
}

impl Objects {
    /// Media on the near and the far side of a surface, for a ray that travels in `media`.
    pub(crate) fn sides(&self, part: &PlacedPrimitive, back: bool, media: Media) -> [Media; 2] {
        match (part.body, back) {
            (None, _) => [media; 2],
            (Some(body), false) => [media, media.enter(body)],
            (Some(body), true) => [media.amid(body), media.without(body)],
        }
    }

    /// Indices of refraction of the media on the two sides of a surface.
    pub(crate) fn indices(&self, sides: [Media; 2]) -> [f32; 2] {
        sides.map(|media| media.all().last().map_or(1.0, |&body| self.bodies[body as usize].ior))
    }

    /// Absorption coefficient of the innermost body, per world unit.
    fn absorption(&self, media: Media) -> Vec3 {
        media.all().last().map_or(Vec3::ZERO, |&body| self.bodies[body as usize].absorption)
    }

    /// True if a point may be inside a body.
    pub fn may_hold(&self, point: Vec3) -> bool {
        self.held.is_some_and(|held| held.holds(point))
    }

    /// Bodies that contain the origin of a ray: the bodies that the ray leaves without having entered them.
    pub fn around(&self, ray: Ray, key: u32, camera: bool) -> Media {
        let mut crossed = Vec::new();
        self.bvh.any(ray, |hit| {
            if self.part(hit.triangle).0.body.is_some() && self.accepts(hit, key, camera) {
                crossed.push(*hit);
            }
            false
        });
        let (mut around, mut entered) = (Media::default(), Media::default());
        self.in_order(&mut crossed);
        for hit in crossed {
            let Some(body) = self.part(hit.triangle).0.body else { continue };
            match (hit.back, entered.all().contains(&body)) {
                (false, _) => entered = entered.enter(body),
                (true, true) => entered = entered.without(body),
                // The body left first was entered last.
                (true, false) => around = around.amid(body),
            }
        }
        around
    }

    /// Maximum number of nested bodies at sample points of their surfaces. `None` if it is at most `MOST`.
    pub fn nested_too_deep(&self) -> Option<usize> {
        if self.bodies.len() <= MOST {
            return None;
        }
        // A point just below a surface is inside each body that a ray from there leaves more often than it enters.
        let around = |triangle: u32, [a, b, c]: [Vec3; 3]| {
            let normal = self.normal(triangle);
            let ray = Ray::new((a + b + c) / 3.0 - normal * margin(&[a, b, c]), -normal);
            let mut left = vec![0_i32; self.bodies.len()];
            self.bvh.any(ray, |hit| {
                if let Some(body) = self.part(hit.triangle).0.body {
                    left[body as usize] += if hit.back { 1 } else { -1 };
                }
                false
            });
            left.iter().filter(|&&count| count > 0).count()
        };
        let of_bodies = self.parts_with_triangles().filter(|(part, _)| part.body.is_some());
        let deepest = of_bodies.flat_map(|(_, all)| {
            let step = all.len().div_ceil(SURFACE_SAMPLES).max(1);
            all.step_by(step).map(|triangle| around(triangle as u32, self.corners[triangle]))
        });
        deepest.max().filter(|&deepest| deepest > MOST)
    }

    /// Sorts hits on bodies along the ray and removes duplicates, because an edge is hit on both of its
    /// triangles but crossed once.
    fn in_order(&self, crossed: &mut Vec<Hit>) {
        crossed.sort_unstable_by(nearer);
        let of = |hit: &Hit| (hit.t.to_bits(), hit.back, self.part(hit.triangle).0.body);
        crossed.dedup_by_key(|hit| of(hit));
    }

    /// Transmittance of a ray that starts in `media` and crosses the surfaces of bodies. Also returns the media at
    /// the end of the ray, which is on the surface `end` or at distance `reach`. `share` computes the transmittance
    /// of each crossed surface from the media on its two sides.
    fn through(
        &self,
        mut media: Media,
        mut crossed: Vec<Hit>,
        (end, reach): (Option<&Hit>, f32),
        share: impl Fn(&Hit, [Media; 2]) -> Vec3,
    ) -> (Vec3, Media) {
        self.in_order(&mut crossed);
        let (mut light, mut depth, mut from) = (Vec3::ONE, Vec3::ZERO, 0.0);
        for hit in &crossed {
            let sides = self.sides(self.part(hit.triangle).0, hit.back, media);
            light *= share(hit, sides);
            depth += self.absorption(sides[0]) * (hit.t - from);
            (media, from) = (sides[1], hit.t);
        }
        if let Some(hit) = end {
            [media, _] = self.sides(self.part(hit.triangle).0, hit.back, media);
        }
        if reach.is_finite() {
            depth += self.absorption(media) * (reach - from);
        } else {
            media = Media::default();
        }
        let left =
            if depth == Vec3::ZERO { Vec3::ONE } else { depth.to_array().map(|d| num::f32::exp(-d)).into() };
        (light * left, media)
    }

    /// Transmittance of a ray that crosses no surface before its end, and the media at its end.
    pub fn within(&self, media: Media, end: Option<&Hit>, reach: f32) -> (Vec3, Media) {
        match self.bodies.is_empty() {
            true => (Vec3::ONE, media),
            false => self.through(media, Vec::new(), (end, reach), |_, _| Vec3::ONE),
        }
    }

    /// Transmittance of objects along a straight ray, ignoring the triangle `except`.
    pub fn transmittance(&self, ray: Ray, key: u32, except: Option<u32>, media: Media) -> Vec3 {
        let (mut light, mut crossed) = (Vec3::ONE, Vec::new());
        let blocked = self.bvh.any(ray, |hit| {
            if Some(hit.triangle) == except {
                return false;
            }
            match self.part(hit.triangle).0 {
                part if !part.clear => light *= 1.0 - self.coverage(hit, false),
                part if part.body.is_some() => crossed.extend(self.accepts(hit, key, false).then_some(*hit)),
                _ => {
                    let coverage = self.coverage(hit, false);
                    light *= 1.0 - coverage + coverage * self.straight(hit, ray.direction, None);
                }
            }
            light == Vec3::ZERO
        });
        if blocked {
            return Vec3::ZERO;
        }
        let share = |hit: &Hit, sides| self.straight(hit, ray.direction, Some(sides));
        light * self.through(media, crossed, (None, ray.t_max), share).0
    }

    /// Probability that a straight ray passes through a surface: the transmittance of the surface if it is
    /// surrounded by air.
    fn probability(&self, hit: &Hit, direction: Vec3) -> f32 {
        self.straight(hit, direction, None).max_element()
    }

    /// First surface at which a straight ray stops. The ray passes at random through surfaces that transmit light.
    pub fn closest_straight(&self, ray: Ray, key: u32) -> Option<Hit> {
        self.bvh.closest(ray, |hit| {
            self.accepts(hit, key, false)
                && unit(hash(!key, hit.triangle)) >= self.probability(hit, ray.direction)
        })
    }

    /// Weight of the radiance at the end of a straight ray, and the media there. The end is the hit that
    /// [`closest_straight`](Self::closest_straight) found, or the maximum distance of the ray.
    pub fn along_straight(&self, ray: Ray, key: u32, end: Option<&Hit>, media: Media) -> (Vec3, Media) {
        let (mut weight, mut crossed) = (Vec3::ONE, Vec::new());
        self.bvh.any(ray, |hit| {
            let mine = end.is_some_and(|end| end.triangle == hit.triangle);
            if !self.accepts(hit, key, false) || (!mine && hit.t >= ray.t_max) {
                return false;
            }
            let probability = self.probability(hit, ray.direction);
            match self.part(hit.triangle).0.body {
                _ if mine => weight /= 1.0 - probability,
                _ if probability == 0.0 => {}
                Some(_) => crossed.push(*hit),
                None => weight *= self.straight(hit, ray.direction, None) / probability,
            }
            false
        });
        let share = |hit: &Hit, sides| {
            self.straight(hit, ray.direction, Some(sides)) / self.probability(hit, ray.direction)
        };
        let (left, media) = self.through(media, crossed, (end, ray.t_max), share);
        (weight * left, media)
    }
}
