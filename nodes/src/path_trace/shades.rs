//! Where light of lamps comes through a shade or globe: places to which objects send rays of their own.
//!
//! No light sample finds what a shade lets through, and rays of all directions seldom do.

use glam::Vec3;

use super::aabb::Aabb;
use super::change::Towards;
use super::light_distribution::Cone;
use super::objects::Objects;

/// The boxes around lamps and what of translucent stuff is around or beside them; none where nothing is.
#[derive(Debug, Clone, Default)]
pub struct Shades(Vec<Aabb>);

impl Shades {
    /// Of objects: the boxes of parts that shine, each with those of translucent parts that it meets. What meets another is
    /// one with it.
    pub(super) fn of(objects: &Objects) -> Self {
        let (mut lamps, mut papers) = (Vec::new(), Vec::new());
        for (part, triangles) in objects.parts_with_triangles() {
            let finite = objects.corners[triangles].iter().flatten().filter(|p| p.is_finite());
            let around = Aabb::around(finite);
            if around.is_empty() {
                continue;
            }
            let material = objects.part(part.first).3;
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
    pub(super) fn towards(&self, place: Vec3) -> Towards {
        let seen = self.0.iter().map(|around| Cone::between([place; 2], [around.low, around.high]));
        // The first of equally large ones.
        let largest =
            seen.filter(|cone| cone.cosine > 0.0).reduce(|a, b| if b.cosine < a.cosine { b } else { a });
        largest.map_or(Towards::NOWHERE, |cone| Towards::within(cone, f32::INFINITY))
    }
}
