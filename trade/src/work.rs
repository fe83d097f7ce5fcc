//! Work: the deterministic counts of a run, combined into one number.

use engine::Counts;

/// Weight of each count, as an equivalent number of rays. The weight of a count is the CPU time of one counted
/// operation divided by the CPU time of one ray of `path-trace`. The weights were fitted by
/// `tests/tables/weights.py`. `docs/evidence/trade.md` has the measurements and shows how well the weights predict
/// the time of single nodes. Counts that are not listed have no weight.
const WEIGHTS: [(&str, f64); 7] = [
    ("rays", 1.0),
    ("splat_tile_pairs", 0.4),
    ("splat_evaluations", 0.014),
    // Added to the weight of `splat_evaluations`.
    ("splat_evaluations_f64", 0.013),
    ("directions", 0.36),
    ("pixels", 0.8),
    ("taps", 0.01),
];

/// Combines the counts of a run into its work, in rays.
pub fn work_of(counts: &Counts) -> f64 {
    let weigh = |(name, weight): &(&str, f64)| counts.get(*name).map_or(0.0, |n| *n as f64 * weight);
    WEIGHTS.iter().map(weigh).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_is_a_weighted_sum_of_what_is_known() {
        let counts = [("rays", 1000), ("splat_evaluations", 1_000_000), ("emitters", 7)];
        let counts = counts.iter().map(|(name, n)| ((*name).to_owned(), *n)).collect();
        assert!((work_of(&counts) - 15_000.0).abs() < 1e-6);
    }
}
