//! Ray casting against triangles.
//!
//! `obvhs` finds the tree; we fold it to four children a node, walk it with conservative box tests and
//! intersect with our own watertight test, so that a hit does not depend on the shape of the tree: the
//! nearest t wins, then the smallest triangle index. Only lane-wise arithmetic is used on `Vec4`, which
//! gives the same bits on every platform.

use glam::{Vec3, Vec4};
use obvhs::aabb::Aabb;
use obvhs::ploc::{PlocSearchDistance, SortPrecision};
use obvhs::{BvhBuildParams, bvh2::Bvh2, bvh2::builder::build_bvh2};

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

/// Four triangles, one a lane. Unused lanes are a point at the origin, which nothing hits.
#[derive(Debug, Clone, Copy)]
struct Packet {
    corners: [[Vec4; 3]; 3],
    ids: [u32; 4],
}

/// Four boxes: `bounds[axis][0]` the lower faces, `[1]` the upper ones.
#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: [[Vec4; 2]; 3],
    /// Node index, or [`LEAF`] + packets in bits 27.. + index of the first packet.
    children: [u32; 4],
}

const LEAF: u32 = 1 << 31;
const LEAF_SHIFT: u32 = 26;
const LEAF_FIRST: u32 = (1 << LEAF_SHIFT) - 1;
/// Deepest stack of the walk; a tree that needs more is replaced by a balanced one.
const STACK: usize = 96;
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
    /// A tree over triangles given by their corners.
    pub fn build(corners: &[[Vec3; 3]]) -> Self {
        let mut bvh = Self::default();
        let mut kept = Vec::with_capacity(corners.len());
        let mut boxes = Vec::with_capacity(corners.len());
        for (index, [a, b, c]) in corners.iter().enumerate() {
            if !(a.is_finite() && b.is_finite() && c.is_finite()) {
                bvh.broken += 1;
                continue;
            }
            let area = (*b - *a).cross(*c - *a);
            if !(area.length_squared() > 0.0 && area.is_finite()) {
                // The square of a tiny area may vanish though the triangle has one: judge in f64.
                let (ab, ac) = ((*b - *a).as_dvec3(), (*c - *a).as_dvec3());
                if ab.cross(ac).length_squared() == 0.0 {
                    bvh.degenerate += 1;
                    continue;
                }
            }
            kept.push(index as u32);
            boxes.push((a.min(*b).min(*c), a.max(*b).max(*c)));
        }
        if kept.is_empty() {
            return bvh;
        }
        bvh.bounds = boxes.iter().copied().reduce(|(l, h), (a, b)| (l.min(a), h.max(b)));
        let mut build = Fold { corners, kept: &kept, boxes: &boxes, out: bvh };
        let depth = if kept.len() == 1 { usize::MAX } else { build.build_tree() };
        if depth.saturating_mul(3) >= STACK {
            build.out.nodes.clear();
            build.out.packets.clear();
            let mut order: Vec<u32> = (0..kept.len() as u32).collect();
            let mut tree = Vec::new();
            balanced(&boxes, &mut order, 0, &mut tree);
            build.fold(&tree, &order);
        }
        build.out
    }

    /// Box around all triangles.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        self.bounds
    }

    /// The nearest hit that `accept` takes.
    #[inline]
    pub fn closest(&self, ray: Ray, mut accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        let mut limit = ray.t_max;
        let sheared = Sheared::new(&ray);
        self.walk(ray, |packet, limit_out| {
            packet.intersect(&sheared, limit, |hit| {
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

    /// True when there is a hit that `accept` takes.
    #[inline]
    pub fn any(&self, ray: Ray, mut accept: impl FnMut(&Hit) -> bool) -> bool {
        let sheared = Sheared::new(&ray);
        !self.walk(ray, |packet, _| packet.intersect(&sheared, ray.t_max, |hit| !accept(&hit)))
    }

    /// Visits leaves near to far until `leaf` gives false; gives false then.
    #[inline(always)]
    fn walk(&self, ray: Ray, mut leaf: impl FnMut(&Packet, &mut f32) -> bool) -> bool {
        if self.nodes.is_empty() {
            return true;
        }
        // A direction component of 0 becomes a slope so steep that the ray never leaves its slab.
        let slope = ray.direction.to_array().map(|d| {
            let inverse = 1.0 / d;
            if inverse.is_finite() { inverse.clamp(-1e30, 1e30) } else { 1e30_f32.copysign(d) }
        });
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
                    if !leaf(packet, &mut limit) {
                        return false;
                    }
                }
                continue;
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
                while at > base && stack[at - 1].1 < entries[lane] {
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

/// A ray as the triangle test wants it: axes permuted so that the last is the longest of the direction,
/// and the shear that turns the direction into that axis (Woop, Benthin and Wald 2013, Watertight
/// Ray/Triangle Intersection).
struct Sheared {
    axes: [usize; 3],
    origin: [Vec4; 3],
    shear: [Vec4; 3],
}

impl Sheared {
    #[inline(always)]
    fn new(ray: &Ray) -> Self {
        let z = ray.direction.abs().max_position();
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        let d = ray.direction.to_array();
        // Swapping keeps the winding.
        if d[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let axes = [x, y, z];
        let shear = [d[x] / d[z], d[y] / d[z], 1.0 / d[z]].map(Vec4::splat);
        Self { axes, origin: axes.map(|axis| Vec4::splat(ray.origin.to_array()[axis])), shear }
    }
}

impl Packet {
    /// Tests four triangles. Corners are projected along the ray one by one, so that neighbours see the
    /// same projected corners; the sign of an edge function of two of them is exact, for rounding is
    /// monotone and a 0 is decided in f64. So no ray slips between neighbours, at corners neither.
    #[inline(always)]
    fn intersect(&self, ray: &Sheared, limit: f32, mut hit: impl FnMut(Hit) -> bool) -> bool {
        let [kx, ky, kz] = ray.axes;
        let [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = self.corners.map(|corner| {
            let z = corner[kz] - ray.origin[2];
            let x = corner[kx] - ray.origin[0] - ray.shear[0] * z;
            let y = corner[ky] - ray.origin[1] - ray.shear[1] * z;
            [x, y, z * ray.shear[2]]
        });
        let mut u = cx * by - cy * bx;
        let mut v = ax * cy - ay * cx;
        let mut w = bx * ay - by * ax;
        let edge = u.cmpeq(Vec4::ZERO) | v.cmpeq(Vec4::ZERO) | w.cmpeq(Vec4::ZERO);
        if edge.any() {
            let exact = |px: Vec4, qy: Vec4, py: Vec4, qx: Vec4, lane: usize| {
                (f64::from(px[lane]) * f64::from(qy[lane]) - f64::from(py[lane]) * f64::from(qx[lane])) as f32
            };
            for lane in 0..4 {
                if edge.test(lane) {
                    u[lane] = exact(cx, by, cy, bx, lane);
                    v[lane] = exact(ax, cy, ay, cx, lane);
                    w[lane] = exact(bx, ay, by, ax, lane);
                }
            }
        }
        let (least, most) = (u.min(v).min(w), u.max(v).max(w));
        let inside = least.cmpge(Vec4::ZERO) | most.cmple(Vec4::ZERO);
        if !inside.any() {
            return true;
        }
        let det = u + v + w;
        let t = (u * az + v * bz + w * cz) / det;
        // Comparisons are false for the NaN of a ray in the plane of a triangle.
        let ahead = t.cmpgt(Vec4::ZERO) & t.cmple(Vec4::splat(limit));
        let mut lanes = (inside & ahead & det.cmpne(Vec4::ZERO)).bitmask();
        if lanes == 0 {
            return true;
        }
        let (t, v, w, det) = (t.to_array(), v.to_array(), w.to_array(), det.to_array());
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let b1 = (v[lane] / det[lane]).clamp(0.0, 1.0);
            let b2 = (w[lane] / det[lane]).clamp(0.0, 1.0 - b1);
            let found = Hit { t: t[lane], triangle: self.ids[lane], b1, b2, back: det[lane] < 0.0 };
            if !hit(found) {
                return false;
            }
        }
        true
    }
}

/// A binary tree before folding: boxes come from the leaves, so only the topology is kept.
#[derive(Clone, Copy)]
enum Branch {
    Inner(u32, u32),
    Leaf { first: u32, count: u32 },
}

struct Fold<'a> {
    corners: &'a [[Vec3; 3]],
    kept: &'a [u32],
    boxes: &'a [(Vec3, Vec3)],
    out: Bvh,
}

impl Fold<'_> {
    /// Depth of the folded tree.
    fn build_tree(&mut self) -> usize {
        let large = self.kept.len() > 200_000;
        // "Very slow" without splits; large meshes get the cheaper reinsertion. A search depth of 1 is
        // what keeps meshes of mixed triangle sizes fast.
        let params = BvhBuildParams {
            pre_split: false,
            ploc_search_distance: PlocSearchDistance::Medium,
            search_depth_threshold: 1,
            reinsertion_batch_ratio: if large { 0.05 } else { 1.0 },
            post_collapse_reinsertion_batch_ratio_multiplier: 1.0,
            sort_precision: SortPrecision::U64,
            max_prims_per_leaf: 4,
            collapse_traversal_cost: 3.0,
        };
        let boxes: Vec<Aabb> = self.boxes.iter().map(|(l, h)| Aabb::new((*l).into(), (*h).into())).collect();
        let tree: Bvh2 = build_bvh2(&boxes, params, &mut std::time::Duration::default());
        let branches: Vec<Branch> = tree
            .nodes
            .iter()
            .map(|node| match node.prim_count {
                0 => Branch::Inner(node.first_index, node.first_index + 1),
                count => Branch::Leaf { first: node.first_index, count },
            })
            .collect();
        self.fold(&branches, &tree.primitive_indices)
    }

    /// Folds a binary tree whose root is its first branch; gives the depth.
    fn fold(&mut self, tree: &[Branch], order: &[u32]) -> usize {
        // Boxes of every branch, children before parents by an explicit walk.
        let mut bounds = vec![(Vec3::INFINITY, Vec3::NEG_INFINITY); tree.len()];
        let mut visit = vec![(0_u32, false)];
        while let Some((at, done)) = visit.pop() {
            bounds[at as usize] = match tree[at as usize] {
                Branch::Inner(left, right) if !done => {
                    visit.extend([(at, true), (left, false), (right, false)]);
                    continue;
                }
                Branch::Inner(left, right) => {
                    let ((a, b), (c, d)) = (bounds[left as usize], bounds[right as usize]);
                    (a.min(c), b.max(d))
                }
                Branch::Leaf { first, count } => order[first as usize..(first + count) as usize]
                    .iter()
                    .map(|&i| self.boxes[i as usize])
                    .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), (a, b)| (l.min(a), h.max(b))),
            };
        }
        let area = |at: u32| {
            let size = bounds[at as usize].1 - bounds[at as usize].0;
            size.x * size.y + size.y * size.z + size.z * size.x
        };
        let mut deepest = 0;
        let mut todo = vec![(0_u32, usize::MAX, 0, 1)];
        while let Some((at, parent, lane, depth)) = todo.pop() {
            deepest = deepest.max(depth);
            if let (Branch::Leaf { first, count }, true) = (tree[at as usize], parent != usize::MAX) {
                self.out.nodes[parent].children[lane] = self.leaf(order, first, count);
                continue;
            }
            let mut children = vec![at];
            // Opens the largest inner child until there are four.
            while children.len() < 4 {
                let inner = |&&c: &&u32| matches!(tree[c as usize], Branch::Inner(..));
                let Some(&open) =
                    children.iter().filter(inner).max_by(|&&a, &&b| area(a).total_cmp(&area(b)))
                else {
                    break;
                };
                let Branch::Inner(left, right) = tree[open as usize] else { break };
                let place = children.iter().position(|&c| c == open).unwrap_or(0);
                children[place] = left;
                children.push(right);
            }
            let mut node = Node { bounds: [[Vec4::INFINITY, Vec4::NEG_INFINITY]; 3], children: [LEAF; 4] };
            let index = self.out.nodes.len();
            for (lane, &child) in children.iter().enumerate() {
                let (low, high) = bounds[child as usize];
                for axis in 0..3 {
                    node.bounds[axis][0][lane] = low[axis];
                    node.bounds[axis][1][lane] = high[axis];
                }
                todo.push((child, index, lane, depth + 1));
            }
            self.out.nodes.push(node);
            if parent != usize::MAX {
                self.out.nodes[parent].children[lane] = index as u32;
            }
        }
        deepest
    }

    fn leaf(&mut self, order: &[u32], first: u32, count: u32) -> u32 {
        let start = self.out.packets.len() as u32;
        for chunk in order[first as usize..(first + count) as usize].chunks(4) {
            let mut packet = Packet { corners: [[Vec4::ZERO; 3]; 3], ids: [u32::MAX; 4] };
            for (lane, &i) in chunk.iter().enumerate() {
                let id = self.kept[i as usize];
                packet.ids[lane] = id;
                for (corner, p) in packet.corners.iter_mut().zip(self.corners[id as usize]) {
                    for axis in 0..3 {
                        corner[axis][lane] = p[axis];
                    }
                }
            }
            self.out.packets.push(packet);
        }
        let packets = self.out.packets.len() as u32 - start;
        LEAF | (packets << LEAF_SHIFT) | start
    }
}

/// A tree split at the median of the widest axis: not the fastest, but of logarithmic depth whatever the
/// triangles are.
fn balanced(boxes: &[(Vec3, Vec3)], order: &mut [u32], first: u32, tree: &mut Vec<Branch>) -> u32 {
    let at = tree.len() as u32;
    if order.len() <= 4 {
        tree.push(Branch::Leaf { first, count: order.len() as u32 });
        return at;
    }
    tree.push(Branch::Inner(0, 0));
    let centre = |i: u32| boxes[i as usize].0 + boxes[i as usize].1;
    let (low, high) = order
        .iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), &i| (l.min(centre(i)), h.max(centre(i))));
    let axis = (high - low).max_position();
    order.sort_by(|&a, &b| centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.cmp(&b)));
    let middle = order.len() / 2;
    let (left, right) = order.split_at_mut(middle);
    let left = balanced(boxes, left, first, tree);
    let right = balanced(boxes, right, first + middle as u32, tree);
    tree[at as usize] = Branch::Inner(left, right);
    at
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{mix, unit};

    struct Random(u32);
    impl Random {
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_add(1);
            unit(mix(self.0))
        }
        fn point(&mut self) -> Vec3 {
            Vec3::new(self.next(), self.next(), self.next()) * 2.0 - Vec3::ONE
        }
    }

    /// Nearest hit in f64 by testing every triangle; the honest reference.
    fn brute(corners: &[[Vec3; 3]], ray: Ray) -> Option<(f64, usize)> {
        let mut best: Option<(f64, usize)> = None;
        for (i, t) in corners.iter().enumerate() {
            let [a, b, c] = t.map(|p| p.as_dvec3());
            let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
            let (ab, ac) = (b - a, c - a);
            let p = d.cross(ac);
            let det = ab.dot(p);
            if det == 0.0 {
                continue;
            }
            let s = o - a;
            let (u, q) = (s.dot(p) / det, s.cross(ab));
            let (v, t) = (d.dot(q) / det, ac.dot(q) / det);
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && best.is_none_or(|b| t < b.0) {
                best = Some((t, i));
            }
        }
        best
    }

    fn soup(n: usize, size: f32, seed: u32) -> Vec<[Vec3; 3]> {
        let mut random = Random(seed);
        (0..n)
            .map(|_| {
                let p = random.point();
                [p, p + random.point() * size, p + random.point() * size]
            })
            .collect()
    }

    // Row 44 of the table of extremes: also rays along the axes, with components 0 and -0.
    #[test]
    fn tree_agrees_with_brute_force() {
        for (n, size) in [(1, 1.0), (2, 1.0), (5, 0.7), (500, 0.15)] {
            let corners = soup(n, size, n as u32);
            let bvh = Bvh::build(&corners);
            let mut random = Random(99);
            let mut unequal = 0;
            for i in 0..4_000 {
                let mut direction = random.point();
                match i % 8 {
                    0 => direction = Vec3::new(0.0, -0.0, direction.z),
                    1 => direction = Vec3::new(direction.x, -0.0, 0.0),
                    2 => direction.y = 0.0,
                    _ => {}
                }
                let ray = Ray::new(random.point() * 1.5, direction);
                let found = bvh.closest(ray, |_| true);
                assert_eq!(found.is_some(), bvh.any(ray, |_| true));
                match (found, brute(&corners, ray)) {
                    (Some(hit), Some((t, id))) if hit.triangle as usize == id => {
                        assert!((f64::from(hit.t) - t).abs() < 1e-3 * t.max(1e-2), "{hit:?} {t}");
                    }
                    (None, None) => {}
                    // A ray within rounding of an edge may go either way.
                    _ => unequal += 1,
                }
            }
            assert!(unequal <= 3, "{unequal} of 4000 for {n} triangles");
        }
    }

    /// A closed, subdivided sphere.
    fn sphere(rings: usize) -> Vec<[Vec3; 3]> {
        let point = |i: usize, j: usize| {
            let theta = std::f64::consts::PI * i as f64 / rings as f64;
            let phi = std::f64::consts::PI * (j % (2 * rings)) as f64 / rings as f64;
            let ((st, ct), (sp, cp)) = (crate::num::sin_cos(theta), crate::num::sin_cos(phi));
            let st = if i == 0 || i == rings { 0.0 } else { st };
            Vec3::new((st * cp) as f32, (st * sp) as f32, ct as f32)
        };
        let mut out = Vec::new();
        for i in 0..rings {
            for j in 0..2 * rings {
                let [a, b, c, d] = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
                out.push([a, b, c]);
                out.push([a, c, d]);
            }
        }
        out
    }

    // Rays from the inside through every edge and corner of a closed mesh, where leaks would be.
    #[test]
    fn closed_meshes_do_not_leak() {
        let corners = sphere(24);
        let bvh = Bvh::build(&corners);
        assert_eq!(bvh.degenerate, 96, "the poles of this sphere");
        let mut random = Random(5);
        for &[a, b, c] in &corners {
            for _ in 0..40 {
                let origin = random.point() * 0.3;
                let s = random.next();
                for target in [a, a + (b - a) * s, b + (c - b) * s, c + (a - c) * s, (a + b) * 0.5] {
                    let direction = target - origin;
                    assert!(bvh.any(Ray::new(origin, direction), |_| true), "leak at {target}");
                    assert!(bvh.any(Ray::new(origin, direction.normalize()), |_| true), "leak at {target}");
                }
            }
        }
    }

    // Row 41.
    #[test]
    fn broken_triangles_are_left_out_and_counted() {
        let good = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let line = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0];
        let corners = [[Vec3::NAN, Vec3::X, Vec3::Y], line, good, good, [Vec3::ONE; 3]];
        let bvh = Bvh::build(&corners);
        assert_eq!((bvh.broken, bvh.degenerate), (1, 2));
        let hit = bvh.closest(Ray::new(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z), |_| true).expect("hit");
        assert_eq!((hit.triangle, hit.back), (2, false), "the smaller of two equal ones");
        let behind = bvh.closest(Ray::new(Vec3::new(0.2, 0.2, -1.0), Vec3::Z), |h| h.triangle != 2);
        assert_eq!(behind.map(|h| (h.triangle, h.back)), Some((3, true)));
        assert!(!Bvh::build(&[]).any(Ray::new(Vec3::ZERO, Vec3::X), |_| true));
    }

    // Row 45: equal centroids make no deep tree.
    #[test]
    fn identical_triangles_stay_shallow() {
        let corners = vec![[Vec3::ZERO, Vec3::X, Vec3::Y]; 3_000];
        let bvh = Bvh::build(&corners);
        let hit = bvh.closest(Ray::new(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z), |_| true).expect("hit");
        assert_eq!(hit.triangle, 0);
        let mut order: Vec<u32> = (0..5_000).collect();
        let boxes = vec![(Vec3::ZERO, Vec3::ONE); 5_000];
        let mut tree = Vec::new();
        balanced(&boxes, &mut order, 0, &mut tree);
        assert!(tree.len() < 5_000);
    }

    // The folded tree gives the same hits as a differently shaped one: results do not hang on the tree.
    #[test]
    fn hits_do_not_depend_on_the_tree() {
        let corners = soup(3_000, 0.2, 3);
        let quality = Bvh::build(&corners);
        let kept: Vec<u32> = (0..3_000).collect();
        let boxes: Vec<_> = corners.iter().map(|[a, b, c]| (a.min(*b).min(*c), a.max(*b).max(*c))).collect();
        let mut order = kept.clone();
        let mut tree = Vec::new();
        balanced(&boxes, &mut order, 0, &mut tree);
        let mut fold = Fold { corners: &corners, kept: &kept, boxes: &boxes, out: Bvh::default() };
        fold.fold(&tree, &order);
        let mut random = Random(4);
        for _ in 0..20_000 {
            let ray = Ray::new(random.point(), random.point());
            assert_eq!(quality.closest(ray, |_| true), fold.out.closest(ray, |_| true));
        }
    }
}
