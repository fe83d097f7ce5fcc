//! The receiver as the light that the panorama shows of it.
//!
//! A panorama holds the light that arrives where it was taken. Taken as infinitely far it lights every point
//! alike, but a lamp on a wall two metres away stands in another direction, and nearer, for a point one metre
//! aside. Here every surface of the receiver that the point of capture sees is a matte lamp, whose radiance
//! the panorama shows in its direction. Surfaces that it does not see are lit and scatter, and rays that leave
//! find the panorama as infinitely far. Each light counts once, indoors and in the open.
//!
//! A light sample is a direction at the point of capture, and with it a place of the receiver; per steradian
//! of another point its density changes by the ratio of the solid angles under which the two see the place.
//! Scattered rays find the same places and ask for the same density, so the two can be weighed.

use glam::Vec3;

use crate::geometry::bvh::{Hit, Ray};
use crate::math::color::luminance;
use crate::render::transport::scene::receiver::Receiver;
use crate::render::transport::sky::environment::{EnvironmentLight, LightSample};

/// Surfaces nearer to each other than this share of their distance are one: a captured mesh is no better than
/// that, and where a lamp lies on its wall within the mesh's error either may be in front.
const SAME: f32 = 0.01;
/// A place that the receiver hides from the point of capture by no more than this share of its distance
/// counts as seen, unless it would be a lamp, which light samples would not find: so much a mesh is in its own way.
const NEARLY: f32 = 0.05;

/// The light of a place, seen from where its panorama was taken.
#[derive(Debug, Clone, Copy)]
pub struct NearFieldLight<'a> {
    /// The place.
    pub receiver: &'a Receiver,
    /// Its panorama.
    pub sky: &'a EnvironmentLight,
    /// The point of capture.
    pub eye: Vec3,
}

/// A point of the receiver that shines.
#[derive(Debug, Clone, Copy)]
pub struct EmissivePoint {
    /// Where.
    pub position: Vec3,
    /// Unit normal on the side of the point of capture.
    pub normal: Vec3,
    /// How far rays must start off it.
    pub margin: f32,
    triangle: u32,
}

/// A light that a point sees: what comes, from which direction, and the place where it is; none for the sky.
pub type ArrivingLight = (LightSample, Option<EmissivePoint>);

impl<'a> NearFieldLight<'a> {
    fn place(&self, hit: &Hit) -> EmissivePoint {
        let surface = self.receiver.surface(hit);
        let towards = (self.eye - surface.position).dot(surface.normal);
        let normal = if towards < 0.0 { -surface.normal } else { surface.normal };
        EmissivePoint { position: surface.position, normal, margin: surface.margin, triangle: hit.triangle }
    }

    /// The solid angle of a piece of a place from the point of capture, as a share of the one from `point`; 0
    /// where the two do not see the same side of it.
    fn spread(&self, place: &EmissivePoint, point: Vec3) -> f32 {
        let [eye, other] = [self.eye, point].map(|from| {
            let way = from - place.position;
            let square = way.length_squared();
            // The cosine over the square of the distance.
            way.dot(place.normal) / (square * square.sqrt())
        });
        let spread = eye / other;
        if other > 0.0 && spread.is_finite() { spread.max(0.0) } else { 0.0 }
    }

    /// A light sample for a point whose light comes from one side, or from all. Takes one ray. The light is
    /// black where the point does not see the right side of the place; what else stands in the way is
    /// [`reaches`](Self::reaches)'s to tell. None where no light comes from that side.
    pub fn sample(&self, point: Vec3, side: Option<Vec3>, bits: [u32; 2]) -> Option<ArrivingLight> {
        let light = self.sky.sample_defensive(side, bits)?;
        let Some(hit) = self.receiver.bvh.closest(Ray::new(self.eye, light.direction), |_| true) else {
            return Some((light, None));
        };
        let place = self.place(&hit);
        let pdf = light.pdf * self.spread(&place, point);
        let direction = (place.position - point).normalize_or_zero();
        let radiance = if pdf > 0.0 && pdf.is_finite() { light.radiance } else { Vec3::ZERO };
        Some((LightSample { direction, radiance, pdf }, Some(place)))
    }

    /// The part of a ray that lies before a light.
    pub fn towards(ray: Ray, place: Option<&EmissivePoint>) -> Ray {
        Self::up_to(ray, place.map_or(f32::INFINITY, |p| (p.position - ray.origin).length()))
    }

    /// The same for a light so far away.
    pub fn up_to(ray: Ray, distance: f32) -> Ray {
        Ray { t_max: distance * (1.0 - SAME), ..ray }
    }

    /// Whether nothing of the receiver stands before the end of a ray that leads to a light.
    pub fn reaches(&self, ray: Ray, place: Option<&EmissivePoint>) -> bool {
        let own = place.map(|p| p.triangle);
        !self.receiver.bvh.any(ray, |hit| Some(hit.triangle) != own)
    }

    /// The light that a ray finds which meets the receiver at `hit`, or nothing, and the density of
    /// [`sample`](Self::sample) for the start of the ray. None where the point of capture does not see the
    /// hit. `glossy_pdf` is the density of the ray if a glossy lobe scattered it, else 0: see [`EnvironmentLight::seen`].
    /// Takes one ray.
    pub fn eval(
        &self,
        ray: Ray,
        side: Option<Vec3>,
        hit: Option<&Hit>,
        glossy_pdf: f32,
    ) -> Option<ArrivingLight> {
        let towards = |direction| self.sky.seen(self.sky.eval_defensive(side, direction), glossy_pdf);
        let Some(hit) = hit else {
            let light = towards(ray.direction);
            // What is sky from here may lie behind a wall from there.
            let open = !self.receiver.bvh.any(Ray::new(self.eye, ray.direction), |_| true);
            return Some((LightSample { pdf: if open { light.pdf } else { 0.0 }, ..light }, None));
        };
        let place = self.place(hit);
        let way = place.position - self.eye;
        let distance = way.length();
        let spread = self.spread(&place, ray.origin);
        if spread == 0.0 {
            return None;
        }
        let light = towards(way / distance);
        let first = self.receiver.bvh.closest(Ray::new(self.eye, way / distance), |_| true);
        let gap = first.map_or(0.0, |first| distance - first.t) / distance;
        let same = first.is_some_and(|first| first.triangle == hit.triangle || gap.abs() <= SAME);
        let pdf = if same { light.pdf * spread } else { 0.0 };
        let seen = same || (gap <= NEARLY && !self.is_lamp(light.radiance));
        seen.then_some((LightSample { direction: ray.direction, pdf, ..light }, Some(place)))
    }

    /// Whether a light is too bright to be light that a surface reflects: brighter than a white wall which all
    /// light of the panorama falls on at once. What stands before a wall dims it, but not a lamp.
    pub fn is_lamp(&self, radiance: Vec3) -> bool {
        luminance(radiance.to_array())
            > luminance(self.sky.power.map(|p| p as f32)) * std::f32::consts::FRAC_1_PI
    }
}
