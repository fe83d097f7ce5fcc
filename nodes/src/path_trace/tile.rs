//! A tile of pixels: where the camera's rays land, and where its points look for light.

use glam::Vec3;

use super::aim::{Aim, Cone};
use super::lens::Lens;
use super::light::{Look, TIERS};
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
    /// Where to look for light, if the points face alike.
    aims: Option<[Aim; TIERS]>,
    normals: Option<Cone>,
}

impl<'a> Tile<'a> {
    /// Casts the rays of the camera: for each pixel in turn its samples.
    pub(super) fn new(world: World<'a>, lens: &Lens<'_>, pixels: &[(u32, u32)], range: (u32, u32)) -> Self {
        let numbered = pixels.iter().flat_map(|&pixel| (range.0..range.1).map(move |sample| (pixel, sample)));
        let samples: Vec<Sample> = numbered
            .map(|(pixel, sample)| {
                let (points, key, ray) = lens.sample(pixel, sample);
                Sample { points, key, ray, hit: world.landing(ray) }
            })
            .collect();
        let facing = |s: &Sample| {
            let hit = s.hit?;
            let normal = world.receiver.normal(hit.triangle);
            Some(if hit.back { -normal } else { normal })
        };
        let landed = samples.iter().any(|s| s.hit.is_some());
        let normals = landed.then(|| Cone::around(samples.iter().filter_map(facing)));
        let normals = normals.filter(|cone| cone.cosine > ALIKE);
        let aims = normals.map(|cone| world.sky.aims(Some(cone), &Cone::ALL));
        Self { world, samples, aims, normals }
    }

    /// Where its points look for light, if not by the normal of each.
    pub(super) fn look(&self) -> Option<Look<'_>> {
        self.aims.as_ref().map(|aims| aims.each_ref())
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
