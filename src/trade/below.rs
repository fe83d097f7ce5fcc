//! Whether anything costs less than some bound: all that does, measured, where that is little.

use std::collections::BTreeSet;

use super::search::{Steps, Tried};

/// A knob turned up may save work elsewhere, since other light takes other paths: by less than this share.
const MARGIN: f64 = 0.05;

/// What costs less than a bound.
#[derive(Debug, PartialEq)]
pub struct Below {
    /// The position with every knob at its least.
    pub least: Tried,
    /// All that cost less than the bound.
    pub all: Vec<Tried>,
}

/// Finds everything that costs less than a bound, from the position with every knob at its least upwards, since no
/// knob that is turned up saves more than [`MARGIN`]. `None` where more than `most` positions would have to be measured,
/// or measuring ended.
pub fn below(
    knobs: &[Steps],
    bound: f64,
    most: usize,
    mut measure: impl FnMut(&[usize]) -> Option<(f64, f64)>,
) -> Option<Below> {
    let mut open = vec![vec![0; knobs.len()]];
    let mut seen = BTreeSet::from_iter(open.clone());
    let mut measured = Vec::new();
    while let Some(assignment) = open.pop() {
        let (cost, error) = measure(&assignment)?;
        if cost < (1.0 + MARGIN) * bound {
            for knob in (0..knobs.len()).filter(|&knob| assignment[knob] + 1 < knobs[knob].values) {
                let mut above = assignment.clone();
                above[knob] += 1;
                if seen.insert(above.clone()) {
                    open.push(above);
                }
            }
        }
        if seen.len() > most {
            return None;
        }
        measured.push(Tried { assignment, cost, error });
    }
    let least = measured.first()?.clone();
    measured.retain(|tried| tried.cost < bound);
    Some(Below { least, all: measured })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
mod tests {
    use super::*;

    #[test]
    fn all_that_costs_less_is_found_and_little_else_is_measured() {
        let knobs = [3, 4, 2].map(|values| Steps { values, step: 1 });
        let cost = |assignment: &[usize]| {
            // The second knob saves a little of what the first costs.
            let [a, b, c] = [0, 1, 2].map(|knob| assignment[knob] as f64);
            10.0 + 4.0 * a - if b > 0.0 { 0.3 } else { 0.0 } + 2.0 * b + 9.0 * c
        };
        for bound in [5.0, 10.0, 12.0, 14.1, 20.0, 100.0] {
            let mut count = 0;
            let found = below(&knobs, bound, 30, |assignment| {
                count += 1;
                Some((cost(assignment), 0.5))
            })
            .unwrap();
            let all = (0..3).flat_map(|a| (0..4).flat_map(move |b| (0..2).map(move |c| [a, b, c])));
            let cheap = all.filter(|assignment| cost(assignment) < bound).count();
            assert!(found.all.len() == cheap && found.all.iter().all(|t| t.cost < bound), "{bound}");
            assert!(found.least.assignment == [0; 3] && count <= 4 * (1 + cheap), "{bound}: {count}");
        }
        assert_eq!(below(&knobs, 100.0, 23, |a| Some((cost(a), 0.5))), None, "24 are too many");
        assert_eq!(below(&knobs, 5.0, 30, |_| None), None);
    }
}
