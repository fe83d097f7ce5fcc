//! Near light: the panorama is projected from its point of capture onto the receiver, which emits it.
//!
//! A panorama contains the light that arrives at one point. A panorama at infinity lights every point alike. But
//! for a point one metre to the side, a lamp on a wall two metres away is in another direction and at another
//! distance. Therefore every receiver surface that is visible from the point of capture is a matte emitter, with
//! the radiance that the panorama shows in its direction. Surfaces that are not visible from the point of capture
//! receive and scatter light, and rays that leave the scene end in the panorama at infinity. In this way each light
//! is counted once, indoors and outdoors.
//!
//! A light sample is a direction from the point of capture, and thus a point of the receiver. As seen from the lit
//! point, its density per steradian changes: it is multiplied by the ratio of the solid angles that the surface
//! around the receiver point subtends at the point of capture and at the lit point. Scattered rays find the same
//! points with a known density, so the two strategies can be weighted.

use glam::Vec3;
use scene::math::color::luminance;

use crate::geometry::bvh::{Hit, Ray};
use crate::transport::scene::receiver::Receiver;
use crate::transport::sky::defensive::{DefensiveSampling, NearLights};
use crate::transport::sky::environment::{EnvironmentLight, LightSample};

/// Relative distance below which two surfaces count as one. A captured mesh is not more accurate than this: where a
/// lamp lies on a wall, either surface may be in front.
const SAME: f32 = 0.01;
/// Maximum depth of a point behind the first surface, relative to its distance, at which it still counts as visible
/// from the point of capture. A captured mesh can cover parts of itself. This tolerance is not used for points that
/// are as bright as lamps, because light samples would not find them.
const NEARLY: f32 = 0.05;

/// Near light: the receiver emits the light of the panorama.
#[derive(Debug, Clone, Copy)]
pub struct NearFieldLight<'a> {
    /// The receiver.
    pub receiver: &'a Receiver,
    /// The panorama.
    pub sky: &'a EnvironmentLight,
    /// The point of capture.
    pub eye: Vec3,
}

/// Emitting point of the receiver.
#[derive(Debug, Clone, Copy)]
pub struct EmissivePoint {
    /// Position.
    pub position: Vec3,
    /// Unit normal on the side of the point of capture.
    pub normal: Vec3,
    /// Offset of the origin of rays that leave the point.
    pub margin: f32,
    /// Triangle of the receiver.
    pub(super) triangle: u32,
}

/// Light that arrives at a point: direction and radiance, and the emitting point, which is `None` for the
/// sky.
pub type ArrivingLight = (LightSample, Option<EmissivePoint>);

impl<'a> NearFieldLight<'a> {
    fn place(&self, hit: &Hit) -> EmissivePoint {
        let (position, normal, margin) = self.receiver.geometry(hit);
        let towards = (self.eye - position).dot(normal);
        let normal = if towards < 0.0 { -normal } else { normal };
        EmissivePoint { position, normal, margin, triangle: hit.triangle }
    }

    /// Light samples for surfaces that are lit from one side, or from all directions if `side` is `None`.
    pub fn samples(&self, side: Option<Vec3>, lights: NearLights) -> DefensiveSampling<'a> {
        DefensiveSampling::new(self.sky, side, lights)
    }

    /// Numbers of light samples at a vertex. The first vertex of a path takes several.
    pub fn lights(&self, is_first: bool) -> NearLights {
        if is_first { NearLights::Tiers(self.sky.near_lights) } else { NearLights::One }
    }

    /// Ratio of the solid angles that a surface element subtends at the point of capture and at `point`. 0 if these
    /// two points are on different sides of the surface.
    fn spread(&self, place: &EmissivePoint, point: Vec3) -> f32 {
        let [eye, other] = [self.eye, point].map(|from| {
            let way = from - place.position;
            let square = way.length_squared();
            // The cosine over the squared distance.
            way.dot(place.normal) / (square * square.sqrt())
        });
        let spread = eye / other;
        if other > 0.0 && spread.is_finite() { spread.max(0.0) } else { 0.0 }
    }

    /// Light that arrives at `point` from the emitting point that lies in the direction of a light sample as seen
    /// from the point of capture. Traces one ray. The radiance is 0 if the point sees the wrong side of the
    /// emitter; other occlusion is tested by [`reaches`](Self::reaches).
    pub fn arriving(&self, point: Vec3, light: LightSample) -> ArrivingLight {
        let Some(hit) = self.receiver.bvh.closest(Ray::new(self.eye, light.direction), |_| true) else {
            return (light, None);
        };
        let place = self.place(&hit);
        let pdf = light.pdf * self.spread(&place, point);
        let direction = (place.position - point).normalize_or_zero();
        let radiance = if pdf > 0.0 && pdf.is_finite() { light.radiance } else { Vec3::ZERO };
        (LightSample { direction, radiance, pdf }, Some(place))
    }

    /// Ray shortened so that it ends just before a light.
    pub fn towards(ray: Ray, place: Option<&EmissivePoint>) -> Ray {
        Self::up_to(ray, place.map_or(f32::INFINITY, |p| (p.position - ray.origin).length()))
    }

    /// Ray shortened so that it ends just before the given distance.
    pub fn up_to(ray: Ray, distance: f32) -> Ray {
        Ray { t_max: distance * (1.0 - SAME), ..ray }
    }

    /// True if the receiver does not block the ray. The ray must end just before the light at `place`.
    pub fn reaches(&self, ray: Ray, place: Option<&EmissivePoint>) -> bool {
        let own = place.map(|p| p.triangle);
        !self.receiver.bvh.any(ray, |hit| Some(hit.triangle) != own)
    }

    /// Light along a ray that hits the receiver at `hit`, or misses the receiver if `hit` is `None`. The density of
    /// the result is the density with which light samples choose this light for the origin of the ray.
    /// `None` if the hit is not visible from the point of capture. `glossy_pdf` is the density of the ray if a
    /// glossy lobe scattered it, otherwise 0; see [`EnvironmentLight::seen`]. Traces one ray.
    pub fn eval(
        &self,
        ray: Ray,
        samples: &DefensiveSampling<'_>,
        hit: Option<&Hit>,
        glossy_pdf: f32,
    ) -> Option<ArrivingLight> {
        let towards = |direction| {
            let light = samples.light(direction, &self.sky.texel(direction));
            self.sky.seen(light, glossy_pdf)
        };
        let Some(hit) = hit else {
            let light = towards(ray.direction);
            // As seen from the point of capture, the sky in this direction may be behind a wall.
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

    /// True if the radiance is too high for reflected light, that is, above the radiance of a white wall that
    /// receives all light of the panorama. Objects in front of a wall attenuate the light that the wall reflects,
    /// but not the light of a lamp.
    pub fn is_lamp(&self, radiance: Vec3) -> bool {
        luminance(radiance.to_array())
            > luminance(self.sky.power.map(|p| p as f32)) * std::f32::consts::FRAC_1_PI
    }
}
