//! Reduces the number of triangles within an error bound, by contracting edges (Garland and Heckbert 1997). The
//! cost of an edge is the mean squared distance of the new point from the planes of the triangles that it replaces,
//! weighted by area. Passes over all triangles contract edges up to a cost that grows from pass to pass; a priority
//! queue would need twice the time and memory. The surface does not fold over, and holes are not closed. The order
//! depends only on indices, so the result is the same on every machine.

use engine::{Context, NodeError};
use glam::{DMat3, DVec3};

use super::surface::Surface;
use super::tint::Seen;

/// Weight of a term that pulls a merged point to the midpoint of its edge in directions that the quadric does not
/// determine.
const TIDY: f64 = 1e-3;
/// Weight of an edge on the border of the surface, divided by the square of the length of the edge.
const BORDER: f64 = 10.0;
/// Minimum cosine between the normals of a triangle before and after a contraction.
const TURNED: f64 = 0.3;
/// Number of triangles between two checks for cancellation.
const CHECKED: usize = 1 << 12;
/// Shares of the maximum squared error that the first passes allow, one for each pass.
const SHARES: [f64; 5] = [0.0004, 0.004, 0.02, 0.1, 0.3];
/// Maximum number of further passes, which allow the whole maximum squared error.
const LAST_PASSES: usize = 6;

/// Weighted sum of squared distances from planes, as a function of the position x: `x.A x + 2 b.x + c`.
#[derive(Debug, Clone, Copy)]
struct Quadric {
    a: [f64; 6],
    b: DVec3,
    c: f64,
    weight: f64,
}

impl Quadric {
    const ZERO: Self = Self { a: [0.0; 6], b: DVec3::ZERO, c: 0.0, weight: 0.0 };

    fn plane(normal: DVec3, point: DVec3, weight: f64) -> Self {
        let (n, d) = (normal, -normal.dot(point));
        Self {
            a: [n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z].map(|v| v * weight),
            b: n * (d * weight),
            c: d * d * weight,
            weight,
        }
    }

    fn add(&mut self, other: &Self) {
        for (a, other) in self.a.iter_mut().zip(other.a) {
            *a += other;
        }
        self.b += other.b;
        self.c += other.c;
        self.weight += other.weight;
    }

    fn at(&self, x: DVec3) -> f64 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let ax = DVec3::new(
            xx * x.x + xy * x.y + xz * x.z,
            xy * x.x + yy * x.y + yz * x.z,
            xz * x.x + yz * x.y + zz * x.z,
        );
        (x.dot(ax) + 2.0 * self.b.dot(x) + self.c).max(0.0)
    }

    /// Position of the minimum, pulled slightly towards `middle`.
    fn least(&self, middle: DVec3) -> DVec3 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let tidy = TIDY * self.weight;
        let a = DMat3::from_cols(
            DVec3::new(xx + tidy, xy, xz),
            DVec3::new(xy, yy + tidy, yz),
            DVec3::new(xz, yz, zz + tidy),
        );
        let x = a.inverse() * (middle * tidy - self.b);
        if x.is_finite() { x } else { middle }
    }
}

/// Limits for the simplification around a point, given the level of the cell in which the point was made: the
/// maximum error and the maximum length of an edge, both in world units.
pub type Bounds<'a> = &'a dyn Fn(u8) -> (f64, f64);

struct Mesh<'a> {
    points: Vec<DVec3>,
    levels: Vec<u8>,
    seen: Vec<Seen>,
    quadrics: Vec<Quadric>,
    /// For each point, the indices of the triangles that contain it. Some of these triangles may have been removed.
    at: Vec<Vec<u32>>,
    triangles: Vec<[u32; 3]>,
    gone: Vec<bool>,
    bounds: Bounds<'a>,
}

impl Mesh<'_> {
    fn normal(&self, [a, b, c]: [u32; 3]) -> DVec3 {
        let [a, b, c] = [a, b, c].map(|i| self.points[i as usize]);
        (b - a).cross(c - a)
    }

    fn triangles_at(&self, point: u32) -> impl Iterator<Item = u32> {
        self.at[point as usize].iter().copied().filter(|t| !self.gone[*t as usize])
    }

    /// Writes the neighbours of a point to `to`, sorted. A neighbour appears once for each triangle that contains
    /// both points.
    fn around(&self, point: u32, to: &mut Vec<u32>) {
        to.clear();
        to.extend(
            self.triangles_at(point).flat_map(|t| self.triangles[t as usize]).filter(|other| *other != point),
        );
        to.sort_unstable();
    }

    /// True if the squared error of contracting an edge is at most `share` of the allowed squared error.
    fn is_cheap(&self, a: u32, b: u32, share: f64) -> bool {
        let (cost, place, _) = self.joined(a, b);
        let (error, _) = (self.bounds)(self.levels[a as usize].min(self.levels[b as usize]));
        cost <= share * error * error && place.is_finite()
    }

    fn joined(&self, a: u32, b: u32) -> (f64, DVec3, Quadric) {
        let mut quadric = self.quadrics[a as usize];
        quadric.add(&self.quadrics[b as usize]);
        let middle = (self.points[a as usize] + self.points[b as usize]) * 0.5;
        let place = quadric.least(middle);
        let cost = if quadric.weight > 0.0 { quadric.at(place) / quadric.weight } else { 0.0 };
        (cost, place, quadric)
    }

    /// Contracts an edge into its first point, unless the surface would fold or change its topology. Returns true
    /// if the edge was contracted.
    fn contract(&mut self, a: u32, b: u32, [around_a, around_b]: [&mut Vec<u32>; 2]) -> bool {
        self.around(a, around_a);
        self.around(b, around_b);
        let shared = around_a.iter().filter(|other| **other == b).count();
        if !(1..=2).contains(&shared) {
            return false;
        }
        // A point on the border has a neighbour with which it shares only one triangle.
        let on_border = |around: &[u32]| around.chunk_by(|x, y| x == y).any(|same| same.len() == 1);
        let manifold = |around: &[u32]| around.chunk_by(|x, y| x == y).all(|same| same.len() <= 2);
        if !manifold(around_a)
            || !manifold(around_b)
            || shared == 2 && on_border(around_a) && on_border(around_b)
        {
            return false;
        }
        around_a.dedup();
        around_b.dedup();
        let common = around_a.iter().filter(|other| around_b.binary_search(other).is_ok()).count();
        if common != shared {
            return false;
        }
        let (_, place, quadric) = self.joined(a, b);
        let level = self.levels[a as usize].min(self.levels[b as usize]);
        let (_, longest) = (self.bounds)(level);
        let far = |around: &[u32]| {
            around.iter().filter(|other| **other != a && **other != b).any(|other| {
                let before = (self.points[*other as usize] - self.points[a as usize])
                    .length()
                    .max((self.points[*other as usize] - self.points[b as usize]).length());
                let after = (self.points[*other as usize] - place).length();
                after > longest && after > before
            })
        };
        if far(around_a) || far(around_b) {
            return false;
        }
        for (point, other) in [(a, b), (b, a)] {
            for t in self.triangles_at(point) {
                let corners = self.triangles[t as usize];
                if corners.contains(&other) {
                    continue;
                }
                let [p, q, r] = corners.map(|i| if i == point { place } else { self.points[i as usize] });
                let (before, after) = (self.normal(corners), (q - p).cross(r - p));
                if before.dot(after) <= TURNED * before.length() * after.length() {
                    return false;
                }
            }
        }
        let at_b = std::mem::take(&mut self.at[b as usize]);
        for t in at_b {
            let corners = &mut self.triangles[t as usize];
            if self.gone[t as usize] {
                continue;
            }
            if corners.contains(&a) {
                self.gone[t as usize] = true;
            } else {
                corners.iter_mut().filter(|corner| **corner == b).for_each(|corner| *corner = a);
                self.at[a as usize].push(t);
            }
        }
        let gone = &self.gone;
        self.at[a as usize].retain(|t| !gone[*t as usize]);
        let share = self.quadrics[b as usize].weight / quadric.weight.max(f64::MIN_POSITIVE);
        self.seen[a as usize] = mixed(&self.seen[a as usize], &self.seen[b as usize], share as f32);
        self.points[a as usize] = place;
        self.quadrics[a as usize] = quadric;
        self.levels[a as usize] = level;
        true
    }
}

/// Interpolates between two points. The second point has the weight `share`.
fn mixed(a: &Seen, b: &Seen, share: f32) -> Seen {
    let mix = |a: f32, b: f32| a + (b - a) * share;
    Seen {
        colour: std::array::from_fn(|c| mix(a.colour[c], b.colour[c])),
        views: a.views.min(b.views),
        deviation: mix(a.deviation, b.deviation),
    }
}

/// Contracts edges, roughly in order of their cost, as long as the surface stays within the bounds.
pub fn simplified(
    surface: Surface,
    seen: Vec<Seen>,
    bounds: Bounds<'_>,
    cx: &Context,
) -> Result<(Surface, Vec<Seen>), NodeError> {
    let count = surface.points.len();
    let mut mesh = Mesh {
        points: surface.points.iter().map(|point| point.as_dvec3()).collect(),
        levels: surface.levels,
        seen,
        quadrics: vec![Quadric::ZERO; count],
        at: vec![Vec::new(); count],
        gone: vec![false; surface.triangles.len()],
        triangles: surface.triangles,
        bounds,
    };
    let mut edges: Vec<[u32; 3]> = Vec::with_capacity(3 * mesh.triangles.len());
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let normal = mesh.normal(*corners);
        let length = normal.length();
        if length > 0.0 {
            let plane = Quadric::plane(normal / length, mesh.points[corners[0] as usize], length / 6.0);
            corners.iter().for_each(|corner| mesh.quadrics[*corner as usize].add(&plane));
        }
        for i in 0..3 {
            mesh.at[corners[i] as usize].push(t as u32);
            let (a, b) = (corners[i], corners[(i + 1) % 3]);
            edges.push([a.min(b), a.max(b), t as u32]);
        }
    }
    edges.sort_unstable();
    let same_edge = |a: &[u32; 3], b: &[u32; 3]| a[..2] == b[..2];
    for same in edges.chunk_by(same_edge).filter(|same| same.len() == 1) {
        let [a, b, t] = same[0];
        let along = mesh.points[b as usize] - mesh.points[a as usize];
        let side = along.cross(mesh.normal(mesh.triangles[t as usize]));
        if side.length() > 0.0 {
            let mut wall =
                Quadric::plane(side.normalize(), mesh.points[a as usize], BORDER * along.length_squared());
            wall.weight = 0.0;
            mesh.quadrics[a as usize].add(&wall);
            mesh.quadrics[b as usize].add(&wall);
        }
    }
    drop(edges);
    let (mut around_a, mut around_b) = (Vec::new(), Vec::new());
    for share in SHARES.iter().copied().chain(std::iter::repeat_n(1.0, LAST_PASSES)) {
        let (mut contracted, mut left) = (0, 0);
        for t in 0..mesh.triangles.len() {
            if t % CHECKED == 0 {
                cx.check()?;
            }
            if mesh.gone[t] {
                continue;
            }
            left += 1;
            for i in 0..3 {
                let [a, b] = [mesh.triangles[t][i], mesh.triangles[t][(i + 1) % 3]];
                let (a, b) = (a.min(b), a.max(b));
                if mesh.is_cheap(a, b, share) && mesh.contract(a, b, [&mut around_a, &mut around_b]) {
                    contracted += 1;
                    break;
                }
            }
        }
        // Another pass at the full error is useful only if the last one contracted edges.
        if share == 1.0 && contracted * 100 < left {
            break;
        }
    }
    let Mesh { points, levels, seen, triangles, gone, .. } = mesh;
    let mut surface = Surface {
        points: points.into_iter().map(|point| point.as_vec3()).collect(),
        levels,
        triangles: triangles.into_iter().zip(gone).filter(|(_, gone)| !gone).map(|(t, _)| t).collect(),
    };
    let kept = surface.compact();
    Ok((surface, kept.into_iter().map(|i| seen[i as usize]).collect()))
}
