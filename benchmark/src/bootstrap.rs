//! Bootstrap intervals of a mean over scenes.

/// A mean with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Mean over scenes.
    pub mean: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end of the 95 % interval.
    pub high: f64,
    /// Number of scenes.
    pub scenes: usize,
}

/// Number of resamples.
pub const RESAMPLES: usize = 10_000;
/// Probabilities of the two ends of an interval.
const ENDS: [f64; 2] = [0.025, 0.975];

/// The mean of one value per scene, and its percentile bootstrap interval (Efron 1979): scenes are drawn with
/// replacement [`RESAMPLES`] times, and the ends are quantiles of the means, interpolated linearly as by
/// `numpy.quantile`. With one scene, the interval is the value itself. `None` without values. The draws depend on
/// `seed` and on the number of values only, so the same values give the same interval, and two methods are compared
/// on the same draws.
pub fn interval(values: &[f64], seed: u64) -> Option<Interval> {
    let scenes = values.len();
    if scenes == 0 {
        return None;
    }
    let mean = values.iter().sum::<f64>() / scenes as f64;
    let mut draws = Draws(seed);
    let mut means: Vec<f64> = (0..RESAMPLES)
        .map(|_| (0..scenes).fold(0.0, |sum, _| sum + values[draws.below(scenes)]) / scenes as f64)
        .collect();
    means.sort_by(f64::total_cmp);
    let [low, high] = ENDS.map(|end| quantile(&means, end));
    Some(Interval { mean, low, high, scenes })
}

/// Quantile of sorted values, interpolated linearly between the two nearest.
fn quantile(sorted: &[f64], at: f64) -> f64 {
    let position = at * (sorted.len() - 1) as f64;
    let (below, above) = (position.floor() as usize, position.ceil() as usize);
    sorted[below] + (sorted[above] - sorted[below]) * (position - position.floor())
}

/// Random numbers of SplitMix64 (Steele, Lea and Flood 2014).
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A whole number below `n`. The bias is below `n / 2^64`.
    fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.next()) * n as u128) >> 64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All resamples of a few values, which a bootstrap approaches: quantiles of the exact distribution.
    fn exact(values: &[f64]) -> [f64; 2] {
        let n = values.len();
        let mut means: Vec<f64> = (0..n.pow(n as u32))
            .map(|code| (0..n).map(|k| values[code / n.pow(k as u32) % n]).sum::<f64>() / n as f64)
            .collect();
        means.sort_by(f64::total_cmp);
        ENDS.map(|end| quantile(&means, end))
    }

    // This test fails if scenes are drawn without replacement.
    #[test]
    fn intervals_approach_the_quantiles_of_all_resamples() {
        let values = [20.0, 21.5, 26.0, 24.0, 31.0, 22.5];
        let [low, high] = exact(&values);
        let found = interval(&values, 1).expect("has values");
        // The standard error of a quantile q of N draws is sqrt(q (1 - q) / N) / density; here below 0.05.
        assert!((found.low - low).abs() < 0.15 && (found.high - high).abs() < 0.15, "{found:?} {low} {high}");
        assert!((found.mean - 24.166_666_666_666_668).abs() < 1e-12);
        assert_ne!(interval(&values, 2), Some(found), "another seed draws others");
        assert_eq!(interval(&values, 1), Some(found));
    }

    // The mean of many values is normal: the interval has the width 2 * 1.96 * sd / sqrt(n). This test fails if the
    // ends are other quantiles.
    #[test]
    fn intervals_of_many_values_are_those_of_a_normal_mean() {
        let mut draws = Draws(7);
        let values: Vec<f64> = (0..400).map(|_| draws.next() as f64 / u64::MAX as f64).collect();
        let mean = values.iter().sum::<f64>() / 400.0;
        let sd = (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / 400.0).sqrt();
        let found = interval(&values, 3).expect("has values");
        let wanted = 1.96 * sd / 20.0;
        assert!((found.high - mean - wanted).abs() < 0.05 * wanted, "{found:?} {wanted}");
        assert!((mean - found.low - wanted).abs() < 0.05 * wanted, "{found:?} {wanted}");
    }

    #[test]
    fn one_scene_has_no_width_and_none_has_no_interval() {
        let one = interval(&[3.0], 1).expect("has a value");
        assert_eq!((one.low, one.high, one.scenes), (3.0, 3.0, 1));
        assert_eq!(interval(&[], 1), None);
        // As `numpy.quantile([1, 2, 4, 8], [0.025, 0.5, 0.975])`.
        let sorted = [1.0, 2.0, 4.0, 8.0];
        for (at, wanted) in [(0.025, 1.075), (0.5, 3.0), (0.975, 7.7)] {
            assert!((quantile(&sorted, at) - wanted).abs() < 1e-12);
        }
    }
}
