//! Helpers of the unit tests of several crates. This crate uses none of the crates that these tests are for.

use engine::{Context, Scene, Up};
use fearless_simd::Level;
use glam::Vec3;

#[path = "../../../tests/extremes/row.rs"]
mod row;

pub use row::row;

/// A context outside any run: z up, metres, seed 7.
pub fn context() -> Context {
    Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7, exhaustive: false }, ".")
}

/// Every set of vector instructions that this machine supports.
pub fn levels() -> Vec<Level> {
    let best = Level::new();
    let mut levels = vec![Level::baseline()];
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(best.as_sse2().map(Level::Sse2));
        levels.extend(best.as_sse4_2().map(Level::Sse4_2));
        levels.extend(best.as_avx2().map(Level::Avx2));
        levels.extend(best.as_avx512().map(Level::Avx512));
    }
    levels.push(best);
    levels
}

/// The unit direction that belongs to two numbers from 0 to 1. Uniformly distributed numbers give uniformly
/// distributed directions.
pub fn direction([u, v]: [f32; 2]) -> Vec3 {
    let (z, (sin, cos)) = (1.0 - 2.0 * v, circle(u));
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * cos, r * sin, z)
}

/// Pearson's chi-square statistic of `counts` and `expected` counts, converted to standard deviations of a normal
/// distribution (Wilson and Hilferty 1931). One in 30,000 correct samplers exceeds 4. Bins with an expected count
/// below 5 are merged with other bins.
pub fn chi_square(counts: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(counts.len(), expected.len());
    let (mut rare, mut sum, mut bins) = ([0.0; 2], 0.0, 0.0);
    let mut add = |count: f64, expected: f64| {
        sum += (count - expected) * (count - expected) / expected;
        bins += 1.0;
    };
    for (&count, &expected) in counts.iter().zip(expected) {
        if expected >= 5.0 {
            add(count, expected);
        } else {
            rare = [rare[0] + count, rare[1] + expected];
        }
    }
    // Outcomes with an expected count of 0 must not occur.
    if rare[0] > 0.0 || rare[1] >= 5.0 {
        add(rare[0], rare[1].max(1e-9));
    }
    let spread = 2.0 / (9.0 * bins);
    (libm::pow(sum / bins, 1.0 / 3.0) - (1.0 - spread)) / spread.sqrt()
}

/// Bins of equal solid angle over the sphere: rings by height, each divided into sectors.
#[derive(Clone, Copy)]
pub struct SphereBins {
    /// Number of rings.
    pub rings: usize,
    /// Number of sectors of each ring.
    pub sectors: usize,
}

impl SphereBins {
    /// Number of bins.
    pub fn count(self) -> usize {
        self.rings * self.sectors
    }

    /// The bin of a unit direction.
    pub fn of(self, d: Vec3) -> usize {
        let turns = 0.5 + libm::atan2(f64::from(d.y), f64::from(d.x)) / std::f64::consts::TAU;
        let [ring, sector] = [(0.5 * (f64::from(d.z) + 1.0), self.rings), (turns, self.sectors)]
            .map(|(at, count)| ((at * count as f64) as usize).min(count - 1));
        ring * self.sectors + sector
    }

    /// The integrals of `N` densities over each bin, computed from `fine` x `fine` points per bin.
    pub fn integrals<const N: usize>(self, fine: usize, pdf: impl Fn(Vec3) -> [f32; N]) -> [Vec<f64>; N] {
        let mut sums = std::array::from_fn(|_| vec![0.0; self.count()]);
        let [rings, sectors] = [self.rings * fine, self.sectors * fine];
        let area = 4.0 * std::f64::consts::PI / (rings * sectors) as f64;
        for ring in 0..rings {
            let z = 2.0 * (ring as f32 + 0.5) / rings as f32 - 1.0;
            let radius = (1.0 - z * z).sqrt();
            for sector in 0..sectors {
                let (sin, cos) = circle((sector as f32 + 0.5) / sectors as f32);
                let d = Vec3::new(radius * cos, radius * sin, z);
                for (sums, pdf) in sums.iter_mut().zip(pdf(d)) {
                    sums[self.of(d)] += f64::from(pdf) * area;
                }
            }
        }
        sums
    }
}

/// Sine and cosine of a number of turns.
fn circle(turns: f32) -> (f32, f32) {
    let (sin, cos) = libm::sincos(std::f64::consts::TAU * f64::from(turns));
    (sin as f32, cos as f32)
}
