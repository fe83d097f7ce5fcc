//! What shines on the objects, as a light.

use glam::Vec3;

use crate::bvh::Hit;
use crate::color::luminance;
use crate::sampling::{Discrete, unit};

/// The triangles of the objects that shine, chosen by the light they give: area times mean luminance.
#[derive(Debug)]
pub struct Emitters {
    triangles: Vec<u32>,
    choice: Discrete,
    /// Density of a point, for each triangle of the objects; empty where nothing shines.
    pdf: Vec<f32>,
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
}

impl Emitters {
    /// Of triangles given by their corners and the mean luminance of what they emit.
    pub fn new(corners: &[[Vec3; 3]], mean: impl Fn(u32) -> f32) -> Self {
        let (mut triangles, mut powers, mut areas) = (Vec::new(), Vec::new(), Vec::new());
        for (index, [a, b, c]) in corners.iter().enumerate() {
            let area = 0.5 * (*b - *a).as_dvec3().cross((*c - *a).as_dvec3()).length();
            let power = area * f64::from(mean(index as u32));
            if power > 0.0 && power.is_finite() {
                triangles.push(index as u32);
                powers.push(power);
                areas.push(area);
            }
        }
        let choice = Discrete::new(&powers).0;
        let mut pdf = vec![0.0; if triangles.is_empty() { 0 } else { corners.len() }];
        for (k, (&triangle, area)) in triangles.iter().zip(areas).enumerate() {
            pdf[triangle as usize] = (choice.probability(k) / area) as f32;
        }
        Self { triangles, choice, pdf }
    }

    /// Whether nothing shines.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Density of choosing a point of a triangle, by area.
    pub fn pdf(&self, triangle: u32) -> f32 {
        self.pdf.get(triangle as usize).copied().unwrap_or(0.0)
    }

    /// A point, from two pairs of 32-bit fractions; not to be asked for where nothing shines.
    pub fn sample(&self, corners: &[[Vec3; 3]], choice: u32, [u, v]: [u32; 2]) -> EmitterSample {
        let (k, _) = self.choice.sample(f64::from(choice) / 4_294_967_296.0);
        let triangle = self.triangles[k];
        let root = unit(u).sqrt();
        let (b1, b2) = (root * (1.0 - unit(v)), root * unit(v));
        let [a, b, c] = corners[triangle as usize];
        let position = a * (1.0 - b1 - b2) + b * b1 + c * b2;
        let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
        let hit = Hit { t: 0.0, triangle, b1, b2, back: false };
        EmitterSample { hit, position, normal, pdf: self.pdf(triangle) }
    }
}

/// Mean luminance of a triangle by a lattice of points of it.
pub fn mean_luminance(triangle: u32, emission: impl Fn(&Hit) -> Vec3) -> f32 {
    const N: u32 = 4;
    let mut sum = 0.0;
    for i in 0..N {
        for j in 0..N - i {
            let [b1, b2] = [i, j].map(|k| (k as f32 + 1.0 / 3.0) / N as f32);
            sum += luminance(emission(&Hit { t: 0.0, triangle, b1, b2, back: false }).to_array());
        }
    }
    sum / (N * (N + 1) / 2) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Points, stream};
    use crate::testing::chi_square;

    /// Chi-square of points against their density, by sixteenths of triangles of many sizes and strengths, some of which
    /// do not shine.
    /// Mutation: `root` to `unit(u)` in `Emitters::sample`, `/ area` left out of `Emitters::new` (each seen red).
    #[test]
    fn points_follow_their_density() {
        let corners: Vec<[Vec3; 3]> = (0..12)
            .map(|i| {
                let [[a, b], [c, d], [e, f]] = [0, 1, 2].map(|k| Points::new(3, i).pair(k));
                [Vec3::new(a, b, c), Vec3::new(d, e, f), Vec3::new(e, a, d) * 0.2 * i as f32]
            })
            .collect();
        let emitters = Emitters::new(&corners, |i| (i % 4) as f32);
        let n = 200_000;
        let mut counts = vec![0.0; 12 * 16];
        for i in 0..n {
            let points = Points::new(stream(2, i, 0), 0);
            let EmitterSample { hit, position, pdf, .. } =
                emitters.sample(&corners, points.bits(0)[0], points.bits(1));
            let [a, b, c] = corners[hit.triangle as usize];
            let weights = [1.0 - hit.b1 - hit.b2, hit.b1, hit.b2];
            assert!((a * weights[0] + b * weights[1] + c * weights[2] - position).length() < 1e-6);
            assert_eq!(pdf, emitters.pdf(hit.triangle));
            // A lattice of four to a side: two weights and whether the third falls short tell the small triangle.
            let [k, l, m] = weights.map(|w| ((4.0 * w) as usize).min(3));
            let row = 2 * l + usize::from(k + l + m == 2);
            counts[hit.triangle as usize * 16 + [0, 7, 12, 15][m] + row] += 1.0;
        }
        let area = |t: &[Vec3; 3]| f64::from(0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length());
        let expected = |(i, t)| [f64::from(n) * f64::from(emitters.pdf(i as u32)) * area(t) / 16.0; 16];
        let expected: Vec<f64> = corners.iter().enumerate().flat_map(expected).collect();
        assert!((expected.iter().sum::<f64>() / f64::from(n) - 1.0).abs() < 1e-4);
        let z = chi_square(&counts, &expected);
        assert!(z < 4.0, "{z}");
    }
}
