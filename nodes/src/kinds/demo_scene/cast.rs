//! Ray casting against the quads of a demo place, by a small bounding volume hierarchy over their triangles.

use glam::DVec3;

use super::shape::Quad;

/// Intersection of a ray with the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    pub distance: f64,
    pub quad: u32,
    /// First coordinate of the point on the quad, 0 to 1.
    pub u: f64,
    /// Second coordinate of the point on the quad, 0 to 1.
    pub v: f64,
}

struct Triangle {
    origin: DVec3,
    a: DVec3,
    b: DVec3,
    quad: u32,
    upper: bool,
}

struct Node {
    low: DVec3,
    high: DVec3,
    /// Index of the first triangle of a leaf, or of the second child of a branch. The first child of a branch
    /// directly follows the branch.
    next: u32,
    /// Number of triangles of a leaf; 0 for a branch.
    count: u32,
}

/// Ray caster over the quads of a place.
pub(super) struct Caster {
    triangles: Vec<Triangle>,
    nodes: Vec<Node>,
}

const LEAF: usize = 4;
/// Number of levels of the hierarchy that can be walked.
const DEPTH: usize = 64;
const BINS: usize = 12;

impl Caster {
    /// Builds the hierarchy. Surfaces that rays do not hit, such as the view through a window, are left out.
    pub(super) fn new(quads: &[Quad]) -> Self {
        let mut triangles = Vec::with_capacity(quads.len() * 2);
        for (i, quad) in quads.iter().enumerate().filter(|(_, quad)| quad.paint.is_solid()) {
            let [p0, p1, p2, p3] = quad.p;
            for (origin, a, b, upper) in [(p0, p1, p3, false), (p2, p3, p1, true)] {
                if (a - origin).cross(b - origin).length_squared() > 1e-20 {
                    triangles.push(Triangle { origin, a: a - origin, b: b - origin, quad: i as u32, upper });
                }
            }
        }
        let mut caster = Self { triangles: Vec::new(), nodes: Vec::new() };
        let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
        let bounds: Vec<[DVec3; 2]> = triangles
            .iter()
            .map(|t| {
                let (p, q, r) = (t.origin, t.origin + t.a, t.origin + t.b);
                [p.min(q).min(r), p.max(q).max(r)]
            })
            .collect();
        // A work list instead of recursion; children are patched into their parent when made.
        let mut work = vec![(0, order.len(), None::<usize>)];
        while let Some((from, to, parent)) = work.pop() {
            let here = caster.nodes.len();
            if let Some(parent) = parent {
                caster.nodes[parent].next = here as u32;
            }
            let [low, high] = hull(order[from..to].iter().map(|&i| bounds[i as usize]));
            caster.nodes.push(Node { low, high, next: from as u32, count: (to - from) as u32 });
            if to - from > LEAF
                && let Some(middle) = split(&mut order[from..to], &bounds)
            {
                caster.nodes[here].count = 0;
                work.push((from + middle, to, Some(here)));
                work.push((from, from + middle, None));
            }
        }
        let mut slots: Vec<Option<Triangle>> = triangles.into_iter().map(Some).collect();
        caster.triangles = order.iter().filter_map(|&i| slots[i as usize].take()).collect();
        caster
    }

    /// Nearest hit of a ray within the distance `reach`; `None` if there is no hit.
    pub(super) fn nearest(&self, from: DVec3, toward: DVec3, reach: f64) -> Option<Hit> {
        let mut best = Hit { distance: reach, quad: u32::MAX, u: 0.0, v: 0.0 };
        self.walk(from, toward, &mut best, false);
        (best.quad != u32::MAX).then_some(best)
    }

    /// True if a ray hits a surface within the distance `reach`.
    pub(super) fn blocked(&self, from: DVec3, toward: DVec3, reach: f64) -> bool {
        let mut best = Hit { distance: reach, quad: u32::MAX, u: 0.0, v: 0.0 };
        self.walk(from, toward, &mut best, true);
        best.quad != u32::MAX
    }

    /// Visits the nearer child first. Of several hits at the same distance, that of the first triangle counts.
    fn walk(&self, from: DVec3, toward: DVec3, best: &mut Hit, any: bool) {
        let inverse = toward.recip();
        let (mut waiting, mut starts) = ([0_u32; DEPTH], [0.0; DEPTH]);
        let (mut depth, mut at, mut first) = (0, 0_usize, usize::MAX);
        let enters =
            |node: usize, reach: f64| self.nodes.get(node).and_then(|node| entry(node, from, inverse, reach));
        if enters(0, best.distance).is_none() {
            return;
        }
        loop {
            let node = &self.nodes[at];
            if node.count == 0 {
                let children = [at + 1, node.next as usize];
                match children.map(|child| enters(child, best.distance)) {
                    [Some(left), Some(right)] => {
                        let (near, far, start) = if right < left {
                            (children[1], children[0], left)
                        } else {
                            (children[0], children[1], right)
                        };
                        // The tree is at worst built by halving, so 64 levels are never reached.
                        if depth < DEPTH {
                            (waiting[depth], starts[depth]) = (far as u32, start);
                            depth += 1;
                        }
                        at = near;
                        continue;
                    }
                    [Some(_), None] => {
                        at = children[0];
                        continue;
                    }
                    [None, Some(_)] => {
                        at = children[1];
                        continue;
                    }
                    [None, None] => {}
                }
            }
            let leaf = node.next as usize..(node.next + node.count) as usize;
            for (index, triangle) in leaf.clone().zip(&self.triangles[leaf]) {
                if let Some((distance, u, v)) = triangle.meet(from, toward)
                    && (distance < best.distance
                        || (distance == best.distance && index < first && first != usize::MAX))
                {
                    let (u, v) = if triangle.upper { (1.0 - u, 1.0 - v) } else { (u, v) };
                    *best = Hit { distance, quad: triangle.quad, u, v };
                    first = index;
                    if any {
                        return;
                    }
                }
            }
            loop {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                let (node, start) = (waiting[depth], starts[depth]);
                if start <= best.distance * SLACK {
                    at = node as usize;
                    break;
                }
            }
        }
    }
}

/// Factor of distances for rounding.
const SLACK: f64 = 1.000_001;

/// Distance at which a ray enters a box, or 0 inside it. `None` if it does not meet the box within `reach`.
fn entry(node: &Node, from: DVec3, inverse: DVec3, reach: f64) -> Option<f64> {
    let (a, b) = ((node.low - from) * inverse, (node.high - from) * inverse);
    let (near, far) = (a.min(b), a.max(b));
    // Comparisons take fewer instructions than `min` and `max`, which handle NaN on both sides.
    let start = near.to_array().into_iter().fold(0.0, |start, near| if near > start { near } else { start });
    let end = far.to_array().into_iter().fold(reach, |end, far| if far < end { far } else { end });
    (start <= end * SLACK).then_some(start)
}

impl Triangle {
    // Moeller and Trumbore, Fast Minimum Storage Ray/Triangle Intersection, 1997.
    fn meet(&self, from: DVec3, toward: DVec3) -> Option<(f64, f64, f64)> {
        let p = toward.cross(self.b);
        let det = self.a.dot(p);
        if det == 0.0 {
            return None;
        }
        let inverse = 1.0 / det;
        let s = from - self.origin;
        let u = s.dot(p) * inverse;
        let q = s.cross(self.a);
        let v = toward.dot(q) * inverse;
        let distance = self.b.dot(q) * inverse;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > 0.0).then_some((distance, u, v))
    }
}

fn hull(boxes: impl Iterator<Item = [DVec3; 2]>) -> [DVec3; 2] {
    let empty = [DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY)];
    boxes.fold(empty, |[low, high], [l, h]| [low.min(l), high.max(h)])
}

/// Partitions `order` by the surface area heuristic, and returns the length of the first part. `None` if no plane
/// separates the centres of the triangles.
fn split(order: &mut [u32], bounds: &[[DVec3; 2]]) -> Option<usize> {
    let centre = |i: u32| bounds[i as usize][0] + bounds[i as usize][1];
    let [low, high] = hull(order.iter().map(|&i| [centre(i), centre(i)]));
    let area = |[l, h]: [DVec3; 2]| {
        let d = (h - l).max(DVec3::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    };
    let mut best = (f64::INFINITY, 0, 0);
    for axis in 0..3 {
        let size = high[axis] - low[axis];
        if size <= 0.0 {
            continue;
        }
        let bin = |i: u32| (((centre(i)[axis] - low[axis]) / size * BINS as f64) as usize).min(BINS - 1);
        for plane in 1..BINS {
            let half = |left: bool| order.iter().filter(move |&&i| (bin(i) < plane) == left);
            let cost = |left: bool| {
                let n = half(left).count();
                if n == 0 {
                    f64::INFINITY
                } else {
                    n as f64 * area(hull(half(left).map(|&i| bounds[i as usize])))
                }
            };
            let cost = cost(true) + cost(false);
            if cost < best.0 {
                best = (cost, axis, plane);
            }
        }
    }
    let (cost, axis, plane) = best;
    if !cost.is_finite() {
        return None;
    }
    let size = high[axis] - low[axis];
    let bin = |i: u32| (((centre(i)[axis] - low[axis]) / size * BINS as f64) as usize).min(BINS - 1);
    // Stable, so equal triangles keep their order.
    order.sort_by_key(|&i| bin(i) >= plane);
    Some(order.iter().filter(|&&i| bin(i) < plane).count())
}

#[cfg(test)]
mod tests {
    use super::super::random::unit;
    use super::super::shape::{Placement, Shapes};
    use super::*;

    #[test]
    fn the_hierarchy_finds_what_every_triangle_finds() {
        let mut shapes = Shapes::default();
        for i in 0..60 {
            let r = |d| unit(3, 1, i, d);
            let place = Placement::new(4.0 * r(0), 4.0 * r(1), 2.0 * r(2), 360.0 * r(3));
            let half = DVec3::new(0.05 + r(4), 0.02 + 0.3 * r(5), 0.1);
            shapes.cuboid(place, DVec3::ZERO, half, super::super::paint::Paint::Plain([0.5; 3]), false);
        }
        let caster = Caster::new(&shapes.quads);
        let mut hits = 0;
        for i in 0..2000 {
            let r = |d| unit(9, 2, i, d);
            let from = DVec3::new(4.0 * r(0), 4.0 * r(1), 2.0 * r(2));
            let toward =
                DVec3::new(r(3) - 0.5, r(4) - 0.5, if i % 5 == 0 { 0.0 } else { r(5) - 0.5 }).normalize();
            let found = caster.nearest(from, toward, 50.0);
            let all = caster.triangles.iter().filter_map(|t| t.meet(from, toward)).map(|h| h.0);
            let want = all.fold(f64::INFINITY, f64::min);
            assert_eq!(found.map_or(f64::INFINITY, |h| h.distance), want);
            assert_eq!(caster.blocked(from, toward, 50.0), found.is_some());
            hits += u32::from(found.is_some());
            if let Some(hit) = found {
                let on = shapes.quads[hit.quad as usize].point(hit.u, hit.v);
                assert!((on - (from + toward * hit.distance)).length() < 1e-9);
            }
        }
        assert!(hits > 500, "{hits}");
    }
}
