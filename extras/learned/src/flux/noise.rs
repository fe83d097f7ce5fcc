//! Random numbers that are each computed from a seed and an index, so that the noise depends neither on the machine
//! nor on the order of computation.

use candle_core::{Device, Tensor};

use super::error::Result;

/// Hash of three numbers, uniform over all 64-bit values. It uses the finaliser of SplitMix64 (Steele et al. 2014).
fn mixed(seed: u64, stream: u64, index: u64) -> u64 {
    let mut x = seed;
    for part in [stream, index] {
        x = x.wrapping_add(0x9e37_79b9_7f4a_7c15).wrapping_add(part.wrapping_mul(0xd134_2543_de82_ef95));
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^= x >> 31;
    }
    x
}

/// Returns a random number, uniform in (0, 1).
pub fn uniform(seed: u64, stream: u64, index: u64) -> f64 {
    ((mixed(seed, stream, index) >> 12) as f64 + 0.5) / (1_u64 << 52) as f64
}

/// Returns a random number with the standard normal distribution (Box and Muller 1958; only one number of each pair
/// is used).
pub fn normal(seed: u64, stream: u64, index: u64) -> f64 {
    let radius = (-2.0 * libm::log(uniform(seed, stream, 2 * index))).sqrt();
    radius * libm::cos(std::f64::consts::TAU * uniform(seed, stream, 2 * index + 1))
}

/// A tensor of standard normal random numbers in f32. Different pairs of `seed` and `stream` give different
/// numbers.
pub fn normals(seed: u64, stream: u64, shape: (usize, usize, usize), device: &Device) -> Result<Tensor> {
    let count = shape.0 * shape.1 * shape.2;
    let values: Vec<f32> = (0..count as u64).map(|i| normal(seed, stream, i) as f32).collect();
    Ok(Tensor::from_vec(values, shape, device)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    // The seed is fixed, so the outcome does not depend on chance. The bounds are five standard errors.
    #[test]
    fn numbers_are_normal_and_streams_independent() {
        const N: u64 = 40_000;
        let mean = |f: &dyn Fn(u64) -> f64| (0..N).map(f).sum::<f64>() / N as f64;
        let error = 5.0 / (N as f64).sqrt();
        assert!(mean(&|i| normal(7, 0, i)).abs() < error);
        assert!((mean(&|i| normal(7, 0, i).powi2()) - 1.0).abs() < error * 2_f64.sqrt());
        assert!((mean(&|i| normal(7, 0, i).powi2().powi2()) - 3.0).abs() < error * 96_f64.sqrt());
        assert!(mean(&|i| normal(7, 0, i) * normal(7, 0, i + 1)).abs() < error);
        assert!(mean(&|i| normal(7, 0, i) * normal(7, 1, i)).abs() < error);
        assert!(mean(&|i| normal(7, 0, i) * normal(8, 0, i)).abs() < error);
        assert_eq!(normal(7, 3, 11).to_bits(), normal(7, 3, 11).to_bits());
    }

    trait Square {
        fn powi2(self) -> Self;
    }
    impl Square for f64 {
        fn powi2(self) -> Self {
            self * self
        }
    }
}
