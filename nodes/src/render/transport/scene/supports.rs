//! What objects rest on, and where the camera sees the receiver there.

use glam::Vec3;

use super::aabb::Aabb;
use super::receiver::Receiver;
use crate::geometry::bvh::{Hit, Ray};

/// Cosine of the steepest ground.
pub(crate) const STEEPEST: f32 = 0.7;
/// What one side of an object rests on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Support {
    /// From the receiver to the object: up, for ground.
    pub(crate) out: Vec3,
    pub(crate) low: Vec3,
    pub(crate) high: Vec3,
    /// Height of the side along `out`, in the frame of the scene.
    pub(crate) height: f32,
    /// The mesh's error: hits this near in height belong to the ground; up to twice as far, in part. 0 of a smooth mesh.
    pub(crate) reach: f32,
    /// How near in height hits are this ground's and no other object's, if they are nearest to it.
    pub(crate) claims: f32,
}

/// The supports of all objects.
#[derive(Debug, Clone, Default)]
pub struct Ground {
    /// The ways that they face, each once.
    pub(crate) ways: Vec<Vec3>,
    pub(crate) supports: Vec<Support>,
}

impl Ground {
    /// How near to a place of the mesh another one may be that a better mesh would not have: its largest error where objects
    /// stand.
    pub fn error(&self) -> f32 {
        self.supports.iter().map(|support| support.reach).fold(0.0, f32::max)
    }

    /// The farthest that a camera's hit moves.
    pub fn max_shift(&self) -> f32 {
        10.0 * self.error()
    }

    /// Whether a triangle of an object lies at the height of a base to which the camera's hits move, as near as that.
    pub fn is_base(&self, corners: &[Vec3; 3], near: f32) -> bool {
        let own = Aabb::around(corners);
        let lowest = |out: Vec3| corners.iter().map(|corner| corner.dot(out)).fold(f32::INFINITY, f32::min);
        self.supports.iter().filter(|s| s.reach > 0.0).any(|s| {
            (lowest(s.out) - s.height).abs() <= near
                && own.meets(&Aabb { low: s.low, high: s.high }.grown(near))
        })
    }

    /// How far a camera's hit must move along its unit ray to lie on the ground of the object that is
    /// nearest to it (the first of equally near ones); 0 where it belongs to no ground.
    pub fn shift(&self, position: Vec3, normal: Vec3, direction: Vec3) -> f32 {
        let along = |out: Vec3| normal.dot(out).abs() >= STEEPEST;
        let Some((part, out)) = self.rise(position, along) else { return 0.0 };
        let fall = direction.dot(out);
        if fall == 0.0 {
            return 0.0;
        }
        // A ray that hardly falls would run far; it moves ten times its height at most.
        let way = part / fall;
        way.clamp(-10.0 * part.abs(), 10.0 * part.abs())
    }

    /// Where rays to the receiver start from a place of an object that the mesh hides though the camera sees it, off that
    /// place: just over the mesh, straight above. None where no mesh lies over the place that counts as lower than it.
    pub fn over(&self, receiver: &Receiver, position: Vec3) -> Option<Vec3> {
        // In a corner over the floor, then over the wall.
        self.ways.iter().fold(None, |off: Option<Vec3>, &out| {
            let more = self.over_one(receiver, position + off.unwrap_or_default(), out);
            off.map_or(more, |off| Some(off + more.unwrap_or_default()))
        })
    }

    fn over_one(&self, receiver: &Receiver, position: Vec3, out: Vec3) -> Option<Vec3> {
        let height = position.dot(out);
        // Above twice the reach the mesh is where it is.
        let within =
            |s: &&Support| s.out == out && (s.height - s.reach..s.height + 2.0 * s.reach).contains(&height);
        let most = self.supports.iter().filter(within).map(|s| s.height + 2.0 * s.reach - height);
        let most = most.reduce(f32::max)?;
        let ray = Ray { t_max: most, ..Ray::new(position + out * most, -out) };
        let flat = |hit: &Hit| receiver.normal(hit.triangle).dot(out).abs() >= STEEPEST;
        let hit = receiver.bvh.closest(ray, flat)?;
        let mesh = ray.origin + ray.direction * hit.t;
        let level = mesh.dot(out) + self.rise(mesh, |way| way == out).map_or(0.0, |(rise, _)| rise);
        // Rounding must not decide about the lowest edge of the object.
        let slack = 1e-3 * most;
        (level <= height + slack).then(|| receiver.start(&hit) - position)
    }

    /// How far the ground at a place of the mesh lies over the mesh, and the way that it faces, of those that may be.
    fn rise(&self, position: Vec3, may_be: impl Fn(Vec3) -> bool) -> Option<(f32, Vec3)> {
        let height = |s: &Support| position.dot(s.out);
        let aside = |s: &Support| {
            let off = (s.low - position).max(position - s.high).max(Vec3::ZERO);
            (off - s.out * off.dot(s.out)).length_squared()
        };
        let near = self.supports.iter().filter(|s| may_be(s.out) && (s.height - height(s)).abs() < s.claims);
        // What stands on smooth ground keeps others from it, but for what is as near to both.
        let order = |s: &Support| (aside(s), s.reach == 0.0);
        let nearer = |a: &&Support, b: &&Support| {
            let ((a, last), (b, first)) = (order(a), order(b));
            a.total_cmp(&b).then(last.cmp(&first))
        };
        let support = near.min_by(nearer)?;
        let error = support.height - height(support);
        // The whole of it up to the reach, then less, to none at twice the reach.
        let whole = error.clamp(-support.reach, support.reach);
        Some((whole - (error - whole).clamp(-support.reach, support.reach), support.out))
    }
}
