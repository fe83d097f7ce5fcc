//! Ray casting against triangles.
//!
//! `obvhs` builds a binary tree, which is converted to a tree with eight children per node. Box tests are
//! conservative and the triangle test is watertight, so a hit does not depend on the shape of the tree. Of several
//! hits, the hit with the smallest `t` counts. If several hits have this `t`, the hit with the smallest triangle
//! index counts. Vector code uses lane-wise arithmetic only, so the bits are the same on every platform with any
//! instruction set.

mod build;
mod collapse;
mod divide;
mod ray;
mod stack;
mod steps;
mod triangles;

use fearless_simd::{Level, f32x8, prelude::*};
use glam::Vec3;

use collapse::WIDE;
pub(crate) use divide::each;
pub use ray::{Hit, Ray};
use stack::{STACK, with_stack};
pub use steps::Steps;
use triangles::{Packet, Sheared};

/// A node with the boxes of its eight children. `bounds[axis][0]` holds the lower faces of the boxes, and
/// `bounds[axis][1]` the upper faces.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
struct Node {
    bounds: [[[f32; WIDE]; 2]; 3],
    /// Each entry is the index of a node, or a leaf. A leaf has the bit [`LEAF`], the number of packets in bits 26
    /// to 30, and the index of the first packet in the lower bits.
    children: [u32; WIDE],
}

const LEAF: u32 = 1 << 31;
const LEAF_SHIFT: u32 = 26;
const LEAF_FIRST: u32 = (1 << LEAF_SHIFT) - 1;
/// A box is entered if the distance to it is at most this multiple of the distance to the nearest hit so far. The
/// factor covers the rounding of both distances.
const SLACK: f32 = 1.0 + 1.0 / 65_536.0;

/// Runs a traversal with wide vector registers if the machine has them. Products are not fused with sums, so all
/// machines give the same bits.
macro_rules! at_best {
    ($level:expr, $simd:ident => $walk:expr) => {{
        #[cfg(target_arch = "x86_64")]
        match $level.as_avx2() {
            Some($simd) => $simd.vectorize(
                #[inline(always)]
                || $walk,
            ),
            None => {
                let $simd = $level.as_sse2().expect("SSE2 is part of x86-64");
                $walk
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        fearless_simd::dispatch!($level, $simd => $walk)
    }};
}

/// A tree of boxes over triangles.
#[derive(Debug, Clone)]
pub struct Bvh {
    nodes: Vec<Node>,
    packets: Vec<Packet>,
    /// The set of vector instructions that is used. All sets give the same bits.
    level: Level,
    /// Number of triangles left out because a corner is not finite.
    pub broken: u64,
    /// Number of triangles left out because they have no area.
    pub degenerate: u64,
    bounds: Option<(Vec3, Vec3)>,
}

impl Default for Bvh {
    /// Returns a tree without triangles.
    fn default() -> Self {
        let (nodes, packets) = (Vec::new(), Vec::new());
        Self { nodes, packets, level: Level::new(), broken: 0, degenerate: 0, bounds: None }
    }
}

impl Bvh {
    /// Memory used by the tree, in bytes.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&*self.nodes) + size_of_val(&*self.packets)) as u64
    }

    /// Box around all triangles. `None` if there are no triangles.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        self.bounds
    }

    /// Traverses the tree from its root. `look` is called with the eight corners of each box, and returns whether
    /// to descend into it. It is also called with the three corners of each triangle in the leaves that are
    /// reached.
    pub fn visit(&self, mut look: impl FnMut(&[Vec3]) -> bool) {
        let corners = |bounds: &[[[f32; WIDE]; 2]; 3], lane: usize| -> [Vec3; 8] {
            std::array::from_fn(|i| Vec3::from_array([0, 1, 2].map(|axis| bounds[axis][i >> axis & 1][lane])))
        };
        let mut waiting = if self.nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(at) = waiting.pop() {
            if at & LEAF == 0 {
                let Node { bounds, children } = &self.nodes[at as usize];
                // Lanes without a child have empty bounds.
                let there = |lane: &usize| bounds[0][0][*lane] <= bounds[0][1][*lane];
                let open = |lane: usize| look(&corners(bounds, lane)).then_some(children[lane]);
                waiting.extend((0..WIDE).filter(there).filter_map(open));
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

    /// The nearest hit for which `accept` returns true.
    #[inline]
    pub fn closest(&self, ray: Ray, accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        // Most rays towards a small object end here.
        let slope = self.enter(&ray)?;
        match Steps::are_counted() {
            false => at_best!(self.level, simd => self.nearest::<_, false>(simd, ray, slope, accept)),
            true => self.nearest_counted(ray, slope, accept),
        }
    }

    /// True if there is a hit for which `accept` returns true.
    #[inline]
    pub fn any(&self, ray: Ray, accept: impl FnMut(&Hit) -> bool) -> bool {
        let Some(slope) = self.enter(&ray) else { return false };
        match Steps::are_counted() {
            false => at_best!(self.level, simd => self.meets::<_, false>(simd, ray, slope, accept)),
            true => self.meets_counted(ray, slope, accept),
        }
    }

    /// Returns the reciprocal of the direction of a ray. `None` if the ray misses the box around all triangles. For
    /// a component of 0 the reciprocal is finite but so large that the ray never leaves the slab of the box along
    /// this axis.
    #[inline(always)]
    fn enter(&self, ray: &Ray) -> Option<[f32; 3]> {
        let (low, high) = self.bounds?;
        let slope = ray.direction.to_array().map(|d| {
            let inverse = 1.0 / d;
            if inverse.is_finite() { inverse.clamp(-1e30, 1e30) } else { 1e30_f32.copysign(d) }
        });
        let (mut enter, mut leave) = (0.0_f32, ray.t_max);
        for axis in 0..3 {
            let a = (low[axis] - ray.origin[axis]) * slope[axis];
            let b = (high[axis] - ray.origin[axis]) * slope[axis];
            // Comparisons take fewer instructions than `min` and `max`, which handle NaN.
            let (near, far) = if a < b { (a, b) } else { (b, a) };
            enter = if near > enter { near } else { enter };
            leave = if far < leave { far } else { leave };
        }
        if enter > leave * SLACK { None } else { Some(slope) }
    }

    // Kept separate from the traversals that are not counted.
    #[cold]
    #[inline(never)]
    fn nearest_counted(&self, ray: Ray, slope: [f32; 3], accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        at_best!(self.level, simd => self.nearest::<_, true>(simd, ray, slope, accept))
    }

    #[cold]
    #[inline(never)]
    fn meets_counted(&self, ray: Ray, slope: [f32; 3], accept: impl FnMut(&Hit) -> bool) -> bool {
        at_best!(self.level, simd => self.meets::<_, true>(simd, ray, slope, accept))
    }

    #[inline(always)]
    fn nearest<S: Simd, const COUNTED: bool>(
        &self,
        simd: S,
        ray: Ray,
        slope: [f32; 3],
        mut accept: impl FnMut(&Hit) -> bool,
    ) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        let mut limit = ray.t_max;
        self.walk::<S, true, COUNTED>(
            simd,
            ray,
            slope,
            #[inline(always)]
            |packet, sheared, limit_out| {
                packet.intersect(
                    sheared,
                    limit,
                    #[inline(always)]
                    |hit| {
                        let nearer =
                            best.is_none_or(|b| hit.t < b.t || (hit.t == b.t && hit.triangle < b.triangle));
                        if nearer && accept(&hit) {
                            limit = hit.t;
                            best = Some(hit);
                        }
                        true
                    },
                );
                *limit_out = limit;
                true
            },
        );
        best
    }

    #[inline(always)]
    fn meets<S: Simd, const COUNTED: bool>(
        &self,
        simd: S,
        ray: Ray,
        slope: [f32; 3],
        mut accept: impl FnMut(&Hit) -> bool,
    ) -> bool {
        !self.walk::<S, false, COUNTED>(
            simd,
            ray,
            slope,
            #[inline(always)]
            |packet, sheared, _| {
                packet.intersect(
                    sheared,
                    ray.t_max,
                    #[inline(always)]
                    |hit| !accept(&hit),
                )
            },
        )
    }

    /// Visits leaves until `leaf` returns false. If `NEAR`, the nearest leaves come first. Returns false if `leaf`
    /// returned false.
    #[inline(always)]
    fn walk<S: Simd, const NEAR: bool, const COUNTED: bool>(
        &self,
        simd: S,
        ray: Ray,
        slope: [f32; 3],
        mut leaf: impl FnMut(&Packet, &Sheared, &mut f32) -> bool,
    ) -> bool {
        let sheared = Sheared::new(&ray);
        let [x, y, z] = slope;
        let near = [usize::from(x < 0.0), usize::from(y < 0.0), usize::from(z < 0.0)];
        let slopes = [f32x8::splat(simd, x), f32x8::splat(simd, y), f32x8::splat(simd, z)];
        let Vec3 { x, y, z } = ray.origin;
        let origin = [f32x8::splat(simd, x), f32x8::splat(simd, y), f32x8::splat(simd, z)];
        let mut limit = ray.t_max;
        with_stack(
            #[inline(always)]
            |stack| {
                let (mut at, mut depth) = (0_u32, 0);
                loop {
                    if at & LEAF != 0 {
                        let first = (at & LEAF_FIRST) as usize;
                        let count = ((at & !LEAF) >> LEAF_SHIFT) as usize;
                        for packet in &self.packets[first..first + count] {
                            if COUNTED {
                                Steps::add(0, 1);
                            }
                            if !leaf(packet, &sheared, &mut limit) {
                                return false;
                            }
                        }
                    } else {
                        if COUNTED {
                            Steps::add(1, 0);
                        }
                        let Node { bounds, children } = &self.nodes[at as usize];
                        let mut enter = f32x8::splat(simd, 0.0);
                        let mut leave = f32x8::splat(simd, limit);
                        for axis in 0..3 {
                            let low = f32x8::from_slice(simd, &bounds[axis][near[axis]]);
                            let high = f32x8::from_slice(simd, &bounds[axis][1 - near[axis]]);
                            enter = enter.max((low - origin[axis]) * slopes[axis]);
                            leave = leave.min((high - origin[axis]) * slopes[axis]);
                        }
                        let mut hits = enter.simd_le(leave * SLACK).to_bitmask() as u32;
                        if hits != 0 && hits & (hits - 1) == 0 {
                            at = children[hits.trailing_zeros() as usize % WIDE];
                            continue;
                        }
                        if hits != 0 && !NEAR {
                            // Any order is valid: the first child is next.
                            at = children[hits.trailing_zeros() as usize % WIDE];
                            hits &= hits - 1;
                            while hits != 0 {
                                stack[depth] = (children[hits.trailing_zeros() as usize % WIDE], 0.0);
                                hits &= hits - 1;
                                depth += 1;
                            }
                            continue;
                        }
                        if hits != 0 {
                            let mut entries = [0.0; WIDE];
                            enter.store_slice(&mut entries);
                            let base = depth;
                            // The nearest child is next. The others wait on the stack, nearer ones on top, and
                            // equal ones in the order of lanes.
                            let lane = hits.trailing_zeros() as usize % WIDE;
                            hits &= hits - 1;
                            let mut next = (children[lane], entries[lane]);
                            while hits != 0 {
                                let lane = hits.trailing_zeros() as usize % WIDE;
                                hits &= hits - 1;
                                let mut waits = (children[lane], entries[lane]);
                                if waits.1 <= next.1 {
                                    std::mem::swap(&mut waits, &mut next);
                                }
                                let mut place = depth;
                                while place > base && stack[place - 1].1 < waits.1 {
                                    stack[place] = stack[place - 1];
                                    place -= 1;
                                }
                                stack[place] = waits;
                                depth += 1;
                            }
                            at = next.0;
                            continue;
                        }
                    }
                    // The last waiting child, unless the hit found is nearer.
                    loop {
                        if depth == 0 {
                            return true;
                        }
                        depth -= 1;
                        let (child, entry) = stack[depth];
                        if !NEAR || entry <= limit * SLACK {
                            at = child;
                            break;
                        }
                    }
                }
            },
        )
    }
}

#[cfg(test)]
mod tests;
