//! Emissive surfaces of objects as area lights.

use glam::Vec3;
use scene::math::color::luminance;

use super::face::margin;
use crate::geometry::bvh::{Hit, Ray};
use crate::geometry::sampling::{Discrete, unit};

/// Emissive triangles of the objects, in pieces that are sampled in proportion to area times mean luminance.
/// A textured triangle is divided into a lattice, so that a small bright spot of the texture becomes a piece.
#[derive(Debug)]
pub struct Emitters {
    /// Index of the triangle and index of the cell, for each emissive piece.
    pieces: Vec<(u32, u32)>,
    choice: Discrete,
    /// Sum over all pieces of area times mean luminance.
    pub power: f64,
    /// Lattice of each triangle of the objects; empty if no triangle is emissive.
    lattices: Vec<Lattice>,
    /// Probability density by area of each cell of each lattice.
    pdf: Vec<f32>,
}

/// Cells of a triangle: two per square of a lattice with `side` squares per edge. `side` is 0 for a triangle that
/// is not emissive.
#[derive(Debug, Clone, Copy, Default)]
struct Lattice {
    first: u32,
    side: u32,
}

/// Maximum number of squares per edge of a lattice in scenes with many emissive triangles.
pub const COARSE: u32 = 32;

/// If a fine lattice has at most this many bright cells, each of them is examined at more points.
const FEW: usize = 256;
/// Number of points along each edge of a bright cell at which the cell is examined.
const CLOSE: u32 = 16;

impl Lattice {
    /// Index of the cell that contains a point.
    fn cell(&self, b1: f32, b2: f32) -> u32 {
        let side = self.side as f32;
        let (x, y) = ((b1 * side).max(0.0), (b2 * side).max(0.0));
        let [i, j] = [x, y].map(|v| (v as u32).min(self.side - 1));
        let upper = (x - i as f32) + (y - j as f32) > 1.0;
        2 * (i * self.side + j) + u32::from(upper)
    }

    /// Barycentric weights of a point within the triangle, from its weights within a cell.
    fn place(&self, cell: u32, [u, v]: [f32; 2]) -> [f32; 2] {
        let side = self.side as f32;
        let [i, j] = [cell / 2 / self.side, cell / 2 % self.side].map(|k| k as f32);
        if cell.is_multiple_of(2) {
            [(i + u) / side, (j + v) / side]
        } else {
            [(i + 1.0 - u) / side, (j + 1.0 - v) / side]
        }
    }

    /// Indices of the cells inside the triangle. The upper cells on its long edge and all cells beyond it are
    /// outside.
    fn cells(self) -> impl Iterator<Item = u32> {
        let inside = move |cell: &u32| cell / 2 / self.side + cell / 2 % self.side + cell % 2 < self.side;
        (0..2 * self.side * self.side).filter(inside)
    }
}

/// Sampled point on an emitter.
#[derive(Debug, Clone, Copy)]
pub struct EmitterSample {
    /// Triangle and barycentric weights.
    pub hit: Hit,
    /// Position in the frame of the scene.
    pub position: Vec3,
    /// Unit normal of the triangle, by its winding.
    pub normal: Vec3,
    /// Probability density by area.
    pub pdf: f32,
    /// Offset of rays from the triangle; see [`margin`].
    margin: f32,
}

impl EmitterSample {
    /// Ray from `start` to just above the point, on the side of `start`. It ends above the triangle at a distance
    /// that covers the rounding errors of both ends, so it never crosses the plane of the triangle. It therefore
    /// does not hit neighbouring facets of a convex lamp, but does hit surfaces in front of the lamp.
    pub fn way(&self, start: Vec3) -> Ray {
        let off = self.margin + margin(&[start; 3]);
        let side = off.copysign((start - self.position).dot(self.normal));
        let to = self.position + self.normal * side - start;
        let distance = to.length();
        Ray { t_max: distance, ..Ray::new(start, to / distance.max(f32::MIN_POSITIVE)) }
    }
}

impl Emitters {
    /// Builds the distribution from the corners of all triangles, the lattice size per triangle, and the
    /// emission at a point averaged over a footprint (a share of the square root of twice the area of the
    /// triangle).
    pub fn new(
        corners: &[[Vec3; 3]],
        sides: impl Fn(u32) -> u32,
        emission: impl Fn(&Hit, f32) -> Vec3,
    ) -> Self {
        let (mut pieces, mut powers, mut areas) = (Vec::new(), Vec::new(), Vec::new());
        let (mut lattices, mut cells) = (vec![Lattice::default(); corners.len()], 0);
        for (index, [a, b, c]) in (0..).zip(corners) {
            let area = 0.5 * (*b - *a).as_dvec3().cross((*c - *a).as_dvec3()).length();
            let mean = mean_luminance(index, &emission);
            let power = area * f64::from(mean);
            if !(power > 0.0 && power.is_finite()) {
                continue;
            }
            let lattice = Lattice { first: cells, side: sides(index).max(1) };
            let size = area / f64::from(lattice.side * lattice.side);
            let at = |cell: u32, weights: [f32; 2], width: f32| {
                let [b1, b2] = lattice.place(cell, weights);
                let hit = Hit { t: 0.0, triangle: index, b1, b2, back: false };
                luminance(emission(&hit, width / lattice.side as f32).to_array())
            };
            // Twice as wide as a cell, so that light leaking over its edge is sampled too.
            let own = |cell| if lattice.side == 1 { mean } else { at(cell, [1.0 / 3.0; 2], 2.0) };
            let shines = |&(_, light): &(u32, f32)| light > 0.0 && light.is_finite();
            let mut lit: Vec<_> = lattice.cells().map(|cell| (cell, own(cell))).filter(shines).collect();
            if lattice.side > COARSE && lit.len() <= FEW {
                // A small lamp on a dark texture: the cells that it reaches are examined more finely.
                for (cell, light) in &mut lit {
                    let points = (0..CLOSE * CLOSE).filter(|k| k / CLOSE + k % CLOSE < CLOSE);
                    let place =
                        |k: u32| [k / CLOSE, k % CLOSE].map(|i| (i as f32 + 1.0 / 3.0) / CLOSE as f32);
                    let sum: f32 = points.clone().map(|k| at(*cell, place(k), 2.0 / CLOSE as f32)).sum();
                    *light = sum / points.count() as f32;
                }
                lit.retain(shines);
            }
            for (cell, light) in lit {
                pieces.push((index, cell));
                powers.push(size * f64::from(light));
                areas.push(size);
            }
            lattices[index as usize] = lattice;
            cells += 2 * lattice.side * lattice.side;
        }
        let (choice, power) = Discrete::new(&powers);
        let mut pdf = vec![0.0; cells as usize];
        for (k, (&(triangle, cell), area)) in pieces.iter().zip(areas).enumerate() {
            pdf[(lattices[triangle as usize].first + cell) as usize] = (choice.probability(k) / area) as f32;
        }
        if pieces.is_empty() {
            lattices.clear();
        }
        Self { pieces, choice, power, lattices, pdf }
    }

    /// True if there are no emitters.
    pub fn is_empty(&self) -> bool {
        self.pieces.is_empty()
    }

    /// Probability density by area with which the point of a hit is sampled.
    pub fn pdf(&self, hit: &Hit) -> f32 {
        match self.lattices.get(hit.triangle as usize) {
            Some(lattice) if lattice.side > 0 => {
                self.pdf[(lattice.first + lattice.cell(hit.b1, hit.b2)) as usize]
            }
            _ => 0.0,
        }
    }

    /// Samples a point from three 32-bit random numbers. There must be an emitter.
    pub fn sample(&self, corners: &[[Vec3; 3]], choice: u32, [u, v]: [u32; 2]) -> EmitterSample {
        let (k, _) = self.choice.sample(f64::from(choice) / 4_294_967_296.0);
        let (triangle, cell) = self.pieces[k];
        let lattice = self.lattices[triangle as usize];
        let root = unit(u).sqrt();
        let [b1, b2] = lattice.place(cell, [root * (1.0 - unit(v)), root * unit(v)]);
        let corners = &corners[triangle as usize];
        let &[a, b, c] = corners;
        let position = a * (1.0 - b1 - b2) + b * b1 + c * b2;
        let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
        let hit = Hit { t: 0.0, triangle, b1, b2, back: false };
        let pdf = self.pdf[(lattice.first + cell) as usize];
        EmitterSample { hit, position, normal, pdf, margin: margin(corners) }
    }
}

/// Mean luminance of a triangle, from the emission at a lattice of points. The emission at each point is averaged
/// over the part of the triangle around the point, so that a small bright spot between points is not missed.
fn mean_luminance(triangle: u32, emission: impl Fn(&Hit, f32) -> Vec3) -> f32 {
    const N: u32 = 4;
    let mut sum = 0.0;
    for i in 0..N {
        for j in 0..N - i {
            let [b1, b2] = [i, j].map(|k| (k as f32 + 1.0 / 3.0) / N as f32);
            let hit = Hit { t: 0.0, triangle, b1, b2, back: false };
            sum += luminance(emission(&hit, 1.0 / N as f32).to_array());
        }
    }
    sum / (N * (N + 1) / 2) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sampling::{Points, stream};
    use testing::chi_square;

    /// Chi-square test of sampled points against their density, over sixteenths of triangles of many sizes and
    /// radiances, some of them black. This test fails if `root` is replaced with `unit(u)` in `Emitters::sample`,
    /// or if `/ area` is left out of `Emitters::new`.
    #[test]
    fn points_follow_their_density() {
        let corners: Vec<[Vec3; 3]> = (0..12)
            .map(|i| {
                let [[a, b], [c, d], [e, f]] = [0, 1, 2].map(|k| Points::new(3, i).pair(k));
                [Vec3::new(a, b, c), Vec3::new(d, e, f), Vec3::new(e, a, d) * 0.2 * i as f32]
            })
            .collect();
        // Some triangles have a lattice, with more light where the first weight is large.
        let emission = |hit: &Hit, _: f32| Vec3::splat((hit.triangle % 4) as f32 * (0.5 + hit.b1));
        let emitters = Emitters::new(&corners, |i| [1, 4, 8][i as usize % 3], emission);
        // In a lattice of four per edge, two weights and whether the third is small identify the cell.
        let number = |weights: [f32; 3]| {
            let [k, l, m] = weights.map(|w| ((4.0 * w) as usize).min(3));
            [0, 7, 12, 15][m] + 2 * l + usize::from(k + l + m == 2)
        };
        let mut edges = 0;
        let n_on_edges = |edges: &mut u32| {
            *edges += 1;
            *edges < 100
        };
        let n = 200_000;
        let mut counts = vec![0.0; 12 * 16];
        for i in 0..n {
            let points = Points::new(stream(2, i, 0), 0);
            let EmitterSample { hit, position, pdf, .. } =
                emitters.sample(&corners, points.bits(0)[0], points.bits(1));
            let [a, b, c] = corners[hit.triangle as usize];
            let weights = [1.0 - hit.b1 - hit.b2, hit.b1, hit.b2];
            assert!((a * weights[0] + b * weights[1] + c * weights[2] - position).length() < 1e-6);
            // Except on the edge of a cell.
            assert!(pdf > 0.0 && (pdf == emitters.pdf(&hit) || n_on_edges(&mut edges)), "{hit:?}");
            counts[hit.triangle as usize * 16 + number(weights)] += 1.0;
        }
        let area = |t: &[Vec3; 3]| f64::from(0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length());
        // The density over a sixteenth, by a finer lattice.
        let within = |triangle: u32, sixteenth: usize| {
            let lattice = Lattice { first: 0, side: 16 };
            let each = lattice.cells().map(|cell| lattice.place(cell, [1.0 / 3.0; 2]));
            let own = each.filter(|&[b1, b2]| sixteenth == number([1.0 - b1 - b2, b1, b2]));
            let pdf =
                |[b1, b2]: [f32; 2]| f64::from(emitters.pdf(&Hit { t: 0.0, triangle, b1, b2, back: false }));
            own.map(pdf).sum::<f64>() / 256.0
        };
        let expected = |(i, t): (usize, &[Vec3; 3])| {
            let area = area(t);
            (0..16).map(move |k| (i as u32, k, area))
        };
        let expected: Vec<f64> = corners
            .iter()
            .enumerate()
            .flat_map(expected)
            .map(|(i, k, area)| f64::from(n) * within(i, k) * area)
            .collect();
        assert!((expected.iter().sum::<f64>() / f64::from(n) - 1.0).abs() < 1e-4);
        let z = chi_square(&counts, &expected);
        assert!(z < 4.0, "{z}");
    }
}
