//! A tile of pixels: where the camera's rays land, and where its points look for light.

use glam::Vec3;

use super::aim::{Aim, Cone};
use super::lens::Lens;
use super::light::TIERS;
use super::walk::World;
use crate::bvh::{Hit, Ray};
use crate::sampling::Points;

/// Cosine of the widest cone of normals that one aim serves.
const ALIKE: f32 = 0.99;

/// Light samples, and samples at all, for what the objects change where they can hide all light; in proportion
/// where they can hide less.
const STAKES: f64 = 40.0;
/// Odds of a sample where next to nothing is at stake.
const LEAST: f32 = 0.5;

/// One sample of one pixel.
pub(super) struct Sample {
    pub(super) points: Points,
    pub(super) key: u32,
    pub(super) ray: Ray,
    pub(super) hit: Option<Hit>,
}

/// The samples of a tile, and the sky as its points see it.
pub(super) struct Tile<'a> {
    world: World<'a>,
    pub(super) samples: Vec<Sample>,
    /// The normals of its points, if they face alike.
    normals: Option<Cone>,
}

/// Where the points of a tile look for what the objects change, and how hard.
pub(super) struct Stakes {
    /// The part of the sky that they can hide.
    pub(super) aims: [Aim; TIERS],
    /// Light samples of each tier, powers of 2.
    pub(super) lights: [u32; TIERS],
    /// Odds that a sample asks at all.
    pub(super) odds: f32,
}

impl<'a> Tile<'a> {
    /// Casts the rays of the camera: for each pixel in turn its samples.
    pub(super) fn new(world: World<'a>, lens: &Lens<'_>, pixels: &[(u32, u32)], range: (u32, u32)) -> Self {
        let mut samples = Vec::with_capacity(pixels.len() * (range.1 - range.0) as usize);
        samples.extend(pixels.iter().flat_map(|&pixel| (range.0..range.1).map(move |n| (pixel, n))).map(
            |(pixel, number)| {
                let (points, key, ray) = lens.sample(pixel, number);
                Sample { points, key, ray, hit: world.landing(ray) }
            },
        ));
        let facing = |s: &Sample| s.hit.map(|hit| world.receiver.facing(&hit));
        let landed = samples.iter().any(|s| s.hit.is_some());
        let normals = landed.then(|| Cone::around(samples.iter().filter_map(facing)));
        Self { world, samples, normals: normals.filter(|cone| cone.cosine > ALIKE) }
    }

    /// Where its points look for light, if not by the normal of each.
    pub(super) fn aims(&self) -> Option<[Aim; TIERS]> {
        self.normals.map(|cone| self.world.sky.aims(Some(cone), &Cone::ALL))
    }

    /// Where its points look for what the objects change, by where rays to these start; none where that is
    /// anywhere, so that light is looked for as without them and by the same random numbers.
    ///
    /// How hard follows from the share of their light that the objects can hide, which bounds what they take: in
    /// most of a picture that is little, and what is seldom asked there is not missed.
    pub(super) fn stakes(&self, starts: impl Iterator<Item = Vec3>) -> Option<Stakes> {
        let objects = self.world.objects.bvh.bounds().map(<[Vec3; 2]>::from)?;
        let (low, high) = starts.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)))?;
        let cone = Cone::between([low, high], objects);
        if cone == Cone::ALL {
            return None;
        }
        let sky = self.world.sky;
        let aims = sky.aims(self.normals, &cone);
        let Some(normals) = self.normals else {
            return Some(Stakes { aims, lights: sky.lights, odds: 1.0 });
        };
        let all: f64 = sky.look(Some(normals.axis)).iter().map(|aim| aim.power).sum();
        // The deviation of one light sample, as a share of all light: cells hold light beside the cone.
        let solid_angle = f64::from(cone.solid_angle());
        let deviation = |aim: &Aim| aim.power / all * (solid_angle / aim.area).min(1.0).sqrt();
        let wanted = aims.each_ref().map(|aim| if aim.power > 0.0 { STAKES * deviation(aim) } else { 0.0 });
        let lights = std::array::from_fn(|k| match wanted[k] {
            ..2.0 => 1,
            ..4.0 => sky.lights[k].min(2),
            _ => sky.lights[k],
        });
        // What scattered rays find: the share of them that can meet the objects.
        let scattered = STAKES * solid_angle / std::f64::consts::PI;
        let most = wanted.into_iter().fold(scattered, f64::max);
        Some(Stakes { aims, lights, odds: (most as f32).clamp(LEAST, 1.0) })
    }
}
