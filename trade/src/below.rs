//! Search for all settings that cost less than a bound. If the number of allowed measurements is too small for
//! this, the search finds only some of these settings.

use std::collections::BTreeSet;

use crate::search::{Steps, Tried};

/// Lower bound of the margin. The margin is the maximum share of the cost that raising knobs is assumed to save.
/// (Raising a knob may save work elsewhere, since light then takes other paths.) The margin is also at least
/// [`TIMES`] times the largest measured saving. The result is complete if raising knobs never saves more than the
/// margin. Measurements support this assumption, but do not prove it.
const MARGIN: f64 = 0.05;
/// Minimum ratio of the margin to the largest measured saving.
const TIMES: f64 = 2.0;

/// Settings that cost less than a bound.
#[derive(Debug, PartialEq)]
pub struct Below {
    /// The cheapest measured position with every ordered knob at its minimum. Knobs whose values have no order may
    /// have any value.
    pub least: Tried,
    /// The settings found that cost less than the bound, including settings that were known before.
    pub all: Vec<Tried>,
    /// True if `all` contains every setting that costs less than the bound, assuming that raising knobs saves no
    /// more than `margin`. False if there were more settings than may be measured, or if measuring ended early.
    pub complete: bool,
    /// Maximum share of a position's cost that raising its knobs is assumed to save. If this assumption holds and
    /// `complete` is true, no unmeasured position costs less than the bound.
    pub margin: f64,
    /// Measured savings from raising knobs.
    pub saved: Saved,
}

/// Savings from raising one or several knobs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Saved {
    /// Number of pairs of different measured positions in which each ordered knob of the second position is at or
    /// above its value in the first position, and all other knobs are equal.
    pub pairs: usize,
    /// The largest saving among these pairs, as a share of the cost of the first position; 0 if no pair saves.
    pub most: f64,
}

impl Saved {
    fn of(knobs: &[Steps], tried: &[Tried]) -> Self {
        let above = |a: &Tried, b: &Tried| {
            let mut turned = knobs.iter().zip(a.assignment.iter().zip(&b.assignment));
            a.assignment != b.assignment
                && turned.all(|(knob, (a, b))| if knob.ordered { a >= b } else { a == b })
        };
        let pairs = tried.iter().flat_map(|b| tried.iter().filter(move |a| above(a, b)).map(move |a| (a, b)));
        let saved = pairs.map(|(a, b)| if b.cost > 0.0 { 1.0 - a.cost / b.cost } else { 0.0 });
        saved.fold(Self { pairs: 0, most: 0.0 }, |Self { pairs, most }, saved| Self {
            pairs: pairs + 1,
            most: most.max(saved),
        })
    }
}

/// Finds all positions that cost less than `bound`. The search starts with every knob at its minimum and raises the
/// knobs. For knobs whose values have no order, all values are tried. From a position at a cost above the bound,
/// the search continues only if saving the margin, a share of this cost, would bring the cost below the bound. The
/// margin is derived from the savings between all measured positions, including the `known` ones. At most `most`
/// positions are measured. The neighbours of the positions with the smallest error are measured first. Returns
/// `None` if measuring ended before the first position.
pub fn below(
    knobs: &[Steps],
    known: &[Tried],
    bound: f64,
    most: usize,
    mut measure: impl FnMut(&[usize]) -> Option<(f64, f64)>,
) -> Option<Below> {
    let mut known = known.to_vec();
    let mut saved = Saved::of(knobs, &known);
    loop {
        let margin = MARGIN.max(TIMES * saved.most);
        let (measured, complete) = upwards(knobs, bound, margin, most, &mut measure);
        for tried in &measured {
            if known.iter().all(|known| known.assignment != tried.assignment) {
                known.push(tried.clone());
            }
        }
        saved = Saved::of(knobs, &known);
        if complete && TIMES * saved.most > margin {
            continue;
        }
        let at_least =
            |tried: &&Tried| knobs.iter().zip(&tried.assignment).all(|(knob, at)| !knob.ordered || *at == 0);
        let cheaper = |a: &'_ Tried, b: &'_ Tried| a.cost.total_cmp(&b.cost);
        let least = measured.iter().filter(at_least).min_by(|a, b| cheaper(a, b))?.clone();
        let all = known.into_iter().filter(|tried| tried.cost < bound).collect();
        return Some(Below { least, all, complete, margin, saved });
    }
}

/// Measures positions, starting with every knob at its minimum. If the cost of a position, reduced by the share
/// `margin`, is below the bound, the positions with one knob raised by one value are measured as well. A knob whose
/// values have no order is raised in any case. Returns the measured positions, and true if every position that
/// these rules select was measured.
fn upwards(
    knobs: &[Steps],
    bound: f64,
    margin: f64,
    most: usize,
    measure: &mut impl FnMut(&[usize]) -> Option<(f64, f64)>,
) -> (Vec<Tried>, bool) {
    // Positions to measure, each with the error of the position below it and the number of successive changes that
    // did not reduce the error. The position with the smallest error is measured first; among equal errors, the one
    // with the fewest such changes, so that a knob with an effect is raised before one without.
    let mut open = vec![(f64::INFINITY, 0_usize, vec![0; knobs.len()])];
    let mut seen = BTreeSet::from([vec![0; knobs.len()]]);
    let mut measured = Vec::new();
    let least = |open: &[(f64, usize, Vec<usize>)]| {
        let all = open.iter().enumerate();
        all.min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0).then_with(|| (a.1, &a.2).cmp(&(b.1, &b.2))))
            .map(|(at, _)| at)
    };
    while let Some(at) = least(&open) {
        let (before, idle, assignment) = open.swap_remove(at);
        if measured.len() == most {
            return (measured, false);
        }
        let Some((cost, error)) = measure(&assignment) else { return (measured, false) };
        let near = cost * (1.0 - margin) < bound;
        let idle = if error < before { 0 } else { idle + 1 };
        for (knob, Steps { values, ordered, .. }) in knobs.iter().enumerate() {
            if assignment[knob] + 1 < *values && (near || !ordered) {
                let mut above = assignment.clone();
                above[knob] += 1;
                if seen.insert(above.clone()) {
                    open.push((error, idle, above));
                }
            }
        }
        measured.push(Tried { assignment, cost, error });
    }
    (measured, true)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
mod tests {
    use super::*;

    fn steps<const N: usize>(values: [usize; N]) -> [Steps; N] {
        values.map(|values| Steps { values, step: 1, ordered: true })
    }

    #[test]
    fn all_that_costs_less_is_found_and_little_else_is_measured() {
        let knobs = steps([3, 4, 2]);
        let cost = |assignment: &[usize]| {
            // The second knob saves a little of what the first costs.
            let [a, b, c] = [0, 1, 2].map(|knob| assignment[knob] as f64);
            10.0 + 4.0 * a - if b > 0.0 { 0.3 } else { 0.0 } + 2.0 * b + 9.0 * c
        };
        for bound in [5.0, 10.0, 12.0, 14.1, 20.0, 100.0] {
            let mut count = 0;
            let found = below(&knobs, &[], bound, 30, |assignment| {
                count += 1;
                Some((cost(assignment), 0.5))
            })
            .unwrap();
            let all = (0..3).flat_map(|a| (0..4).flat_map(move |b| (0..2).map(move |c| [a, b, c])));
            let cheap = all.filter(|assignment| cost(assignment) < bound).count();
            assert!(found.complete && found.all.len() == cheap, "{bound}");
            assert!(found.all.iter().all(|t| t.cost < bound), "{bound}");
            assert!(found.least.assignment == [0; 3] && count <= 4 * (1 + cheap), "{bound}: {count}");
        }
        for (most, complete) in [(23, false), (24, true)] {
            let found = below(&knobs, &[], 100.0, most, |a| Some((cost(a), 0.5))).unwrap();
            assert_eq!(
                (found.all.len(), found.complete),
                (most, complete),
                "24 positions cost less than the bound"
            );
        }
        // Known positions that cost less than the bound are included as well. This test fails if `all` contains
        // only positions in `measured`.
        let known = [Tried { assignment: vec![2, 3, 1], cost: cost(&[2, 3, 1]), error: 0.1 }];
        let found = below(&knobs, &known, 100.0, 3, |a| Some((cost(a), 0.5))).unwrap();
        assert!(found.all.len() == 4 && found.all.iter().any(|tried| tried.error == 0.1));
        let mut left = 3;
        let found = below(&knobs, &[], 100.0, 30, |a| {
            left -= 1;
            (left >= 0).then(|| (cost(a), 0.5))
        });
        assert!(found.is_some_and(|found| !found.complete && found.all.len() == 3), "measuring ended");
        assert_eq!(below(&knobs, &[], 5.0, 30, |_| None), None);
    }

    // The last knob does not affect the error. This test fails if `idle` is always 0.
    #[test]
    fn a_knob_that_does_nothing_comes_after_those_that_do() {
        let found = below(&steps([4, 50]), &[], 100.0, 10, |a| Some((1.0, 1.0 / (1 + a[0]) as f64))).unwrap();
        assert!(found.all.iter().any(|tried| tried.assignment == [3, 0]), "{:?}", found.all);
    }

    // Each of three knobs saves 4 %, and together they save 11.5 %. The only position below the bound lies beyond
    // positions from which a search with a margin of 5 % does not continue. Two known positions show that the
    // margin must be larger.
    #[test]
    fn what_several_knobs_save_together_is_allowed_for_where_it_was_seen() {
        let knobs = steps([2, 2, 2]);
        let cost = |assignment: &[usize]| [100.0, 96.0, 92.16, 88.4736][assignment.iter().sum::<usize>()];
        let known = |assignments: &[[usize; 3]]| -> Vec<Tried> {
            let tried = |a: &[usize; 3]| Tried { assignment: a.to_vec(), cost: cost(a), error: 0.5 };
            assignments.iter().map(tried).collect()
        };
        let found = |known: &[Tried]| below(&knobs, known, 90.0, 30, |a| Some((cost(a), 0.5))).unwrap();
        let blind = found(&known(&[[0, 0, 0]]));
        assert!(blind.all.is_empty() && blind.saved == Saved { pairs: 0, most: 0.0 });
        let seen = found(&known(&[[0, 0, 0], [1, 1, 0]]));
        assert!(seen.all.len() == 1 && seen.all[0].assignment == [1, 1, 1], "{seen:?}");
        assert!((seen.saved.most - 0.115).abs() < 0.001 && seen.saved.pairs == 19, "{seen:?}");
    }

    // If not all positions can be measured, the search continues first from those with the smallest error.
    #[test]
    fn what_errs_least_is_gone_on_from_first() {
        let knobs = steps([9, 9]);
        let found = below(&knobs, &[], 100.0, 10, |a| Some((1.0, (9 - a[1]) as f64))).unwrap();
        assert!(!found.complete && found.all.iter().any(|tried| tried.assignment == [0, 8]), "{found:?}");
    }

    // The two methods have no order, so both are tried, even if the first one is expensive.
    #[test]
    fn values_without_an_order_are_all_gone_through() {
        let mut knobs = steps([3, 2]);
        knobs[0].ordered = false;
        let cost = |a: &[usize]| [50.0, 70.0, 8.0][a[0]] + 4.0 * a[1] as f64;
        let found = below(&knobs, &[], 10.0, 30, |a| Some((cost(a), 0.5))).unwrap();
        assert_eq!((found.least.assignment.as_slice(), found.all.len()), ([2, 0].as_slice(), 1));
        assert_eq!(found.saved.pairs, 1, "positions with different methods form no pair");
    }
}
