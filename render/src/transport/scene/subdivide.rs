//! Subdivision of large triangles, so that single precision suffices for their visible parts.
//!
//! The error of the ray-triangle test is in proportion to the largest coordinate of the corners, wherever on the
//! triangle the hit lies. On a floor of two triangles a kilometre wide, a shadow would start centimetres from its
//! object. So edges are halved, in double precision, until the length `L` of each satisfies
//!
//! `L <= d / 2 + 16 h`
//!
//! where d is the distance of the edge from the origin and h the distance of the whole mesh from the origin. A hit
//! at distance t >= h lies within 0.87 L of the longest edge of its triangle, so `d <= t + 0.87 L`, `L < 30 t`, and
//! every corner is less than 31 t from the origin: errors depend on the position of a hit, not on the size of its
//! triangle. Whether an edge is halved depends only on its two ends, so neighbouring triangles are divided alike
//! and no gap opens between them.

use glam::{DVec3, Vec3};

/// Coefficient of `d` in the maximum length of an edge, where `d` is the distance of the edge from the origin.
const SHARE: f64 = 0.5;
/// Coefficient of `h` in the maximum length of an edge, where `h` is the distance of the mesh from the origin.
const NEAREST: f64 = 16.0;
/// Length below which edges are never halved, as a share of the distance of the farthest corner from the origin. It
/// limits the subdivision if the origin lies on the mesh.
const FINEST: f64 = 1.0 / 1_099_511_627_776.0;
/// Number of cuts that are allowed in addition to twice the number of triangles. When they are used up, for
/// instance by a mesh of long needles, no further edges are halved.
const MOST: usize = 1 << 17;

/// Position of a corner relative to the origin, and its colour.
pub type Corner = (DVec3, Vec3);

/// Minimum and maximum distance from the origin to the triangles of a mesh, and the number of triangles.
#[derive(Debug, Clone, Copy)]
pub struct Extent {
    near: f64,
    far: f64,
    count: usize,
}

/// Rule by which edges are halved.
#[derive(Debug, Clone)]
pub struct Subdivision {
    least: f64,
    room: usize,
}

/// Distance from the origin to a segment. Swapping the ends of the segment does not change a bit of the result.
fn distance_to_segment(a: DVec3, b: DVec3) -> f64 {
    // Otherwise rounding would depend on the winding.
    let (a, b) = if a.to_array() <= b.to_array() { (a, b) } else { (b, a) };
    let way = b - a;
    let square = way.length_squared();
    let along = if square > 0.0 { (-a.dot(way) / square).clamp(0.0, 1.0) } else { 0.0 };
    (a + way * along).length()
}

/// Distance from the origin to a triangle.
fn distance_to_triangle([a, b, c]: [DVec3; 3]) -> f64 {
    let normal = (b - a).cross(c - a);
    let over = [(a, b), (b, c), (c, a)].iter().all(|(p, q)| p.cross(*q).dot(normal) > 0.0);
    if over {
        a.dot(normal).abs() / normal.length()
    } else {
        distance_to_segment(a, b).min(distance_to_segment(b, c)).min(distance_to_segment(c, a))
    }
}

/// True if a triangle has finite corners and a non-zero area.
fn is_real([a, b, c]: [DVec3; 3]) -> bool {
    let square = (b - a).cross(c - a).length_squared();
    square > 0.0 && square.is_finite()
}

impl Extent {
    /// Computes the extent of triangles, given relative to the origin. Triangles without area are ignored.
    pub fn of(triangles: impl Iterator<Item = [DVec3; 3]>) -> Self {
        let (mut near, mut far, mut count) = (f64::INFINITY, 0.0_f64, 0_usize);
        for triangle in triangles.filter(|t| is_real(*t)) {
            near = near.min(distance_to_triangle(triangle));
            far = triangle.iter().fold(far, |far, p| far.max(p.length()));
            count += 1;
        }
        Self { near, far, count }
    }

    /// Combines the extents of two sets of triangles.
    pub fn with(self, other: Self) -> Self {
        let (near, far) = (self.near.min(other.near), self.far.max(other.far));
        Self { near, far, count: self.count + other.count }
    }
}

impl Subdivision {
    /// Computes the rule for a mesh with this extent.
    pub fn of(extent: Extent) -> Self {
        let Extent { near, far, count } = extent;
        Self { least: (NEAREST * near).max(FINEST * far), room: 2 * count + MOST }
    }

    /// Number of cuts that are left; 0 if the limit has been reached.
    pub fn room(&self) -> usize {
        self.room
    }

    fn is_long(&self, a: DVec3, b: DVec3) -> bool {
        let length = (b - a).length();
        // Most edges end here.
        length > self.least && length > self.least + SHARE * distance_to_segment(a, b)
    }

    /// Passes a triangle, or its pieces, to `keep`.
    pub fn cut(&mut self, triangle: [Corner; 3], mut keep: impl FnMut([Corner; 3])) {
        if !is_real(triangle.map(|(p, _)| p)) {
            return keep(triangle);
        }
        let half = |a: Corner, b: Corner| ((a.0 + b.0) * 0.5, (a.1 + b.1) * 0.5);
        let mut open = vec![triangle];
        while let Some([a, b, c]) = open.pop() {
            let long = [(a, b), (b, c), (c, a)].map(|(p, q)| self.room > 0 && self.is_long(p.0, q.0));
            // Rotated so that the edges to be halved come first.
            let ([a, b, c], cuts) = match long {
                [false, false, false] => {
                    keep([a, b, c]);
                    continue;
                }
                [true, true, true] => ([a, b, c], 3),
                [true, true, false] => ([a, b, c], 2),
                [false, true, true] => ([b, c, a], 2),
                [true, false, true] => ([c, a, b], 2),
                [true, false, false] => ([a, b, c], 1),
                [false, true, false] => ([b, c, a], 1),
                [false, false, true] => ([c, a, b], 1),
            };
            self.room = self.room.saturating_sub(cuts);
            let (m, n) = (half(a, b), half(b, c));
            match cuts {
                1 => open.extend([[a, m, c], [m, b, c]]),
                2 => {
                    // The rest is a quadrilateral, divided by its shorter diagonal.
                    let rest = if (n.0 - a.0).length_squared() <= (c.0 - m.0).length_squared() {
                        [[a, m, n], [a, n, c]]
                    } else {
                        [[a, m, c], [m, n, c]]
                    };
                    open.push([m, b, n]);
                    open.extend(rest);
                }
                _ => {
                    let o = half(c, a);
                    open.extend([[a, m, o], [m, b, n], [o, n, c], [m, n, o]]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graded(triangles: &[[DVec3; 3]]) -> Vec<[Corner; 3]> {
        let mut grade = Subdivision::of(Extent::of(triangles.iter().copied()));
        let mut pieces = Vec::new();
        for triangle in triangles {
            grade.cut(triangle.map(|p| (p, p.as_vec3())), |piece| pieces.push(piece));
        }
        pieces
    }

    fn area(triangles: impl Iterator<Item = [DVec3; 3]>) -> f64 {
        triangles.map(|[a, b, c]| (b - a).cross(c - a).length()).sum()
    }

    /// Square floor below the origin.
    fn floor(half: f64, below: f64) -> Vec<[DVec3; 3]> {
        let [a, b, c, d] = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| DVec3::new(x * half, y * half, -below));
        vec![[a, b, c], [a, c, d]]
    }

    #[test]
    fn pieces_cover_the_whole_and_are_as_small_as_they_are_near() {
        let tilted =
            floor(3e5, 0.7).iter().map(|t| t.map(|p| p + DVec3::Z * (0.31 * p.x - 0.12 * p.y))).collect();
        for whole in [floor(1e6, 1.5), floor(100.0, 2.5), floor(1e7, 1e-3), tilted] {
            let pieces = graded(&whole);
            let extent = whole[0][0].length();
            let (was, is) = (area(whole.iter().copied()), area(pieces.iter().map(|t| t.map(|(p, _)| p))));
            assert!((is / was - 1.0).abs() < 1e-9, "{is} {was}");
            assert!(pieces.len() < 3000, "{}", pieces.len());
            for piece in &pieces {
                let corners = piece.map(|(p, _)| p);
                let far = corners.iter().map(|p| p.length()).fold(0.0, f64::max);
                assert!(far <= 31.0 * distance_to_triangle(corners), "{corners:?}");
                // The colours are the positions, which are linear over the triangle, in single precision.
                let off = piece.map(|(p, colour)| (p - colour.as_dvec3()).length());
                assert!(off.iter().all(|off| *off <= 1e-6 * extent), "{off:?}");
            }
        }
    }

    #[test]
    fn neighbours_are_cut_alike() {
        let pieces = graded(&floor(1e5, 2.0));
        let bits = |p: DVec3| p.to_array().map(f64::to_bits);
        let mut edges = std::collections::BTreeMap::new();
        for [a, b, c] in pieces.iter().map(|t| t.map(|(p, _)| bits(p))) {
            for (p, q) in [(a, b), (b, c), (c, a)] {
                *edges.entry((p.min(q), p.max(q))).or_insert(0) += 1;
            }
        }
        let outer = 1e5;
        for ((p, q), count) in edges {
            let rim = (0..2).any(|k| p[k] == q[k] && f64::from_bits(p[k]).abs() >= outer);
            assert_eq!(count, if rim { 1 } else { 2 }, "{:?}", [p, q].map(|v| v.map(f64::from_bits)));
        }
    }

    #[test]
    fn what_is_small_or_broken_stays_as_it_is() {
        let near = floor(5.0, 1.0);
        assert_eq!(graded(&near).len(), 2);
        let broken = [DVec3::X * f64::NAN, DVec3::X, DVec3::Y];
        let flat = [DVec3::X * 1e6, DVec3::X * -1e6, DVec3::X * 3e6];
        assert_eq!(graded(&[broken, flat, near[0]]).len(), 3);
        // A stray triangle has no effect, and an origin on the mesh terminates.
        let mut stray = floor(5.0, 1.0);
        stray.push([DVec3::splat(1e8), DVec3::new(1e8, 1e8 + 1.0, 1e8), DVec3::new(1e8, 1e8, 1e8 + 1.0)]);
        assert_eq!(graded(&stray).len(), 3);
        assert!(graded(&floor(1e6, 0.0)).len() < 6000);
        // Needles through the origin respect the limit of pieces.
        let needles: Vec<_> = (0..3000)
            .map(|i| {
                let x = f64::from(i) * 1e-7;
                [DVec3::new(x, -1e6, 0.0), DVec3::new(x, 1e6, 0.0), DVec3::new(x + 1e-7, 0.0, 0.0)]
            })
            .collect();
        assert!(graded(&needles).len() < 4 * 3000 + 2 * MOST);
    }
}
