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
    pub(super) fn towards(&self, starts: impl Iterator<Item = Vec3>) -> Option<[Aim; TIERS]> {
        let objects = self.world.objects.bvh.bounds().map(<[Vec3; 2]>::from)?;
        let (low, high) = starts.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)))?;
        let cone = Cone::between([low, high], objects);
        (cone != Cone::ALL).then(|| self.world.sky.aims(self.normals, &cone))
    }
}
