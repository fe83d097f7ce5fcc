//! Work: deterministic counts of a run, combined into one number.

use engine::Counts;

/// Weights of counts, in rays: the CPU time relative to that of a ray of `path-trace`, measured over settings by
/// `tests/tables/weights.py`. `docs/evidence/trade.md` has the measurements and how well they predict single nodes.
/// Other counts have no weight.
const WEIGHTS: [(&str, f64); 7] = [
    ("rays", 1.0),
    ("splat_tile_pairs", 0.4),
    ("splat_evaluations", 0.014),
    // On top of that of any arithmetic.
    ("splat_evaluations_f64", 0.013),
    ("directions", 0.36),
    ("pixels", 0.8),
    ("taps", 0.01),
];

/// The work of some counts, in rays.
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
