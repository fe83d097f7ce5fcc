//! Work: deterministic counts of a run, weighed into one number.

use engine::Counts;

/// What a count weighs, in rays: about the CPU time of one beside that of a ray of `path-trace`, estimated and good
/// to a factor of two or three. Which numbers stand here moves the choice of settings between kinds of work
/// and never that between more and less of one; what is not listed weighs nothing.
const WEIGHTS: [(&str, f64); 7] = [
    ("rays", 1.0),
    ("splat_evaluations", 0.003),
    ("splats_visited", 0.02),
    ("splats_projected", 0.1),
    ("splat_tile_pairs", 0.02),
    ("pixels", 0.1),
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
        assert_eq!(work_of(&counts), 4000.0);
    }
}
