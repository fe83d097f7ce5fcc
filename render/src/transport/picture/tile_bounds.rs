//! Bounds for a tile of pixels: of the visible receiver points, and of their light without objects.

use glam::Vec3;

use crate::geometry::bvh::Hit;
use crate::transport::scene::receiver::Receiver;
use crate::transport::sky::cone::Cone;

/// Bounds for a tile of pixels: of the visible receiver points, and of their light without objects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileBounds {
    /// Lower corner of the bounding box of the ray origins. The box is inverted if the camera sees no
    /// receiver.
    pub low: Vec3,
    /// Upper corner of the bounding box of the ray origins.
    pub high: Vec3,
    /// Cone that contains the normals of the points.
    pub normals: Cone,
    /// Minimum height of the points along the axis of the normals.
    pub height: f32,
    /// Minimum over the pixels, per channel, of the light divided by the albedo.
    pub least: Vec3,
}

impl Default for TileBounds {
    /// Bounds of a tile that shows no receiver.
    fn default() -> Self {
        let normals = Cone { axis: Vec3::Z, cosine: 1.0 };
        Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY, normals, height: f32::MAX, least: Vec3::MAX }
    }
}

impl TileBounds {
    /// Computes the bounds of a tile from the light of each pixel, summed over its samples, and from the receiver
    /// hits of these samples.
    pub fn of<'a>(
        receiver: &Receiver,
        pixels: impl Iterator<Item = (Vec3, &'a [Option<Hit>])> + Clone,
    ) -> Self {
        let normals =
            pixels.clone().flat_map(|(_, hits)| hits.iter().flatten()).map(|hit| receiver.facing(hit));
        let mut tile = Self::default();
        let Some(first) = normals.clone().next() else { return tile };
        tile.normals = match normals.clone().all(|normal| normal == first) {
            true => Cone { axis: first, cosine: 1.0 },
            false => Cone::around(normals),
        };
        let axis = tile.normals.axis.as_dvec3();
        for (light, hits) in pixels {
            let mut albedo = Vec3::ZERO;
            for hit in hits.iter().flatten() {
                let start = receiver.start(hit);
                (tile.low, tile.high) = (tile.low.min(start), tile.high.max(start));
                tile.height = tile.height.min(start.as_dvec3().dot(axis) as f32);
                albedo += receiver.albedo_at(hit);
            }
            // A black surface does not change.
            let share = Vec3::select(albedo.cmpgt(Vec3::ZERO), light / albedo, Vec3::MAX);
            tile.least = tile.least.min(share);
        }
        tile
    }

    /// Number of stored values: the corners of the box, the cone of normals, the height and the light.
    pub const VALUES: usize = 14;

    /// Values to store.
    pub fn values(&self) -> [f32; Self::VALUES] {
        let Self { low, high, normals, height, least } = self;
        let mut all = [normals.cosine; Self::VALUES];
        for (to, from) in all.chunks_exact_mut(3).zip([low, high, &normals.axis, least]) {
            to.copy_from_slice(&from.to_array());
        }
        all[12] = *height;
        all
    }

    /// Restores the bounds from stored values.
    pub fn from_values(all: &[f32; Self::VALUES]) -> Self {
        let [low, high, axis, least] = [0, 3, 6, 9].map(|i| Vec3::new(all[i], all[i + 1], all[i + 2]));
        Self { low, high, normals: Cone { axis, cosine: all[13] }, height: all[12], least }
    }

    /// True if the camera sees no receiver.
    pub fn is_empty(&self) -> bool {
        !self.low.cmple(self.high).all()
    }

    /// Bounds of the same points moved by up to `by` in any direction.
    pub(crate) fn grown(&self, by: f32) -> Self {
        Self { low: self.low - by, high: self.high + by, height: self.height - by, ..*self }
    }
}
