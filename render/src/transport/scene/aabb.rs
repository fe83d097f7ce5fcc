//! Axis-aligned bounding boxes.

use glam::Vec3;

/// An axis-aligned bounding box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    /// Corner with the smallest coordinates.
    pub low: Vec3,
    /// Corner with the largest coordinates.
    pub high: Vec3,
}

impl Aabb {
    /// The empty box.
    pub const EMPTY: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };

    /// The bounding box of points.
    pub(crate) fn around<'a>(points: impl IntoIterator<Item = &'a Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |all, &point| all.joined(Self { low: point, high: point }))
    }

    /// True if the box contains no point.
    pub fn is_empty(&self) -> bool {
        !self.low.cmple(self.high).all()
    }

    /// The union of two boxes.
    pub(crate) fn joined(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// The intersection of two boxes, which may be empty.
    pub(crate) fn common(self, other: Self) -> Self {
        Self { low: self.low.max(other.low), high: self.high.min(other.high) }
    }

    /// The box enlarged by `space` on all sides.
    pub(crate) fn grown(self, space: f32) -> Self {
        Self { low: self.low - space, high: self.high + space }
    }

    pub(crate) fn meets(&self, other: &Self) -> bool {
        self.low.cmple(other.high).all() && other.low.cmple(self.high).all()
    }

    /// Length of the diagonal; 0 for the empty box.
    pub fn size(&self) -> f32 {
        if self.is_empty() { 0.0 } else { (self.high - self.low).length() }
    }

    /// Distance from a point to the box, 0 inside.
    pub fn distance(&self, point: Vec3) -> f32 {
        (point.clamp(self.low, self.high) - point).length()
    }

    /// True if the box contains a point. Its boundary belongs to it.
    pub fn holds(&self, point: Vec3) -> bool {
        point.cmpge(self.low).all() && point.cmple(self.high).all()
    }
}
