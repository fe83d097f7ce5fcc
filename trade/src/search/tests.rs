#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use super::*;

/// A model of cost and error. Each step of a knob doubles the cost that the knob causes and halves the error that
/// it causes. The errors of different knobs are independent.
fn model(weights: &'static [(f64, f64)]) -> impl FnMut(&[usize]) -> Option<(f64, f64)> {
    move |assignment| {
        let value = |(&at, &(cost, error)): (&usize, &(f64, f64))| {
            let scale = f64::from(1_u32 << at);
            (cost * scale, (error / scale) * (error / scale))
        };
        let (cost, square) =
            assignment.iter().zip(weights).map(value).fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
        Some((cost, square.sqrt()))
    }
}

fn exhaustive(sizes: &[usize], goal: Goal, mut measure: impl FnMut(&[usize]) -> Option<(f64, f64)>) -> Tried {
    let total: usize = sizes.iter().product();
    let at = |mut n: usize| -> Vec<usize> {
        sizes
            .iter()
            .map(|size| {
                let digit = n % size;
                n /= size;
                digit
            })
            .collect()
    };
    let all = (0..total).filter_map(|n| {
        let (cost, error) = measure(&at(n))?;
        Some(Tried { assignment: at(n), cost, error })
    });
    let fits: Vec<Tried> = all.filter(|t| t.fits(goal)).collect();
    fits.iter().fold(fits[0].clone(), |best, t| if t.beats(&best, goal) { t.clone() } else { best })
}

fn steps<const N: usize>(values: [usize; N]) -> [Steps; N] {
    values.map(|values| Steps { values, step: 1, ordered: true })
}

// One knob is expensive and has little effect. The presets raise it nevertheless.
const BAD: &[(f64, f64)] = &[(1.0, 1.0), (100.0, 0.01), (3.0, 0.5)];

#[test]
fn a_dear_knob_that_does_little_is_turned_down() {
    let sizes = [9, 9, 9];
    for most in [0.5, 0.1, 0.02] {
        let goal = Goal::Error(most);
        let presets: Vec<Vec<usize>> = [0, 3, 6, 8].map(|at| vec![at; 3]).to_vec();
        let SearchResult { tried, best, finished } = search(&presets, &steps(sizes), goal, model(BAD));
        let best = &tried[best.unwrap()];
        assert!(finished);
        let ideal = exhaustive(&sizes, goal, model(BAD));
        let naive = tried[..4].iter().filter(|t| t.fits(goal)).map(|t| t.cost).fold(f64::INFINITY, f64::min);
        assert!(best.error <= most && best.cost <= 1.1 * ideal.cost, "{best:?} {ideal:?}");
        assert!(best.cost < 0.5 * naive || naive == ideal.cost, "{best:?} {naive}");
        assert!(tried.len() <= 4 + 2 * 27, "{}", tried.len());
    }
}

#[test]
fn the_least_error_within_a_cost() {
    let (sizes, goal) = ([9, 9, 9], Goal::Cost(900.0));
    let SearchResult { tried, best, .. } = search(&[vec![0; 3], vec![3; 3]], &steps(sizes), goal, model(BAD));
    let (best, ideal) = (&tried[best.unwrap()], exhaustive(&sizes, goal, model(BAD)));
    assert!(best.cost <= 900.0 && best.error <= 1.2 * ideal.error, "{best:?} {ideal:?}");
}

// Two knobs help only together, so nothing is found from the cheapest start.
#[test]
fn the_best_start_is_searched_from_as_well() {
    let measure = |assignment: &[usize]| {
        let error = if assignment[0].min(assignment[1]) > 0 { 1.0 / (assignment[2] + 1) as f64 } else { 2.0 };
        Some((1.0 + assignment.iter().sum::<usize>() as f64, error))
    };
    let SearchResult { tried, best, finished } =
        search(&[vec![0; 3], vec![1, 1, 0]], &steps([4; 3]), Goal::Cost(5.0), measure);
    assert!(finished && tried[best.unwrap()].assignment == [1, 1, 2], "{tried:?}");
}

// The best start that reaches the goal has two expensive knobs that must be changed together, so lowering one of
// them does not help. From the start that misses the goal, raising only the useful knob suffices.
#[test]
fn the_start_that_misses_the_error_is_searched_from_as_well() {
    let measure = |assignment: &[usize]| {
        let [a, b, c] = [0, 1, 2].map(|knob| assignment[knob] as f64);
        let error = if assignment[0] == assignment[1] { 8.0 - a - c } else { 9.0 - c };
        Some((1.0 + 10.0 * (a + b) + c, error))
    };
    let (starts, goal) = ([vec![3, 3, 3], vec![2, 2, 1], vec![0; 3]], Goal::Error(5.0));
    let SearchResult { tried, best, .. } = search(&starts, &steps([5; 3]), goal, measure);
    assert_eq!(tried[best.unwrap()].assignment, [0, 0, 3], "{tried:?}");
}

// No single change helps: an expensive knob must be lowered and a cheap one raised at the same time.
#[test]
fn a_dear_knob_is_exchanged_for_a_cheap_one() {
    let measure = |assignment: &[usize]| {
        let [a, b] = [0, 1].map(|knob| assignment[knob] as f64);
        Some((1.0 + 10.0 * a + b, 12.0 - 2.0 * a - b))
    };
    let SearchResult { tried, best, finished } =
        search(&[vec![5, 0], vec![0, 0]], &steps([9, 9]), Goal::Error(2.0), measure);
    assert!(finished && tried[best.unwrap()].assignment == [1, 8], "{tried:?}");
}

#[test]
fn a_cost_below_all_starts_is_gone_down_to() {
    let (sizes, goal) = ([9, 9, 9], Goal::Cost(250.0));
    let SearchResult { tried, best, .. } =
        search(&[vec![8; 3], vec![3, 4, 3]], &steps(sizes), goal, model(BAD));
    let (best, ideal) = (&tried[best.unwrap()], exhaustive(&sizes, goal, model(BAD)));
    assert!(best.cost <= 250.0 && best.error <= 1.2 * ideal.error, "{best:?} {ideal:?}");
}

// Only one knob affects the cost, and it must be lowered by more than one step to reach the goal. In another case,
// all knobs must be at their minimum.
#[test]
fn a_cost_below_the_cheapest_start_is_walked_down_to() {
    let measure = |assignment: &[usize]| {
        let [a, b] = [0, 1].map(|knob| assignment[knob] as f64);
        Some((50.0 + 40.0 * a + b, 10.0 - a - 0.1 * b))
    };
    let halves = [Steps { values: 8, step: 2, ordered: true }, Steps { values: 3, step: 1, ordered: true }];
    for (most, expected) in [(51.5, vec![0, 1]), (50.0, vec![0, 0]), (129.0, vec![1, 2])] {
        let SearchResult { tried, best, finished } =
            search(&[vec![7, 2], vec![6, 0]], &halves, Goal::Cost(most), measure);
        assert!(finished && best.is_some_and(|best| tried[best].assignment == expected), "{most}: {tried:?}");
    }
    let SearchResult { tried, best, finished } = search(&[vec![7, 2]], &halves, Goal::Cost(49.0), measure);
    assert!(finished && best.is_none() && tried.iter().any(|t| t.assignment == [0, 0]), "{tried:?}");
    // No single change saves.
    let level = |a: &[usize]| Some((if a == [0, 0, 0] { 1.0 } else { 9.0 }, a[0] as f64));
    let SearchResult { tried, best, .. } = search(&[vec![3, 3, 3]], &steps([4; 3]), Goal::Cost(2.0), level);
    assert!(best.is_some_and(|best| tried[best].assignment == [0, 0, 0]), "{tried:?}");
}

// A step moves by two values. A move by one value is tried if no whole step helps.
#[test]
fn halves_of_steps_come_last() {
    let measure = |assignment: &[usize]| Some((assignment[0] as f64, 8.0 - assignment[0] as f64));
    let one = [Steps { values: 9, step: 2, ordered: true }];
    let SearchResult { tried, best, finished } = search(&[vec![8]], &one, Goal::Error(3.0), measure);
    assert!(finished && tried[best.unwrap()].assignment == [5], "{tried:?}");
    let order: Vec<usize> = tried.iter().map(|t| t.assignment[0]).collect();
    assert_eq!(order[..4], [8, 6, 4, 5]);
    assert!(order.len() <= 6, "{order:?}");
}

#[test]
fn what_cannot_be_reached_is_no_result_and_a_stop_keeps_what_is_known() {
    let found = search(&[vec![0, 0, 0]], &steps([1; 3]), Goal::Error(1e-9), model(BAD));
    assert_eq!((found.tried.len(), found.best, found.finished), (1, None, true));
    let (mut left, mut of) = (5, model(BAD));
    let limited = |assignment: &[usize]| {
        left -= 1;
        if left < 0 { None } else { of(assignment) }
    };
    let found = search(&[vec![8; 3]], &steps([9; 3]), Goal::Error(0.1), limited);
    assert!(found.tried.len() == 5 && found.best.is_some() && !found.finished);
}

#[test]
fn the_front_holds_what_nothing_beats() {
    let of = |cost, error| Tried { assignment: vec![], cost, error };
    let all = [of(3.0, 1.0), of(1.0, 3.0), of(2.0, 3.0), of(2.0, 2.0), of(1.0, 3.0)];
    assert_eq!(pareto(&all), [1, 3, 0]);
}
