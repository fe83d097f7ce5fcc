//! Counter-based random numbers: every number is a hash of its purpose and index.

/// Random number in [0, 1) for (seed, purpose, index, dimension).
pub(super) fn unit(seed: u64, purpose: u64, index: u64, dimension: u64) -> f64 {
    let mut x = seed ^ 0x9e37_79b9_7f4a_7c15;
    for part in [purpose, index, dimension] {
        x = mix(x ^ part.wrapping_mul(0xd6e8_feb8_6659_fd93));
    }
    (x >> 11) as f64 / (1_u64 << 53) as f64
}

// The finaliser of MurmurHash3 with the constants of David Stafford's variant 13.
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Smooth noise in [-1, 1] at a point, of one octave: random lattice values interpolated by a cubic.
pub(super) fn noise(seed: u64, x: f64, y: f64) -> f64 {
    let (fx, fy) = (x.floor(), y.floor());
    let at = |i: f64, j: f64| {
        let key =
            ((fx + i) as i64 as u64).wrapping_mul(0x1_0000_0001) ^ ((fy + j) as i64 as u64).rotate_left(32);
        unit(seed, 0x6e6f_6973, key, 0) * 2.0 - 1.0
    };
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (tx, ty) = (smooth(x - fx), smooth(y - fy));
    let low = at(0.0, 0.0) * (1.0 - tx) + at(1.0, 0.0) * tx;
    let high = at(0.0, 1.0) * (1.0 - tx) + at(1.0, 1.0) * tx;
    low * (1.0 - ty) + high * ty
}

/// Sum of four octaves of [`noise`].
pub(super) fn fractal(seed: u64, x: f64, y: f64) -> f64 {
    let (mut sum, mut scale, mut size) = (0.0, 1.0, 0.5);
    for octave in 0..4 {
        sum += size * noise(seed + octave, x * scale, y * scale);
        scale *= 2.03;
        size *= 0.5;
    }
    sum
}
