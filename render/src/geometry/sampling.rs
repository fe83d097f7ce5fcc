//! Counter-based random numbers and distributions.
//!
//! Every number is a function of (seed, pixel, sample, dimension), so it does not depend on the order of work.
//! Dimensions are used in pairs, and each pair has its own (0, 2)-sequence: Sobol' points with hash-based Owen
//! scrambling and shuffling (Burley 2020, Practical Hash-based Owen Scrambling), padded as in Kollig and Keller
//! 2002. Any aligned block of 2^k samples is stratified in every pair.

use fearless_simd::{prelude::*, u32x8};

/// Mixes the bits of a word (`lowbias32` of Wellons' hash prospector).
#[inline]
pub fn mix(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Hashes two words to one.
#[inline]
pub fn hash(a: u32, b: u32) -> u32 {
    mix(a.wrapping_mul(0x9e37_79b9) ^ mix(b.wrapping_add(0x85eb_ca6b)))
}

/// The nested uniform scramble of a bit-reversed value: each bit is flipped by a hash of the bits below
/// it (Laine and Karras 2011, with Vegdahl's constants of 2021).
#[inline]
fn scramble_reversed(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// Maps index bits to the second Sobol' dimension, bit-reversed. The matrix is Pascal's triangle modulo 2, the
/// Kronecker power of [[1, 1], [0, 1]], so that five masked shifts suffice.
#[inline]
fn pascal(mut x: u32) -> u32 {
    x ^= (x >> 16) & 0x0000_ffff;
    x ^= (x >> 8) & 0x00ff_00ff;
    x ^= (x >> 4) & 0x0f0f_0f0f;
    x ^= (x >> 2) & 0x3333_3333;
    x ^ ((x >> 1) & 0x5555_5555)
}

/// Converts the upper 24 bits of a random word to a number in [0, 1).
#[inline]
pub fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Converts all 32 bits of a random word to a number in [0, 1).
#[inline(always)]
pub fn fraction(bits: u32) -> f64 {
    f64::from(bits) * (1.0 / 4_294_967_296.0)
}

/// The random numbers of one sample of one pixel, as points of the unit square.
#[derive(Debug, Clone, Copy)]
pub struct Points {
    stream: u32,
    index: u32,
}

impl Points {
    /// Returns the points of the sample with the number `sample` in a stream (see [`stream`]).
    #[inline]
    pub fn new(stream: u32, sample: u32) -> Self {
        Self { stream, index: sample }
    }

    /// Returns the points of sub-sample `number` of `count` sub-samples of this sample. If `count` is a power of 2,
    /// the sub-samples of an aligned block of 2^k samples are stratified like an aligned block of `count * 2^k`
    /// samples.
    #[inline]
    pub fn twig(&self, number: u32, count: u32) -> Self {
        Self { stream: self.stream, index: self.index.wrapping_mul(count).wrapping_add(number) }
    }

    /// Returns the points of this sample in a different stream, given by `number`. They are independent of the
    /// points of this stream.
    #[inline]
    pub fn branch(&self, number: u32) -> Self {
        Self { stream: hash(self.stream, number), index: self.index }
    }

    /// Returns the point for a pair of dimensions, as 32-bit fractions.
    #[inline]
    pub fn bits(&self, pair: u32) -> [u32; 2] {
        let seed = hash(self.stream, pair);
        // Shuffling the index keeps aligned blocks of 2^k together.
        let index = scramble_reversed(self.index.reverse_bits(), seed).reverse_bits();
        let x = scramble_reversed(index, mix(seed ^ 0xa511_e9b3));
        let y = scramble_reversed(pascal(index), mix(seed ^ 0x63d8_3595));
        [x.reverse_bits(), y.reverse_bits()]
    }

    /// Computes [`bits`](Self::bits) for eight samples, each with its own pair of dimensions. Returns all first
    /// coordinates, then all second coordinates.
    #[inline(always)]
    pub fn bits_of_eight<S: Simd>(simd: S, points: &[Self; 8], pairs: &[u32; 8]) -> [[u32; 8]; 2] {
        let (mut streams, mut indices) = ([0; 8], [0; 8]);
        for (k, point) in points.iter().enumerate() {
            (streams[k], indices[k]) = (point.stream, point.index);
        }
        let seeds = wide_hash(u32x8::from_slice(simd, &streams), u32x8::from_slice(simd, pairs));
        let index = wide_reversed(u32x8::from_slice(simd, &indices));
        let index = wide_reversed(wide_scramble(index, seeds));
        let x = wide_scramble(index, wide_mix(seeds ^ 0xa511_e9b3));
        let y = wide_scramble(wide_pascal(index), wide_mix(seeds ^ 0x63d8_3595));
        let store = |v: u32x8<S>| {
            let mut out = [0; 8];
            v.store_slice(&mut out);
            out
        };
        [store(wide_reversed(x)), store(wide_reversed(y))]
    }

    /// Returns the point for a pair of dimensions.
    #[inline]
    pub fn pair(&self, pair: u32) -> [f32; 2] {
        self.bits(pair).map(unit)
    }
}

/// Computes [`mix`] of eight words.
#[inline(always)]
fn wide_mix<S: Simd>(x: u32x8<S>) -> u32x8<S> {
    let x = (x ^ (x >> 16)) * 0x7feb_352d;
    let x = (x ^ (x >> 15)) * 0x846c_a68b;
    x ^ (x >> 16)
}

/// Computes [`hash`] of eight pairs of words.
#[inline(always)]
fn wide_hash<S: Simd>(a: u32x8<S>, b: u32x8<S>) -> u32x8<S> {
    wide_mix((a * 0x9e37_79b9) ^ wide_mix(b + 0x85eb_ca6b))
}

/// Computes [`scramble_reversed`] of eight values.
#[inline(always)]
fn wide_scramble<S: Simd>(x: u32x8<S>, seed: u32x8<S>) -> u32x8<S> {
    let x = (x ^ (x * 0x3d20_adea)) + seed;
    let x = x * ((seed >> 16) | 1);
    let x = x ^ (x * 0x0552_6c56);
    x ^ (x * 0x53a2_2864)
}

/// Computes [`pascal`] of eight values.
#[inline(always)]
fn wide_pascal<S: Simd>(x: u32x8<S>) -> u32x8<S> {
    let x = x ^ (x >> 16);
    let x = x ^ ((x >> 8) & 0x00ff_00ff);
    let x = x ^ ((x >> 4) & 0x0f0f_0f0f);
    let x = x ^ ((x >> 2) & 0x3333_3333);
    x ^ ((x >> 1) & 0x5555_5555)
}

/// Reverses the bits of each of eight values.
#[inline(always)]
fn wide_reversed<S: Simd>(x: u32x8<S>) -> u32x8<S> {
    let x = ((x >> 1) & 0x5555_5555) | ((x & 0x5555_5555) << 1);
    let x = ((x >> 2) & 0x3333_3333) | ((x & 0x3333_3333) << 2);
    let x = ((x >> 4) & 0x0f0f_0f0f) | ((x & 0x0f0f_0f0f) << 4);
    let x = ((x >> 8) & 0x00ff_00ff) | ((x & 0x00ff_00ff) << 8);
    (x >> 16) | (x << 16)
}

/// Number of the stream of a pixel. Points are scrambled differently for different pixels and seeds.
#[inline]
pub fn stream(seed: u64, x: u32, y: u32) -> u32 {
    hash(hash(seed as u32, (seed >> 32) as u32), hash(x, y))
}

/// Sine and cosine of `turns` full turns, for `turns` in [0, 1]. Uses Taylor series within an eighth of a turn,
/// which are accurate to the last one or two bits of f32.
#[inline]
pub fn circle(turns: f32) -> (f32, f32) {
    let quarter = (turns * 4.0 + 0.5).floor();
    let a = (turns - quarter * 0.25) * std::f32::consts::TAU;
    let q = a * a;
    let sin = a * (1.0 + q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0 + q * (1.0 / 362_880.0)))));
    let cos = 1.0 + q * (-0.5 + q * (1.0 / 24.0 + q * (-1.0 / 720.0 + q * (1.0 / 40_320.0))));
    match quarter as i32 & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// A discrete distribution over indices, sampled by inversion in O(1) expected time.
#[derive(Debug, Clone)]
pub struct Discrete {
    /// Entry `i` of `n` holds the cumulative probability before index `i`, and the index whose interval contains
    /// the probability `i / n`, at which the search for a sample starts. One more entry holds the probability 1.
    /// Both values are stored together, since every sample reads both.
    cells: Vec<(f64, u32)>,
}

impl Discrete {
    /// Builds a distribution with probabilities proportional to `weights`, which must be finite and not negative.
    /// Returns the distribution and the sum of the weights. If all weights are 0, the distribution is uniform.
    pub fn new(weights: &[f64]) -> (Self, f64) {
        let n = weights.len().max(1);
        let mut cumulative = Vec::with_capacity(n + 1);
        cumulative.push(0.0);
        let mut sum = 0.0_f64;
        for &weight in weights {
            sum += weight;
            cumulative.push(sum);
        }
        cumulative.resize(n + 1, sum);
        if sum > 0.0 && sum.is_finite() {
            cumulative.iter_mut().for_each(|c| *c /= sum);
        } else {
            cumulative.iter_mut().enumerate().for_each(|(i, c)| *c = i as f64 / n as f64);
        }
        cumulative[n] = 1.0;
        let mut guide = Vec::with_capacity(n);
        let mut index = 0;
        for step in 0..n {
            while cumulative[index + 1] <= step as f64 / n as f64 {
                index += 1;
            }
            guide.push(index as u32);
        }
        guide.push(n as u32);
        (Self { cells: cumulative.into_iter().zip(guide).collect() }, sum)
    }

    /// Returns the index for a random number `u` in [0, 1), and the position of `u` within the interval of this
    /// index, in [0, 1).
    #[inline]
    pub fn sample(&self, u: f64) -> (usize, f64) {
        let n = self.cells.len() - 1;
        let mut index = self.cells[((u * n as f64) as usize).min(n - 1)].1 as usize;
        while index + 1 < n && self.cells[index + 1].0 <= u {
            index += 1;
        }
        let low = self.cells[index].0;
        let width = self.cells[index + 1].0 - low;
        let within = if width > 0.0 { (u - low) / width } else { 0.5 };
        (index, within.clamp(0.0, 1.0 - f64::EPSILON))
    }

    /// Returns the probability of an index.
    #[inline]
    pub fn probability(&self, index: usize) -> f64 {
        self.cells[index + 1].0 - self.cells[index].0
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;

    // The defining property of a (0, k, 2)-net: each elementary interval of area 2^-k holds one point.
    #[test]
    fn aligned_blocks_are_stratified() {
        for (pixel, block) in [(0, 0), (17, 0), (3, 5)] {
            for k in [2_u32, 4, 6, 8] {
                let n = 1_u32 << k;
                for split in 0..=k {
                    let mut seen = vec![0; n as usize];
                    for i in 0..n {
                        let [x, y] = Points::new(stream(9, pixel, 4), block * n + i).bits(3);
                        let column = if split == 0 { 0 } else { x >> (32 - split) };
                        let row = if split == k { 0 } else { y >> (32 - (k - split)) };
                        seen[((column << (k - split)) | row) as usize] += 1;
                    }
                    assert!(seen.iter().all(|&c| c == 1), "k {k} split {split} block {block}");
                }
            }
        }
    }

    /// Eight points computed at once equal the points computed one by one, with every set of vector instructions.
    /// This test fails if a shift in `wide_reversed` or a constant in `wide_scramble` is changed.
    #[test]
    fn eight_points_at_once_are_the_same() {
        for level in testing::levels() {
            for i in 0..1_000 {
                let points = std::array::from_fn(|k| Points::new(hash(i, 3), i).twig(k as u32, 8));
                let pairs = std::array::from_fn(|k| hash(i, k as u32 / 3));
                let [x, y] = dispatch!(level, simd => Points::bits_of_eight(simd, &points, &pairs));
                for k in 0..8 {
                    assert_eq!([x[k], y[k]], points[k].bits(pairs[k]), "{level:?}");
                }
            }
        }
    }

    // Different pairs and pixels are uncorrelated: the mean of the product of centred coordinates is 0.
    #[test]
    fn pairs_and_pixels_are_independent() {
        let mut worst = 0.0_f64;
        for pair in 0..8 {
            let (mut between_pairs, mut between_pixels) = (0.0, 0.0);
            let n = 40_000;
            for i in 0..n {
                let (pixel, sample) = (i % 2_000, i / 2_000);
                let here = Points::new(stream(1, pixel, 0), sample);
                let a = f64::from(here.pair(pair)[0]) - 0.5;
                let b = f64::from(here.pair(pair + 1)[1]) - 0.5;
                let c = f64::from(Points::new(stream(1, pixel + 1, 0), sample).pair(pair)[0]) - 0.5;
                between_pairs += a * b;
                between_pixels += a * c;
            }
            // The standard deviation of each mean is 1/12 / sqrt(n).
            let sigma = f64::from(n).sqrt() / 12.0;
            worst = worst.max((between_pairs / sigma).abs()).max((between_pixels / sigma).abs());
        }
        assert!(worst < 4.5, "{worst} sigma");
    }

    #[test]
    fn circle_is_sine_and_cosine() {
        for i in 0..=10_000 {
            let turns = i as f32 / 10_000.0;
            let (sin, cos) = scene::math::num::sin_cos(f64::from(turns) * std::f64::consts::TAU);
            let (s, c) = circle(turns);
            assert!((f64::from(s) - sin).abs() < 3e-7 && (f64::from(c) - cos).abs() < 3e-7, "{turns}");
        }
    }

    #[test]
    fn numbers_lie_below_one() {
        assert!(unit(u32::MAX) < 1.0);
        assert_eq!(unit(0), 0.0);
    }

    /// Streams differ for seeds that are equal in their lower 32 bits, and for pixels whose row-major indices are
    /// equal modulo 2^32.
    #[test]
    fn nothing_wraps_at_32_bits() {
        let near =
            |of: u64| [of, of ^ 1 << 32, of ^ 1 << 63, of.wrapping_add(u64::from(u32::MAX)), of.swap_bytes()];
        let mut streams: Vec<u32> =
            [1, 7, u64::MAX - 1].into_iter().flat_map(near).map(|s| stream(s, 3, 5)).collect();
        let width = 1 << 20;
        for k in 0..4 {
            streams.extend([
                stream(1, 9, 4096 * k + 6),
                stream(1, width - 1, 4096 * k),
                stream(1, u32::MAX, u32::MAX - k),
            ]);
        }
        let all = streams.len();
        streams.sort_unstable();
        streams.dedup();
        assert_eq!(streams.len(), all);
    }

    /// Indices are sampled in proportion to their weights.
    #[test]
    fn inversion_follows_the_weights() {
        let weights = [1e-9, 1e9, 0.0, 3e8, 1e-9];
        let (distribution, sum) = Discrete::new(&weights);
        assert!((sum - 1.3e9).abs() < 1e-6);
        let total: f64 = (0..5).map(|i| distribution.probability(i)).sum();
        assert!((total - 1.0).abs() < 1e-15);
        let n = 1_000_000;
        let mut counts = [0_u32; 5];
        for i in 0..n {
            counts[distribution.sample((f64::from(i) + 0.5) / f64::from(n)).0] += 1;
        }
        assert_eq!(counts[2], 0);
        for (count, weight) in counts.iter().zip(weights) {
            assert!((f64::from(*count) - f64::from(n) * weight / sum).abs() <= 1.0);
        }
        let (uniform, sum) = Discrete::new(&[0.0; 4]);
        assert_eq!((sum, uniform.probability(2), uniform.sample(0.6).0), (0.0, 0.25, 2));
        assert_eq!(uniform.sample(1.0 - 1e-17).0, 3);
    }
}
