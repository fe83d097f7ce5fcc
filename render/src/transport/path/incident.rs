//! Distribution of the directions from which surfaces light a place.
//!
//! Scattered rays that follow it find bright surfaces, such as a patch of sun on a floor, more often than rays by the
//! cosine alone. Half of the rays keep the cosine, so no direction is left out and no weight exceeds twice the usual one.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use crate::geometry::sampling::{Points, circle, fraction};
use crate::transport::bsdf::{Matte, Scatter};

/// Number of bands of equal height between -z and +z.
const ROWS: usize = 8;
/// Number of sectors of each band. [`sector`] is written for 16.
const SECTORS: usize = 16;
/// Number of bins, which all have the same solid angle.
const BINS: usize = ROWS * SECTORS;
/// Share of the rays that follow the cosine.
const COSINE: f32 = 0.5;
/// Tangent of the angle of a sector.
const TANGENT: f32 = 0.414_213_56;

/// Distribution of directions, constant over each bin of directions.
#[derive(Debug, Clone)]
pub(crate) struct IncidentLight {
    /// Cumulative probabilities of the bins.
    cumulative: [f64; BINS],
    /// Densities per steradian.
    pdfs: [f32; BINS],
}

/// Sector that contains a direction around z. The sectors start at multiples of a sixteenth of a turn from x.
fn sector(x: f32, y: f32) -> usize {
    let (ax, ay) = (x.abs(), y.abs());
    let quarter = match ay <= ax {
        true => usize::from(ay >= TANGENT * ax),
        false => 3 - usize::from(ax > TANGENT * ay),
    };
    match (x >= 0.0, y >= 0.0) {
        (true, true) => quarter,
        (false, true) => 7 - quarter,
        (false, false) => 8 + quarter,
        (true, false) => 15 - quarter,
    }
}

/// Bin that contains a unit direction.
fn bin(direction: Vec3) -> usize {
    let row = ((direction.z + 1.0) * (0.5 * ROWS as f32)) as usize;
    row.min(ROWS - 1) * SECTORS + sector(direction.x, direction.y)
}

impl IncidentLight {
    /// Computes the distribution from cosine-distributed directions and the light that arrives from each. `None` if no
    /// light arrives.
    pub(crate) fn new(found: impl Iterator<Item = (Vec3, f32)>) -> Option<Self> {
        let mut sums = [0.0_f64; BINS];
        for (direction, light) in found {
            sums[bin(direction)] += f64::from(light);
        }
        // Few rays leave gaps, so each bin shares half of its light with its neighbours.
        let at = |row: usize, column: usize| sums[row * SECTORS + column % SECTORS];
        let spread = |k: usize| {
            let (row, column) = (k / SECTORS, k % SECTORS);
            let below = at(row.saturating_sub(1), column);
            let above = at((row + 1).min(ROWS - 1), column);
            let around = at(row, column + 1) + at(row, column + SECTORS - 1) + below + above;
            0.5 * sums[k] + 0.125 * around
        };
        let weights: [f64; BINS] = std::array::from_fn(spread);
        let total: f64 = weights.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let (mut cumulative, mut sum) = ([1.0; BINS], 0.0);
        for (to, weight) in cumulative.iter_mut().zip(&weights) {
            sum += weight / total;
            *to = sum;
        }
        // Rounding must not leave a number without a bin.
        let last = weights.iter().rposition(|weight| *weight > 0.0)?;
        cumulative[last..].fill(1.0);
        let density = BINS as f64 / (4.0 * f64::from(PI));
        Some(Self { cumulative, pdfs: weights.map(|weight| (weight / total * density) as f32) })
    }

    /// Samples an incident direction of a matte surface; see [`Matte::sample`]. `None` if the direction is below the
    /// surface.
    pub(crate) fn sample(&self, matte: &Matte, points: &Points, pair: u32) -> Option<(Vec3, Scatter)> {
        let [a, b] = points.bits(pair).map(fraction);
        let share = f64::from(COSINE);
        let direction = match a < share {
            true => matte.direction([(a / share) as f32, b as f32])?,
            false => self.direction([(a - share) / (1.0 - share), b]),
        };
        let scatter = matte.eval(direction);
        let pdf = COSINE * direction.dot(matte.normal()).max(0.0) * FRAC_1_PI
            + (1.0 - COSINE) * self.pdfs[bin(direction)];
        (scatter.pdf > 0.0 && scatter.value.is_finite())
            .then_some((direction, Scatter { value: scatter.value, pdf }))
    }

    /// Direction of a bin, by two numbers in [0, 1).
    fn direction(&self, [u, v]: [f64; 2]) -> Vec3 {
        let bin = self.cumulative.partition_point(|&c| c <= u).min(BINS - 1);
        let low = if bin > 0 { self.cumulative[bin - 1] } else { 0.0 };
        let width = self.cumulative[bin] - low;
        let within = if width > 0.0 { ((u - low) / width).clamp(0.0, 1.0 - f64::EPSILON) } else { 0.5 };
        let (row, column) = (bin / SECTORS, bin % SECTORS);
        let z = ((row as f64 + v) * (2.0 / ROWS as f64) - 1.0) as f32;
        let (sin, cos) = circle(((column as f64 + within) / SECTORS as f64) as f32);
        let radius = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(radius * cos, radius * sin, z).normalize_or_zero()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sampling::stream;
    use testing::{chi_square, direction};

    fn cosine(normal: Vec3, i: u32) -> Vec3 {
        let matte = Matte::new(normal, Vec3::ONE);
        matte.sample(&Points::new(stream(3, 1, 2), i), 0).map_or(normal, |(direction, _)| direction)
    }

    /// Directions are sampled with the stated density: the share of the samples in each bin is its integral, and the
    /// mean of value over density is the albedo.
    #[test]
    fn directions_have_the_stated_density() {
        let normal = Vec3::new(0.48, 0.6, 0.64);
        let patch = |d: Vec3| if d.dot(Vec3::new(0.6, 0.0, 0.8)) > 0.9 { 20.0 } else { 0.3 };
        let found = (0..500).map(|i| cosine(normal, i)).map(|d| (d, patch(d)));
        let incident = IncidentLight::new(found).expect("light");
        let matte = Matte::new(normal, Vec3::splat(0.7));
        let n = 200_000;
        let (mut counts, mut mean) = ([0.0; BINS], 0.0);
        for i in 0..n {
            let points = Points::new(stream(5, i, 0), 0);
            if let Some((direction, scatter)) = incident.sample(&matte, &points, 4) {
                counts[bin(direction)] += 1.0;
                mean += f64::from(scatter.value.x / scatter.pdf);
                assert!(scatter.value.x <= 2.001 * 0.7 * scatter.pdf);
            }
        }
        mean /= f64::from(n);
        assert!((mean - 0.7).abs() < 0.01, "{mean}");
        // The expected share of each bin, integrated over even directions.
        let (mut expected, steps) = ([0.0; BINS], 400_000);
        for i in 0..steps {
            let even = direction(Points::new(stream(6, 0, 0), i).pair(0));
            if even.dot(normal) > 0.0 {
                let pdf = 0.5 * even.dot(normal) * FRAC_1_PI + 0.5 * incident.pdfs[bin(even)];
                expected[bin(even)] += f64::from(pdf * 4.0 * PI) * f64::from(n) / f64::from(steps);
            }
        }
        let pairs = counts.iter().zip(&expected).filter(|(_, expected)| **expected > 50.0);
        let (counts, expected): (Vec<f64>, Vec<f64>) = pairs.unzip();
        assert!(counts.len() > 40);
        let z = chi_square(&counts, &expected);
        assert!(z < 5.0, "{z}");
    }

    /// No light gives no distribution.
    #[test]
    fn no_light_gives_no_distribution() {
        assert!(IncidentLight::new((0..100).map(|i| (cosine(Vec3::Z, i), 0.0))).is_none());
        assert!(IncidentLight::new(std::iter::empty()).is_none());
    }
}
