//! The search for settings: one knob at a time by measured error for work, among values in a known order.

/// What is wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// The least work whose error is at most this.
    Error(f64),
    /// The least error whose cost is at most this.
    Cost(f64),
}

/// An assignment and what it was measured to cost and to be off.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    pub assignment: Vec<usize>,
    pub cost: f64,
    pub error: f64,
}

impl Tried {
    /// What the goal bounds.
    fn bounded(&self, goal: Goal) -> f64 {
        if matches!(goal, Goal::Error(_)) { self.error } else { self.cost }
    }

    /// What is to be least.
    fn paid(&self, goal: Goal) -> f64 {
        if matches!(goal, Goal::Error(_)) { self.cost } else { self.error }
    }

    fn fits(&self, goal: Goal) -> bool {
        let (Goal::Error(most) | Goal::Cost(most)) = goal;
        self.bounded(goal) <= most
    }

    /// Whether it serves the goal better than another that fits, too.
    fn beats(&self, other: &Self, goal: Goal) -> bool {
        let key = |t: &Self| [t.paid(goal), t.bounded(goal)];
        key(self) < key(other)
    }
}

/// Those of some points that no other one beats in both cost and error, by cost; of equal ones the first.
pub fn pareto(tried: &[Tried]) -> Vec<usize> {
    let mut by_cost: Vec<usize> = (0..tried.len()).collect();
    by_cost.sort_by(|&a, &b| {
        tried[a]
            .cost
            .total_cmp(&tried[b].cost)
            .then(tried[a].error.total_cmp(&tried[b].error))
            .then(a.cmp(&b))
    });
    let mut least = f64::INFINITY;
    by_cost.retain(|&index| {
        let better = tried[index].error < least;
        least = least.min(tried[index].error);
        better
    });
    by_cost
}

/// What a search found.
#[derive(Debug, PartialEq)]
pub struct SearchResult {
    /// Everything that was measured, in that order.
    pub tried: Vec<Tried>,
    /// Which of it serves the goal best.
    pub best: Option<usize>,
    /// Whether it came to its end; false where measuring was.
    pub finished: bool,
}

/// Searches from the given assignments. `knobs` has the number of values of each knob, `measure` gives cost and
/// error of an assignment, `None` once there is to be no more measuring; an assignment is measured once.
///
/// From the best start that fits every knob is turned by one step, down where work is to be saved and up where error
/// is, and the turns are tried together in the order of what each gained for what it lost, each kept where the goal
/// still holds; and so on until no turn helps, half a step neither. A start may spend on knobs that do little, and
/// turning others does not give that back. So the same is done from the start that misses the goal by the least, which
/// is first brought to it by the turns that gain most for what they lose; and to save error from the cheapest start,
/// keeping of a round the best turn alone. From the best of these local optima a knob is turned beyond the goal, and
/// others bring it back, as long as that is better.
pub fn search(
    starts: &[Vec<usize>],
    knobs: &[Steps],
    goal: Goal,
    measure: impl FnMut(&[usize]) -> Option<(f64, f64)>,
) -> SearchResult {
    let mut search = Search { knobs, goal, measure, tried: Vec::new() };
    let finished = search.whole(starts).is_some();
    SearchResult { best: search.best(|a, b| a.beats(b, goal)), tried: search.tried, finished }
}

/// How far a knob can be turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steps {
    /// How many values it has.
    pub values: usize,
    /// How many values make a step.
    pub step: usize,
}

struct Search<'s, M> {
    knobs: &'s [Steps],
    goal: Goal,
    measure: M,
    tried: Vec<Tried>,
}

/// Which way knobs are turned.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Direction {
    /// To less work.
    Down,
    /// To less error.
    Up,
}

impl<M: FnMut(&[usize]) -> Option<(f64, f64)>> Search<'_, M> {
    /// `None` where measuring ended before the search.
    fn whole(&mut self, starts: &[Vec<usize>]) -> Option<()> {
        for start in starts {
            self.measured(start)?;
        }
        let goal = self.goal;
        let cheapest = self.best(|a, b| a.cost < b.cost);
        let best = self.best(|a, b| a.beats(b, goal));
        // What costs more than the best already would not come to beat it.
        let bar = best.map_or(f64::INFINITY, |best| self.tried[best].paid(goal));
        let missing = (0..self.tried.len())
            .filter(|&index| !self.tried[index].fits(goal) && self.tried[index].paid(goal) < bar);
        let nearest = missing
            .reduce(|a, b| if self.tried[b].bounded(goal) < self.tried[a].bounded(goal) { b } else { a });
        if let Some(best) = best {
            self.climb(best, usize::MAX)?;
        }
        if let (Goal::Cost(_), Some(cheapest)) = (goal, cheapest) {
            self.climb(cheapest, 1)?;
        }
        if let Some(nearest) = nearest
            && let Some(reached) = self.reach(nearest, None)?
        {
            self.climb(reached, usize::MAX)?;
        }
        while let Some(better) = self.exchange()? {
            self.climb(better, usize::MAX)?;
        }
        Some(())
    }

    /// The index of an assignment among what was tried.
    fn measured(&mut self, assignment: &[usize]) -> Option<usize> {
        if let Some(known) = self.tried.iter().position(|t| t.assignment == assignment) {
            return Some(known);
        }
        let (cost, error) = (self.measure)(assignment)?;
        self.tried.push(Tried { assignment: assignment.to_vec(), cost, error });
        Some(self.tried.len() - 1)
    }

    /// Of what fits, that which `better` says of.
    fn best(&self, better: impl Fn(&Tried, &Tried) -> bool) -> Option<usize> {
        let fitting = (0..self.tried.len()).filter(|&index| self.tried[index].fits(self.goal));
        fitting.reduce(|best, index| if better(&self.tried[index], &self.tried[best]) { index } else { best })
    }

    /// An assignment with one knob turned by so many values, or to its end.
    fn stepped(
        &self,
        assignment: &[usize],
        knob: usize,
        direction: Direction,
        values: usize,
    ) -> Option<Vec<usize>> {
        let (at, last) = (assignment[knob], self.knobs[knob].values - 1);
        let to = match direction {
            Direction::Down => at.saturating_sub(values),
            Direction::Up => (at + values).min(last),
        };
        let mut assignment = assignment.to_vec();
        assignment[knob] = to;
        (to != at).then_some(assignment)
    }

    /// Turns knobs, at most so many in a round, until none helps. What did not help once is asked again only where
    /// nothing else does.
    fn climb(&mut self, mut from: usize, most: usize) -> Option<()> {
        let goal = self.goal;
        let direction = if matches!(goal, Goal::Error(_)) { Direction::Down } else { Direction::Up };
        let all: Vec<usize> = (0..self.knobs.len()).collect();
        let (mut open, mut whole) = (all.clone(), true);
        loop {
            let here = self.tried[from].clone();
            let mut turns = Vec::new();
            for &knob in &open {
                let values = if whole { self.knobs[knob].step } else { 1 };
                let Some(assignment) = self.stepped(&here.assignment, knob, direction, values) else {
                    continue;
                };
                let at = self.measured(&assignment)?;
                let there = &self.tried[at];
                if there.fits(goal) && there.beats(&here, goal) {
                    let saved = here.paid(goal) - there.paid(goal);
                    let lost = there.bounded(goal) - here.bounded(goal);
                    // What gains and loses nothing comes first.
                    turns.push((saved / lost.max(1e-12), knob, values));
                }
            }
            turns.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            let helped: Vec<usize> = turns.iter().map(|(_, knob, _)| *knob).collect();
            let mut at = from;
            for (_, knob, values) in turns.into_iter().take(most) {
                let Some(assignment) = self.stepped(&self.tried[at].assignment, knob, direction, values)
                else {
                    continue;
                };
                let next = self.measured(&assignment)?;
                if self.tried[next].fits(goal) && self.tried[next].beats(&self.tried[at], goal) {
                    at = next;
                }
            }
            match (at == from, open.len() == all.len()) {
                (false, _) => open.retain(|knob| helped.contains(knob)),
                (true, false) => open.clone_from(&all),
                (true, true) if whole => whole = false,
                (true, true) => return Some(()),
            }
            from = at;
        }
    }

    /// A better position than the best one, by one knob half a step beyond the goal, those that save most first, and
    /// others back to it; the inner `None` where there is none.
    fn exchange(&mut self) -> Option<Option<usize>> {
        let goal = self.goal;
        let Some(best) = self.best(|a, b| a.beats(b, goal)) else { return Some(None) };
        let here = self.tried[best].clone();
        let direction = if matches!(goal, Goal::Error(_)) { Direction::Down } else { Direction::Up };
        let mut beyond = Vec::new();
        for knob in 0..self.knobs.len() {
            let Some(assignment) = self.stepped(&here.assignment, knob, direction, 1) else { continue };
            let at = self.measured(&assignment)?;
            let saved = 1.0 - self.tried[at].paid(goal) / here.paid(goal);
            // What saves less is not worth the measuring.
            if saved > 0.02 {
                beyond.push((saved, knob, at));
            }
        }
        beyond.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        for (_, knob, at) in beyond {
            let reached = self.reach(at, Some((knob, best)))?;
            if let Some(reached) = reached.filter(|&at| self.tried[at].beats(&here, goal)) {
                return Some(Some(reached));
            }
        }
        Some(None)
    }

    /// Turns knobs until the goal holds; the inner `None` where that does not come about. `beside` has a knob to leave
    /// as it is, and what is to be beaten.
    fn reach(&mut self, mut from: usize, beside: Option<(usize, usize)>) -> Option<Option<usize>> {
        let goal = self.goal;
        let direction = if matches!(goal, Goal::Error(_)) { Direction::Up } else { Direction::Down };
        // What a turn gains towards the goal, and what it loses.
        let gained = |a: &Tried, b: &Tried| (a.bounded(goal) - b.bounded(goal), b.paid(goal) - a.paid(goal));
        while !self.tried[from].fits(goal) {
            let here = self.tried[from].clone();
            if beside.is_some_and(|(_, best)| here.paid(goal) >= self.tried[best].paid(goal)) {
                return Some(None);
            }
            let mut turns = Vec::new();
            let open = (0..self.knobs.len()).filter(|&knob| beside.is_none_or(|(fixed, _)| fixed != knob));
            for knob in open {
                let Some(assignment) = self.stepped(&here.assignment, knob, direction, self.knobs[knob].step)
                else {
                    continue;
                };
                let at = self.measured(&assignment)?;
                let (gain, loss) = gained(&here, &self.tried[at]);
                if gain > 0.0 {
                    turns.push((gain / loss.max(1e-12), knob));
                }
            }
            turns.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            let mut at = from;
            for (_, knob) in turns {
                let assignment = &self.tried[at].assignment;
                let Some(assignment) = self.stepped(assignment, knob, direction, self.knobs[knob].step)
                else {
                    continue;
                };
                let next = self.measured(&assignment)?;
                if gained(&self.tried[at], &self.tried[next]).0 > 0.0 {
                    at = next;
                }
                if self.tried[at].fits(goal) {
                    break;
                }
            }
            if at == from {
                return Some(None);
            }
            from = at;
        }
        Some(Some(from))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
mod tests {
    use super::*;

    /// Costs double with each value; errors are independent and halve, as noise and resolution do.
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

    fn exhaustive(
        sizes: &[usize],
        goal: Goal,
        mut measure: impl FnMut(&[usize]) -> Option<(f64, f64)>,
    ) -> Tried {
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
        values.map(|values| Steps { values, step: 1 })
    }

    // One knob is dear and does little: a preset turns it up all the same.
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
            let naive =
                tried[..4].iter().filter(|t| t.fits(goal)).map(|t| t.cost).fold(f64::INFINITY, f64::min);
            assert!(best.error <= most && best.cost <= 1.1 * ideal.cost, "{best:?} {ideal:?}");
            assert!(best.cost < 0.5 * naive || naive == ideal.cost, "{best:?} {naive}");
            assert!(tried.len() <= 4 + 2 * 27, "{}", tried.len());
        }
    }

    #[test]
    fn the_least_error_within_a_cost() {
        let (sizes, goal) = ([9, 9, 9], Goal::Cost(900.0));
        let SearchResult { tried, best, .. } =
            search(&[vec![0; 3], vec![3; 3]], &steps(sizes), goal, model(BAD));
        let (best, ideal) = (&tried[best.unwrap()], exhaustive(&sizes, goal, model(BAD)));
        assert!(best.cost <= 900.0 && best.error <= 1.2 * ideal.error, "{best:?} {ideal:?}");
    }

    // Two knobs help together alone, as samples and the pixels that they are taken of may: from the cheapest start
    // nothing is found.
    #[test]
    fn the_best_start_is_searched_from_as_well() {
        let measure = |assignment: &[usize]| {
            let error =
                if assignment[0].min(assignment[1]) > 0 { 1.0 / (assignment[2] + 1) as f64 } else { 2.0 };
            Some((1.0 + assignment.iter().sum::<usize>() as f64, error))
        };
        let SearchResult { tried, best, finished } =
            search(&[vec![0; 3], vec![1, 1, 0]], &steps([4; 3]), Goal::Cost(5.0), measure);
        assert!(finished && tried[best.unwrap()].assignment == [1, 1, 2], "{tried:?}");
    }

    // The best start that fits has two dear knobs that err where they are not turned alike, so no turn down from it
    // helps; from the start that misses the error what pays is turned up alone.
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

    // No turn helps alone: the dear knob goes down where the cheap one goes up.
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

    // Two values make a step: one is tried where no step helps.
    #[test]
    fn halves_of_steps_come_last() {
        let measure = |assignment: &[usize]| Some((assignment[0] as f64, 8.0 - assignment[0] as f64));
        let one = [Steps { values: 9, step: 2 }];
        let SearchResult { tried, best, finished } = search(&[vec![8]], &one, Goal::Error(3.0), measure);
        assert!(finished && tried[best.unwrap()].assignment == [5], "{tried:?}");
        let order: Vec<usize> = tried.iter().map(|t| t.assignment[0]).collect();
        assert_eq!(order, [8, 6, 4, 5]);
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
}
