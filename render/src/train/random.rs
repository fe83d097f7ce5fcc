//! Counter-based random numbers: each is a function of the seed, the iteration, the splat and a purpose, so that it
//! does not depend on the order of work.

use scene::math::num;

/// Purpose of a random number, so that numbers for different purposes are independent.
#[derive(Debug, Clone, Copy)]
pub enum Purpose {
    /// Order of the views.
    Order = 1,
    /// Noise added to centres.
    Noise = 2,
    /// Sampling of splats to which faded splats are moved.
    Relocation = 3,
    /// Sampling of splats that are duplicated.
    Growth = 4,
    /// Initial splats.
    Start = 5,
}

/// Mixes 64 bits (the finalizer of SplitMix64).
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// 64 random bits.
pub fn bits(seed: u64, purpose: Purpose, step: u64, index: u64) -> u64 {
    const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
    let mut x = mix(seed.wrapping_add(GOLDEN));
    for word in [purpose as u64, step, index] {
        x = mix(x ^ word.wrapping_add(1).wrapping_mul(GOLDEN));
    }
    x
}

/// A number in (0, 1).
pub fn uniform(seed: u64, purpose: Purpose, step: u64, index: u64) -> f64 {
    ((bits(seed, purpose, step, index) >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
}

/// Three independent numbers with a standard normal distribution.
pub fn normals(seed: u64, purpose: Purpose, step: u64, index: u64) -> [f64; 3] {
    let of = |k: u64| uniform(seed, purpose, step, 4 * index + k);
    let pair = |k: u64| {
        let radius = (-2.0 * num::f64::ln(of(k))).sqrt();
        let (sin, cos) = num::sin_cos(std::f64::consts::TAU * of(k + 1));
        [radius * cos, radius * sin]
    };
    let ([a, b], [c, _]) = (pair(0), pair(2));
    [a, b, c]
}

/// A permutation of `0..count`.
pub fn permutation(seed: u64, round: u64, count: usize) -> Vec<u32> {
    let mut order: Vec<(u64, u32)> =
        (0..count).map(|i| (bits(seed, Purpose::Order, round, i as u64), i as u32)).collect();
    order.sort_unstable();
    order.into_iter().map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first two moments of 10,000 numbers are those of their distributions, within four standard errors, and
    /// numbers with different words differ.
    #[test]
    fn numbers_have_their_distributions() {
        let count = 10_000;
        let (mut mean, mut normal, mut squares) = (0.0, [0.0; 3], [0.0; 3]);
        for i in 0..count {
            mean += uniform(7, Purpose::Relocation, 3, i) / count as f64;
            for (k, value) in normals(7, Purpose::Noise, 3, i).into_iter().enumerate() {
                normal[k] += value / count as f64;
                squares[k] += value * value / count as f64;
            }
        }
        assert!((mean - 0.5).abs() < 4.0 * 0.29 / 100.0);
        assert!(
            normal.iter().all(|m| m.abs() < 0.04) && squares.iter().all(|v| (v - 1.0).abs() < 4.0 * 0.0142)
        );
        let words = [
            bits(7, Purpose::Noise, 3, 4),
            bits(8, Purpose::Noise, 3, 4),
            bits(7, Purpose::Order, 3, 4),
            bits(7, Purpose::Noise, 4, 3),
        ];
        assert!((1..4).all(|i| !words[..i].contains(&words[i])));
    }

    #[test]
    fn permutations_contain_every_index_once() {
        let mut order = permutation(1, 2, 50);
        assert_ne!(order, permutation(1, 3, 50));
        order.sort_unstable();
        assert!(order.into_iter().eq(0..50));
    }
}
