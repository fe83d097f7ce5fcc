//! Surfaces that objects rest on, and the correction of camera hits there.

use glam::Vec3;

use super::aabb::Aabb;
use super::receiver::Receiver;
use crate::geometry::bvh::{Hit, Ray};

/// Minimum cosine between the normal of the mesh and the direction of support at which the mesh supports an object.
pub(crate) const STEEPEST: f32 = 0.7;
/// Support of one side of an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Support {
    /// Unit vector from the receiver to the object: up, for the ground.
    pub(crate) out: Vec3,
    pub(crate) low: Vec3,
    pub(crate) high: Vec3,
    /// Height of the side along `out`, in the frame of the scene.
    pub(crate) height: f32,
    /// Error of the mesh, in world units. A hit within this distance of `height` is moved fully onto the side, and
    /// a hit up to twice as far away is moved partially. 0 for a smooth mesh.
    pub(crate) reach: f32,
    /// Maximum difference in height between a hit and the support for the hit to belong to this support rather than
    /// to the support of another object. This applies only if this support is the nearest one.
    pub(crate) claims: f32,
}

/// Supports of all objects.
#[derive(Debug, Clone, Default)]
pub struct Ground {
    /// Distinct directions of support.
    pub(crate) ways: Vec<Vec3>,
    pub(crate) supports: Vec<Support>,
}

impl Ground {
    /// Largest error of the mesh where objects rest. Surfaces within this distance of each other may be one
    /// surface.
    pub fn error(&self) -> f32 {
        self.supports.iter().map(|support| support.reach).fold(0.0, f32::max)
    }

    /// Largest distance by which a camera hit is moved.
    pub fn max_shift(&self) -> f32 {
        10.0 * self.error()
    }

    /// True if a triangle of an object lies within `near` of the height of a support to which camera hits are
    /// moved.
    pub fn is_base(&self, corners: &[Vec3; 3], near: f32) -> bool {
        let own = Aabb::around(corners);
        let lowest = |out: Vec3| corners.iter().map(|corner| corner.dot(out)).fold(f32::INFINITY, f32::min);
        self.supports.iter().filter(|s| s.reach > 0.0).any(|s| {
            (lowest(s.out) - s.height).abs() <= near
                && own.meets(&Aabb { low: s.low, high: s.high }.grown(near))
        })
    }

    /// Distance by which a camera hit is moved along its unit ray so that it lies on the support of the nearest
    /// object. If several objects are equally near, the first one counts. 0 if the hit belongs to no support.
    pub fn shift(&self, position: Vec3, normal: Vec3, direction: Vec3) -> f32 {
        let along = |out: Vec3| normal.dot(out).abs() >= STEEPEST;
        let Some((part, out)) = self.rise(position, along) else { return 0.0 };
        let fall = direction.dot(out);
        if fall == 0.0 {
            return 0.0;
        }
        // A grazing ray would move far; it moves at most ten times the height.
        let way = part / fall;
        way.clamp(-10.0 * part.abs(), 10.0 * part.abs())
    }

    /// Offset at which rays to the receiver start from a point of an object that is visible to the camera but
    /// covered by the mesh: just above the mesh, along the direction of support. `None` if no mesh covers the
    /// point.
    pub fn over(&self, receiver: &Receiver, position: Vec3) -> Option<Vec3> {
        // In a corner, the offset first leads above the floor, then off the wall.
        self.ways.iter().fold(None, |off: Option<Vec3>, &out| {
            let more = self.over_one(receiver, position + off.unwrap_or_default(), out);
            off.map_or(more, |off| Some(off + more.unwrap_or_default()))
        })
    }

    fn over_one(&self, receiver: &Receiver, position: Vec3, out: Vec3) -> Option<Vec3> {
        let height = position.dot(out);
        // Beyond twice the reach, the mesh is taken as it is.
        let within =
            |s: &&Support| s.out == out && (s.height - s.reach..s.height + 2.0 * s.reach).contains(&height);
        let most = self.supports.iter().filter(within).map(|s| s.height + 2.0 * s.reach - height);
        let most = most.reduce(f32::max)?;
        let ray = Ray { t_max: most, ..Ray::new(position + out * most, -out) };
        let flat = |hit: &Hit| receiver.normal(hit.triangle).dot(out).abs() >= STEEPEST;
        let hit = receiver.bvh.closest(ray, flat)?;
        let mesh = ray.origin + ray.direction * hit.t;
        let level = mesh.dot(out) + self.rise(mesh, |way| way == out).map_or(0.0, |(rise, _)| rise);
        // Rounding must not decide for the lowest edge of the object.
        let slack = 1e-3 * most;
        (level <= height + slack).then(|| receiver.start(&hit) - position)
    }

    /// Height, along the direction of support, by which the nearest support lies above a point of the mesh. Beyond
    /// [`Support::reach`], this height is reduced, and it is 0 at twice the reach. Also returns the direction of
    /// support. `may_be` selects the permitted directions.
    fn rise(&self, position: Vec3, may_be: impl Fn(Vec3) -> bool) -> Option<(f32, Vec3)> {
        let height = |s: &Support| position.dot(s.out);
        let aside = |s: &Support| {
            let off = (s.low - position).max(position - s.high).max(Vec3::ZERO);
            (off - s.out * off.dot(s.out)).length_squared()
        };
        let near = self.supports.iter().filter(|s| may_be(s.out) && (s.height - height(s)).abs() < s.claims);
        // An object on smooth ground keeps its hits from other supports, unless those are equally near.
        let order = |s: &Support| (aside(s), s.reach == 0.0);
        let nearer = |a: &&Support, b: &&Support| {
            let ((a, last), (b, first)) = (order(a), order(b));
            a.total_cmp(&b).then(last.cmp(&first))
        };
        let support = near.min_by(nearer)?;
        let error = support.height - height(support);
        // Fully up to `reach`, then less, to 0 at twice `reach`.
        let whole = error.clamp(-support.reach, support.reach);
        Some((whole - (error - whole).clamp(-support.reach, support.reach), support.out))
    }
}
