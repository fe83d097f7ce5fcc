//! A tile of pixels: where the camera's rays land, and where its points look for light.

use glam::Vec3;

use super::camera_rays::CameraRays;
use crate::geometry::bvh::{Hit, Ray};
use crate::geometry::sampling::Points;
use crate::render::transport::path::change::rays_towards;
use crate::render::transport::path::integrator::Scene;
use crate::render::transport::sky::cone::Cone;
use crate::render::transport::sky::environment::TIERS;
use crate::render::transport::sky::light_distribution::LightDistribution;

/// Cosine of the widest cone of normals that one distribution serves.
const ALIKE: f32 = 0.99;

/// Light samples, and samples at all, for what the objects change where they can hide all light; in proportion
/// where they can hide less.
const SAMPLES_WHERE_ALL_IS_HIDDEN: f64 = 40.0;
/// Probability of a sample where next to nothing is at stake.
const LEAST_PROBABILITY: f32 = 0.5;

/// One sample of one pixel.
pub(crate) struct Sample {
    pub(crate) points: Points,
    pub(crate) key: u32,
    pub(crate) ray: Ray,
    pub(crate) hit: Option<Hit>,
}

/// The samples of a tile, and the sky as its points see it.
pub(crate) struct Tile<'a> {
    scene: Scene<'a>,
    pub(crate) samples: Vec<Sample>,
    /// The normals of its points, if they face alike.
    normals: Option<Cone>,
}

/// Where the points of a tile look for what the objects change, and how hard.
pub(crate) struct TileSampling {
    /// The part of the sky that they can hide.
    pub(crate) distributions: [LightDistribution; TIERS],
    /// Light samples of each tier, powers of 2.
    pub(crate) lights: [u32; TIERS],
    /// Probability that a sample asks at all.
    pub(crate) probability: f32,
}

impl<'a> Tile<'a> {
    /// Casts the rays of the camera: for each pixel in turn its samples.
    pub(crate) fn new(
        scene: Scene<'a>,
        camera_rays: &CameraRays<'_>,
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
        Self { scene, samples, normals: normals.filter(|cone| cone.cosine > ALIKE) }
    }

    /// Where its points look for light, if not by the normal of each.
    pub(crate) fn distributions(&self) -> Option<[LightDistribution; TIERS]> {
        self.normals.map(|cone| self.scene.sky.distributions_within(Some(cone), &Cone::ALL))
    }

    /// Where its points look for what the objects change, by where rays to these start; none where that is
    /// anywhere, so that light is looked for as without them and by the same random numbers.
    ///
    /// How hard follows from the share of their light that the objects can hide, which bounds what they take: in
    /// most of a picture that is little, and what is seldom asked there is not missed.
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
        // The deviation of one light sample, as a share of all light: cells hold light beside the cone.
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
        // What scattered rays find: the share of them that can meet the objects, the more where these shine.
        let rays = f64::from(rays_towards(&self.scene));
        let scattered = SAMPLES_WHERE_ALL_IS_HIDDEN * solid_angle / std::f64::consts::PI * rays;
        let most = wanted.into_iter().fold(scattered, f64::max);
        Some(TileSampling { distributions, lights, probability: (most as f32).clamp(LEAST_PROBABILITY, 1.0) })
    }
}
