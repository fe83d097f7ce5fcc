//! Where light of lamps comes through a shade or globe: places to which objects send rays of their own.
//!
//! No light sample finds what a shade lets through, and rays of all directions seldom do.

use glam::Vec3;

use super::aabb::Aabb;
use crate::render::transport::sky::cone::Cone;
use crate::render::transport::sky::cone::Towards;
use crate::types::Material;

/// The boxes around lamps and what of translucent stuff is around or beside them; none where nothing is.
#[derive(Debug, Clone, Default)]
pub struct Shades(Vec<Aabb>);

impl Shades {
    /// Of objects: the boxes of parts that shine, each with those of translucent parts that it meets. What meets another is
    /// one with it.
    pub(crate) fn of<'a>(parts: impl Iterator<Item = (Aabb, &'a Material)>) -> Self {
        let (mut lamps, mut papers) = (Vec::new(), Vec::new());
        for (around, material) in parts.filter(|(around, _)| !around.is_empty()) {
            if material.shines() {
                lamps.push(around);
            } else if material.diffuse_transmission.strength.factor > 0.0 {
                papers.push(around);
            }
        }
        let mut boxes: Vec<Aabb> = Vec::new();
        for paper in papers.iter().filter(|paper| lamps.iter().any(|lamp| lamp.meets(paper))) {
            let mut whole = lamps.iter().filter(|lamp| lamp.meets(paper)).fold(*paper, |a, b| a.joined(*b));
            while let Some(at) = boxes.iter().position(|known| known.meets(&whole)) {
                whole = whole.joined(boxes.swap_remove(at));
            }
            boxes.push(whole);
        }
        Self(boxes)
    }

    /// Rays from a place to the box that looks largest from there; none from within one.
    pub(crate) fn towards(&self, place: Vec3) -> Towards {
        let seen = self.0.iter().map(|around| Cone::between([place; 2], [around.low, around.high]));
        // The first of equally large ones.
        let largest =
            seen.filter(|cone| cone.cosine > 0.0).reduce(|a, b| if b.cosine < a.cosine { b } else { a });
        largest.map_or(Towards::NOWHERE, |cone| Towards::within(cone, f32::INFINITY))
    }
}
