//! Tile of pixels: its camera hits, and the light distributions for them.

use glam::Vec3;

use super::camera_rays::CameraRays;
use crate::geometry::bvh::{Hit, Ray};
use crate::geometry::sampling::Points;
use crate::transport::path::change::rays_towards;
use crate::transport::path::guide::{FIRST_LIGHTS, Guide};
use crate::transport::path::integrator::Scene;
use crate::transport::path::path::first_pair;
use crate::transport::sky::cone::Cone;
use crate::transport::sky::environment::{Distributions, TIERS};
use crate::transport::sky::light_distribution::LightDistribution;
use crate::transport::sky::light_draws::LightDraws;

/// Cosine of the angle of the widest cone of normals for which one distribution is used.
const ALIKE: f32 = 0.99;

/// Number of light samples that each sample of a pixel takes to estimate the change, if objects can block all
/// light. If they can block only a part of the light, the number is reduced in proportion. The result is then
/// limited to the number of light samples that the sky prescribes.
const SAMPLES_WHERE_ALL_IS_HIDDEN: f64 = 40.0;
/// Minimum probability that a sample estimates the change.
const LEAST_PROBABILITY: f32 = 0.5;

/// One sample of one pixel.
pub struct Sample {
    pub(crate) points: Points,
    pub(crate) key: u32,
    pub(crate) ray: Ray,
    /// The surface of the receiver that the ray hits.
    pub hit: Option<Hit>,
}

/// Samples of a tile, and a cone that contains the normals at their hits.
pub struct Tile<'a> {
    scene: Scene<'a>,
    /// The samples, pixel by pixel.
    pub samples: Vec<Sample>,
    /// Guide of light samples.
    pub(crate) guide: Option<&'a Guide>,
    /// Cone that contains the normals at all hits. `None` if the normals are not similar.
    normals: Option<Cone>,
}

/// Parameters for sampling the change due to objects in a tile.
pub(crate) struct TileSampling {
    /// Distributions of the part of the sky that the objects can block.
    pub(crate) distributions: [LightDistribution; TIERS],
    /// Number of light samples per tier, each a power of 2.
    pub(crate) lights: [u32; TIERS],
    /// Probability that a sample estimates the change.
    pub(crate) probability: f32,
}

impl<'a> Tile<'a> {
    /// Casts the camera rays of the tile, pixel by pixel.
    pub fn new(
        scene: Scene<'a>,
        camera_rays: &'a CameraRays<'_>,
        pixels: &[(u32, u32)],
        range: (u32, u32),
    ) -> Self {
        let mut samples = Vec::with_capacity(pixels.len() * (range.1 - range.0) as usize);
        samples.extend(pixels.iter().flat_map(|&pixel| (range.0..range.1).map(move |n| (pixel, n))).map(
            |(pixel, number)| {
                let (points, key, ray) = camera_rays.sample(pixel, number);
                Sample { points, key, ray, hit: scene.camera_hit(ray) }
            },
        ));
        let facing = |s: &Sample| s.hit.map(|hit| scene.receiver.facing(&hit));
        let landed = samples.iter().any(|s| s.hit.is_some());
        let normals = landed.then(|| Cone::around(samples.iter().filter_map(facing)));
        let guide = camera_rays.guide();
        Self { scene, samples, guide, normals: normals.filter(|cone| cone.cosine > ALIKE) }
    }

    /// Light distributions of the tile. `None` unless one distribution serves all of its normals. With a guide, each
    /// point has its own.
    pub(crate) fn distributions(&self) -> Option<[LightDistribution; TIERS]> {
        self.normals
            .filter(|_| self.guide.is_none())
            .map(|cone| self.scene.sky.distributions_within(Some(cone), &Cone::ALL))
    }

    /// Light samples of the first vertices. `vertices` contains the points and the hit of each sample, or `None` for a
    /// sample without light samples. `distributions` contains those of the tile, if it has any, and `lights` the
    /// number of samples per tier. If `lights` is `None`, the samples are those of the receiver alone.
    pub(crate) fn first_draws<'b>(
        &self,
        distributions: Option<Distributions<'b>>,
        lights: Option<[u32; TIERS]>,
        vertices: impl Iterator<Item = Option<(Points, Hit)>>,
    ) -> LightDraws<'b, impl Iterator<Item = Option<(Points, Distributions<'b>)>>>
    where
        'a: 'b,
    {
        let (scene, guide) = (self.scene, self.guide);
        let vertices = vertices.map(move |vertex| {
            let (points, hit) = vertex?;
            let usual = || {
                let normal = scene.receiver.facing(&hit);
                match guide {
                    Some(guide) => guide.distributions(scene.sky, scene.receiver.start(&hit), normal),
                    None => scene.sky.distributions(Some(normal)),
                }
            };
            Some((points, distributions.unwrap_or_else(usual)))
        });
        if guide.is_some() && lights.is_none() {
            LightDraws::mixed(scene.sky, FIRST_LIGHTS, first_pair(0), vertices)
        } else {
            LightDraws::new(scene.sky, lights.unwrap_or(scene.sky.lights), first_pair(0), vertices)
        }
    }

    /// Parameters for sampling the change, given the origins of rays to objects. `None` if the objects may be in
    /// any direction. Light is then sampled as without objects, with the same random numbers.
    ///
    /// The effort depends on the share of the light that objects can block, which is an upper bound of the change
    /// and small in most of an image.
    pub(crate) fn change_sampling(&self, starts: impl Iterator<Item = Vec3>) -> Option<TileSampling> {
        let objects = self.scene.objects.bvh.bounds().map(<[Vec3; 2]>::from)?;
        let (low, high) = starts.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)))?;
        let cone = Cone::between([low, high], objects);
        if cone == Cone::ALL {
            return None;
        }
        let sky = self.scene.sky;
        let distributions = sky.distributions_within(self.normals, &cone);
        let Some(normals) = self.normals else {
            return Some(TileSampling { distributions, lights: sky.lights, probability: 1.0 });
        };
        let all: f64 =
            sky.distributions(Some(normals.axis)).iter().map(|distribution| distribution.power).sum();
        // Standard deviation of one light sample as a share of all light: cells contain light outside the cone.
        let solid_angle = f64::from(cone.solid_angle());
        let deviation = |distribution: &LightDistribution| {
            distribution.power / all * (solid_angle / distribution.area).min(1.0).sqrt()
        };
        let wanted = distributions.each_ref().map(|distribution| {
            if distribution.power > 0.0 { SAMPLES_WHERE_ALL_IS_HIDDEN * deviation(distribution) } else { 0.0 }
        });
        let lights = std::array::from_fn(|k| match wanted[k] {
            ..2.0 => 1,
            ..4.0 => sky.lights[k].min(2),
            _ => sky.lights[k],
        });
        // Share of scattered rays that can hit the objects. It is larger if the objects emit light.
        let rays = f64::from(rays_towards(&self.scene));
        let scattered = SAMPLES_WHERE_ALL_IS_HIDDEN * solid_angle / std::f64::consts::PI * rays;
        let most = wanted.into_iter().fold(scattered, f64::max);
        Some(TileSampling { distributions, lights, probability: (most as f32).clamp(LEAST_PROBABILITY, 1.0) })
    }
}
