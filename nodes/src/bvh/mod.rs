//! Ray casting against triangles.
//!
//! `obvhs` finds the tree; we fold it to four children a node, walk it with conservative box tests and
//! intersect with our own watertight test, so that a hit does not depend on the shape of the tree: the
//! nearest t wins, then the smallest triangle index. Only lane-wise arithmetic is used on `Vec4`, which
//! gives the same bits on every platform.

mod build;
mod steps;
mod triangles;

use glam::{Vec3, Vec4};

pub use steps::Steps;
use triangles::{Packet, Sheared};

/// A half-line from `origin`, up to `t_max` lengths of `direction`.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Start, not itself part of the ray.
    pub origin: Vec3,
    /// Direction; distances are in units of its length.
    pub direction: Vec3,
    /// Greatest distance, may be infinite.
    pub t_max: f32,
}

impl Ray {
    /// An unbounded ray.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_max: f32::INFINITY }
    }
}

/// Where a ray meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance in lengths of the ray's direction.
    pub t: f32,
    /// Index of the triangle among those given to [`Bvh::build`].
    pub triangle: u32,
    /// Barycentric weight of vertex 1.
    pub b1: f32,
    /// Barycentric weight of vertex 2.
    pub b2: f32,
    /// True when the ray meets the back: the side from which the vertices run clockwise.
    pub back: bool,
}

/// Four boxes: `bounds[axis][0]` the lower faces, `[1]` the upper ones.
#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: [[Vec4; 2]; 3],
    /// Node index, or [`LEAF`] + packets in bits 26 to 30 + index of the first packet.
    children: [u32; 4],
}

const LEAF: u32 = 1 << 31;
const LEAF_SHIFT: u32 = 26;
const LEAF_FIRST: u32 = (1 << LEAF_SHIFT) - 1;
/// Deepest stack of the walk; a tree that needs more is replaced by a balanced one.
const STACK: usize = 64;
/// Boxes are entered up to this much beyond the nearest hit, which covers the rounding of both.
const SLACK: f32 = 1.0 + 1.0 / 65_536.0;

/// A tree of boxes over triangles.
#[derive(Debug, Clone, Default)]
pub struct Bvh {
    nodes: Vec<Node>,
    packets: Vec<Packet>,
    /// Triangles left out because a corner is not finite.
    pub broken: u64,
    /// Triangles left out because they have no area.
    pub degenerate: u64,
    bounds: Option<(Vec3, Vec3)>,
}

impl Bvh {
    /// Box around all triangles.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        self.bounds
    }

    /// Looks at the tree from its root: `visit` gets the corners of a box, and says whether to look into that, or those of
    /// a triangle.
    pub fn visit(&self, mut look: impl FnMut(&[Vec3]) -> bool) {
        let corners = |bounds: &[[Vec4; 2]; 3], lane: usize| -> [Vec3; 8] {
            std::array::from_fn(|i| Vec3::from_array([0, 1, 2].map(|axis| bounds[axis][i >> axis & 1][lane])))
        };
        let mut waiting = if self.nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(at) = waiting.pop() {
            if at & LEAF == 0 {
                let Node { bounds, children } = &self.nodes[at as usize];
                // Lanes without a child have bounds that are empty.
                let there = |lane: &usize| bounds[0][0][*lane] <= bounds[0][1][*lane];
                let open = |lane: usize| look(&corners(bounds, lane)).then_some(children[lane]);
                waiting.extend((0..4).filter(there).filter_map(open));
                continue;
            }
            let first = (at & LEAF_FIRST) as usize;
            for packet in &self.packets[first..first + ((at & !LEAF) >> LEAF_SHIFT) as usize] {
                for lane in (0..4).filter(|&lane| packet.ids[lane] != u32::MAX) {
                    look(&packet.corners.map(|corner| Vec3::from_array(corner.map(|axis| axis[lane]))));
                }
            }
        }
    }

    /// The nearest hit that `accept` takes.
    #[inline]
    pub fn closest(&self, ray: Ray, accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        match Steps::are_counted() {
            false => self.nearest::<false>(ray, accept),
            true => self.nearest_counted(ray, accept),
        }
    }

    /// True when there is a hit that `accept` takes.
    #[inline]
    pub fn any(&self, ray: Ray, accept: impl FnMut(&Hit) -> bool) -> bool {
        match Steps::are_counted() {
            false => self.meets::<false>(ray, accept),
            true => self.meets_counted(ray, accept),
        }
    }

    // Out of the way of the walks that are not counted.
    #[cold]
    #[inline(never)]
    fn nearest_counted(&self, ray: Ray, accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        self.nearest::<true>(ray, accept)
    }

    #[cold]
    #[inline(never)]
    fn meets_counted(&self, ray: Ray, accept: impl FnMut(&Hit) -> bool) -> bool {
        self.meets::<true>(ray, accept)
    }

    #[inline(always)]
    fn nearest<const COUNTED: bool>(&self, ray: Ray, mut accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        let mut limit = ray.t_max;
        self.walk::<true, COUNTED>(ray, |packet, sheared, limit_out| {
            packet.intersect(sheared, limit, |hit| {
                let nearer = best.is_none_or(|b| hit.t < b.t || (hit.t == b.t && hit.triangle < b.triangle));
                if nearer && accept(&hit) {
                    limit = hit.t;
                    best = Some(hit);
                }
                true
            });
            *limit_out = limit;
            true
        });
        best
    }

    #[inline(always)]
    fn meets<const COUNTED: bool>(&self, ray: Ray, mut accept: impl FnMut(&Hit) -> bool) -> bool {
        !self.walk::<false, COUNTED>(ray, |packet, sheared, _| {
            packet.intersect(sheared, ray.t_max, |hit| !accept(&hit))
        })
    }

    /// Visits leaves, `NEAR` ones first if asked, until `leaf` gives false; gives false then.
    #[inline(always)]
    fn walk<const NEAR: bool, const COUNTED: bool>(
        &self,
        ray: Ray,
        mut leaf: impl FnMut(&Packet, &Sheared, &mut f32) -> bool,
    ) -> bool {
        let Some((low, high)) = self.bounds else { return true };
        // A direction component of 0 becomes a slope so steep that the ray never leaves its slab.
        let slope = ray.direction.to_array().map(|d| {
            let inverse = 1.0 / d;
            if inverse.is_finite() { inverse.clamp(-1e30, 1e30) } else { 1e30_f32.copysign(d) }
        });
        let (mut enter, mut leave) = (0.0_f32, ray.t_max);
        for axis in 0..3 {
            let (a, b) =
                ((low[axis] - ray.origin[axis]) * slope[axis], (high[axis] - ray.origin[axis]) * slope[axis]);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        // Most rays to a small object end here.
        if enter > leave * SLACK {
            return true;
        }
        let sheared = Sheared::new(&ray);
        let near = slope.map(|s| usize::from(s < 0.0));
        let slopes = slope.map(Vec4::splat);
        let origin = ray.origin.to_array().map(Vec4::splat);
        let mut limit = ray.t_max;
        let mut stack = [(0_u32, 0.0_f32); STACK];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (child, entry) = stack[depth];
            if entry > limit * SLACK {
                continue;
            }
            if child & LEAF != 0 {
                let first = (child & LEAF_FIRST) as usize;
                let count = ((child & !LEAF) >> LEAF_SHIFT) as usize;
                for packet in &self.packets[first..first + count] {
                    if COUNTED {
                        Steps::add(0, 1);
                    }
                    if !leaf(packet, &sheared, &mut limit) {
                        return false;
                    }
                }
                continue;
            }
            if COUNTED {
                Steps::add(1, 0);
            }
            let node = &self.nodes[child as usize];
            let mut enter = Vec4::ZERO;
            let mut leave = Vec4::splat(limit);
            for axis in 0..3 {
                let [low, high] = [node.bounds[axis][near[axis]], node.bounds[axis][1 - near[axis]]];
                enter = enter.max((low - origin[axis]) * slopes[axis]);
                leave = leave.min((high - origin[axis]) * slopes[axis]);
            }
            let mut hits = enter.cmple(leave * SLACK).bitmask();
            let entries = enter.to_array();
            let base = depth;
            while hits != 0 {
                let lane = hits.trailing_zeros() as usize;
                hits &= hits - 1;
                // Insertion keeps the nearest child on top; equal ones stay in order of lanes.
                let mut at = depth;
                while NEAR && at > base && stack[at - 1].1 < entries[lane] {
                    stack[at] = stack[at - 1];
                    at -= 1;
                }
                stack[at] = (node.children[lane], entries[lane]);
                depth += 1;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests;
