//! Lampshades: translucent surfaces around emitters, towards which surfaces of objects send additional rays.
//!
//! Light samples of an emitter never find the light that a shade transmits, and cosine-distributed rays seldom do.

use glam::Vec3;
use scene::types::Material;

use super::aabb::Aabb;
use crate::transport::sky::cone::Cone;
use crate::transport::sky::cone::Towards;

/// Bounding boxes of emitters with the translucent surfaces around them; empty if there are no shades.
#[derive(Debug, Clone, Default)]
pub struct Shades(Vec<Aabb>);

impl Shades {
    /// Computes the boxes of emissive primitives, each joined with the boxes of translucent primitives that
    /// it overlaps. Boxes that overlap are joined.
    pub(crate) fn of<'a>(parts: impl Iterator<Item = (Aabb, &'a Material)>) -> Self {
        let (mut lamps, mut translucent) = (Vec::new(), Vec::new());
        for (around, material) in parts.filter(|(around, _)| !around.is_empty()) {
            if material.shines() {
                lamps.push(around);
            } else if material.diffuse_transmission.strength.factor > 0.0 {
                translucent.push(around);
            }
        }
        let mut boxes: Vec<Aabb> = Vec::new();
        for shade in translucent.iter().filter(|shade| lamps.iter().any(|lamp| lamp.meets(shade))) {
            let mut whole = lamps.iter().filter(|lamp| lamp.meets(shade)).fold(*shade, |a, b| a.joined(*b));
            while let Some(at) = boxes.iter().position(|known| known.meets(&whole)) {
                whole = whole.joined(boxes.swap_remove(at));
            }
            boxes.push(whole);
        }
        Self(boxes)
    }

    /// Sampling of rays from a point to the box that subtends the largest cone. Boxes that contain the point are
    /// ignored.
    pub(crate) fn towards(&self, place: Vec3) -> Towards {
        let seen = self.0.iter().map(|around| Cone::between([place; 2], [around.low, around.high]));
        // The first one if several are equal.
        let largest =
            seen.filter(|cone| cone.cosine > 0.0).reduce(|a, b| if b.cosine < a.cosine { b } else { a });
        largest.map_or(Towards::NOWHERE, |cone| Towards::within(cone, f32::INFINITY))
    }
}
