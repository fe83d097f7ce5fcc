//! Where light of lamps comes through a shade or globe: places to which objects send rays of their own.
//!
//! No light sample finds what a shade lets through, and rays of all directions seldom do.

use glam::Vec3;

use super::change::Towards;
use super::light_distribution::Cone;
use super::objects::Objects;

/// The boxes around lamps and what of translucent stuff is around or beside them; none where nothing is.
#[derive(Debug, Clone, Default)]
pub struct Shades(Vec<[Vec3; 2]>);

fn meet([a, b]: &[Vec3; 2], [c, d]: &[Vec3; 2]) -> bool {
    a.cmple(*d).all() && c.cmple(*b).all()
}

impl Shades {
    /// Of objects: the boxes of parts that shine, each with those of translucent parts that it meets. What meets another is
    /// one with it.
    pub(super) fn of(objects: &Objects) -> Self {
        let (mut lamps, mut papers) = (Vec::new(), Vec::new());
        for (part, triangles) in objects.parts_with_triangles() {
            let finite = objects.corners[triangles].iter().flatten().filter(|p| p.is_finite());
            let around = finite.map(|&p| [p, p]).reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]);
            let Some(around) = around else { continue };
            let material = objects.part(part.first).3;
            if material.shines() {
                lamps.push(around);
            } else if material.diffuse_transmission.strength.factor > 0.0 {
                papers.push(around);
            }
        }
        let mut boxes: Vec<[Vec3; 2]> = Vec::new();
        for paper in papers.iter().filter(|paper| lamps.iter().any(|lamp| meet(lamp, paper))) {
            let all = lamps.iter().filter(|lamp| meet(lamp, paper)).chain([paper]);
            let mut whole = all.copied().reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]).unwrap_or(*paper);
            while let Some(at) = boxes.iter().position(|known| meet(known, &whole)) {
                let [low, high] = boxes.swap_remove(at);
                whole = [whole[0].min(low), whole[1].max(high)];
            }
            boxes.push(whole);
        }
        Self(boxes)
    }

    /// Rays from a place to the box that looks largest from there; none from within one.
    pub(super) fn towards(&self, place: Vec3) -> Towards {
        let seen = self.0.iter().map(|around| Cone::between([place; 2], *around));
        // The first of equally large ones.
        let largest =
            seen.filter(|cone| cone.cosine > 0.0).reduce(|a, b| if b.cosine < a.cosine { b } else { a });
        largest.map_or(Towards::NOWHERE, |cone| Towards::within(cone, f32::INFINITY))
    }
}
