//! What shines on the objects, as a light.

use glam::Vec3;

use super::face::margin;
use crate::geometry::bvh::{Hit, Ray};
use crate::geometry::sampling::{Discrete, unit};
use crate::math::color::luminance;

/// The triangles of the objects that shine, in pieces, which are chosen by the light they give: area times mean luminance.
/// A triangle with a picture is cut by lattices of its weights, so that a small lamp of the picture is one.
#[derive(Debug)]
pub struct Emitters {
    /// Triangle and cell of each piece that shines.
    pieces: Vec<(u32, u32)>,
    choice: Discrete,
    /// Their areas times the mean luminance of what they emit, in all.
    pub power: f64,
    /// For each triangle of the objects its lattice; empty where nothing shines.
    lattices: Vec<Lattice>,
    /// Density of a point by area, for each cell of each lattice.
    pdf: Vec<f32>,
}

/// The cells of a triangle: two of each square of weights 1 and 2, so many squares a side; 0 where it does not shine.
#[derive(Debug, Clone, Copy, Default)]
struct Lattice {
    first: u32,
    side: u32,
}

/// Squares a side of lattices of many triangles.
pub const COARSE: u32 = 32;

/// Cells of a triangle that are few enough to be looked at by so many points a side.
const FEW: usize = 256;
const CLOSE: u32 = 16;

impl Lattice {
    /// The cell that holds a point.
    fn cell(&self, b1: f32, b2: f32) -> u32 {
        let side = self.side as f32;
        let (x, y) = ((b1 * side).max(0.0), (b2 * side).max(0.0));
        let [i, j] = [x, y].map(|v| (v as u32).min(self.side - 1));
        let upper = (x - i as f32) + (y - j as f32) > 1.0;
        2 * (i * self.side + j) + u32::from(upper)
    }

    /// The weights of a point of a cell, from those in a triangle.
    fn place(&self, cell: u32, [u, v]: [f32; 2]) -> [f32; 2] {
        let side = self.side as f32;
        let [i, j] = [cell / 2 / self.side, cell / 2 % self.side].map(|k| k as f32);
        if cell.is_multiple_of(2) {
            [(i + u) / side, (j + v) / side]
        } else {
            [(i + 1.0 - u) / side, (j + 1.0 - v) / side]
        }
    }

    /// The cells within the triangle: all but the upper ones on its long side and what is beyond.
    fn cells(self) -> impl Iterator<Item = u32> {
        let inside = move |cell: &u32| cell / 2 / self.side + cell / 2 % self.side + cell % 2 < self.side;
        (0..2 * self.side * self.side).filter(inside)
    }
}

/// A point that shines.
#[derive(Debug, Clone, Copy)]
pub struct EmitterSample {
    /// Where it is: the triangle and the weights of its vertices.
    pub hit: Hit,
    /// Position in the frame of the scene.
    pub position: Vec3,
    /// Unit normal of the triangle, by its winding.
    pub normal: Vec3,
    /// Density of choosing it, by area.
    pub pdf: f32,
    /// How far rays must stay off its triangle not to meet it: see [`margin`].
    margin: f32,
}

impl EmitterSample {
    /// The way from a start to just over this point, on the side of the start. It ends off the triangle by the rounding of
    /// both ends, as rays start off theirs: then it stays over the plane of the triangle, so that no facet beside it of a
    /// lamp that bulges is met, and what lies farther before it is.
    pub fn way(&self, start: Vec3) -> Ray {
        let off = self.margin + margin(&[start; 3]);
        let side = off.copysign((start - self.position).dot(self.normal));
        let to = self.position + self.normal * side - start;
        let distance = to.length();
        Ray { t_max: distance, ..Ray::new(start, to / distance.max(f32::MIN_POSITIVE)) }
    }
}

impl Emitters {
    /// Of triangles given by their corners, the squares a side of their lattices, and what they emit at a point, on the mean over
    /// a width as a share of the square root of twice the triangle's area.
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
            // Twice as wide as a cell, so that what spills over its edge is a lamp, too.
            let own = |cell| if lattice.side == 1 { mean } else { at(cell, [1.0 / 3.0; 2], 2.0) };
            let shines = |&(_, light): &(u32, f32)| light > 0.0 && light.is_finite();
            let mut lit: Vec<_> = lattice.cells().map(|cell| (cell, own(cell))).filter(shines).collect();
            if lattice.side > COARSE && lit.len() <= FEW {
                // A lamp among much that is dark: which cells it reaches into is looked at closely.
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

    /// Whether nothing shines.
    pub fn is_empty(&self) -> bool {
        self.pieces.is_empty()
    }

    /// Density of choosing a point of a triangle, by area.
    pub fn pdf(&self, hit: &Hit) -> f32 {
        match self.lattices.get(hit.triangle as usize) {
            Some(lattice) if lattice.side > 0 => {
                self.pdf[(lattice.first + lattice.cell(hit.b1, hit.b2)) as usize]
            }
            _ => 0.0,
        }
    }

    /// A point, from two pairs of 32-bit fractions; not to be asked for where nothing shines.
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

/// Mean luminance of a triangle by a lattice of points of it, each of which stands for a part so wide, as a share of the
/// square root of twice its area: between points there may be a small lamp, too.
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
    use crate::testing::chi_square;

    /// Chi-square of points against their density, by sixteenths of triangles of many sizes and strengths, some of which
    /// do not shine.
    /// Mutation: `root` to `unit(u)` in `Emitters::sample`, `/ area` left out of `Emitters::new` (each seen red when triangles were whole).
    #[test]
    fn points_follow_their_density() {
        let corners: Vec<[Vec3; 3]> = (0..12)
            .map(|i| {
                let [[a, b], [c, d], [e, f]] = [0, 1, 2].map(|k| Points::new(3, i).pair(k));
                [Vec3::new(a, b, c), Vec3::new(d, e, f), Vec3::new(e, a, d) * 0.2 * i as f32]
            })
            .collect();
        // Some in a lattice, with more light where the first weight is large.
        let emission = |hit: &Hit, _: f32| Vec3::splat((hit.triangle % 4) as f32 * (0.5 + hit.b1));
        let emitters = Emitters::new(&corners, |i| [1, 4, 8][i as usize % 3], emission);
        // A lattice of four to a side: two weights and whether the third falls short tell the small triangle.
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
            // But on the edge of a cell.
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
