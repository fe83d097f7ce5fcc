//! Typical light level of a picture. Thresholds are stated relative to this level.

/// Samples below this fraction of the 90th percentile of the positive samples count as unlit, since they are
/// rounding errors and noise.
const DARKEST: f64 = 1e-6;

/// Returns the median of the lit samples, or 0 if no sample is lit. A mean would be dominated by a sun. A sample is
/// lit if it is finite and at least a millionth of the 90th percentile of the positive samples, so that the black
/// parts of a picture have no influence.
pub fn level(samples: impl Iterator<Item = f32>) -> f64 {
    // Positive floats have the order of their bits, and integers are selected in less time.
    let mut lit: Vec<u32> = samples.filter(|v| v.is_finite() && *v > 0.0).map(f32::to_bits).collect();
    let value = |bits: u32| f64::from(f32::from_bits(bits));
    if lit.is_empty() {
        return 0.0;
    }
    let bright = lit.len() * 9 / 10;
    let bright = value(*lit.select_nth_unstable(bright).1);
    lit.retain(|bits| value(*bits) >= DARKEST * bright);
    let middle = lit.len() / 2;
    value(*lit.select_nth_unstable(middle).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    // Neither a sun nor large black areas determine the level, and it scales with exposure. This test fails without
    // `lit.retain`, or if the last of the sorted samples is taken in place of the middle one.
    #[test]
    fn suns_and_blackness_do_not_decide() {
        let floor = [0.8_f32, 0.9, 1.0, 1.1, 1.2];
        let all = |more: &[f32]| floor.iter().chain(more).copied().collect::<Vec<_>>();
        let of = |samples: Vec<f32>| level(samples.into_iter());
        assert_eq!(of(all(&[])), 1.0);
        assert_eq!(of(all(&[2e5])), f64::from(1.1_f32));
        assert_eq!(of(all(&[1e-9; 20])), 1.0);
        assert_eq!(of(all(&[0.0, f32::NAN, f32::INFINITY])), 1.0);
        assert_eq!(of(floor.map(|v| v * 1e-30).to_vec()), f64::from(1e-30_f32));
        assert_eq!(of(vec![0.0; 4]), 0.0);
    }
}
