//! The search for settings: knobs turned one at a time, and together as those turns are forecast to add up.

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

/// What serves a goal best of all that fits; of equal ones the first.
pub fn best(tried: &[Tried], goal: Goal) -> Option<usize> {
    let fitting = (0..tried.len()).filter(|&at| tried[at].fits(goal));
    fitting.reduce(|a, b| if tried[b].beats(&tried[a], goal) { b } else { a })
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

/// How far a knob can be turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steps {
    /// How many values it has.
    pub values: usize,
    /// How many values make a step.
    pub step: usize,
    /// Whether values go from the least work to the most; else they are others, such as methods.
    pub ordered: bool,
}

/// Searches from the given assignments. `knobs` has the number of values of each knob, `measure` gives cost and
/// error of an assignment, `None` once there is to be no more measuring; an assignment is measured once.
///
/// From the best start that fits every knob is turned alone, by one step. What turns do to cost and error is then
/// forecast for all of them together, and the best of those is measured; from there the next, now that it is known how
/// far the forecast was off; a few times, and all of it again from what is better. First what saves is turned, then what
/// is bounded is made room for, then half steps are. A start may spend on knobs that do little, or on two that help
/// together alone, so the same is done from the start that misses the goal by the least.
pub fn search(
    starts: &[Vec<usize>],
    knobs: &[Steps],
    goal: Goal,
    measure: impl FnMut(&[usize]) -> Option<(f64, f64)>,
) -> SearchResult {
    let mut search = Search { knobs, goal, measure, tried: Vec::new() };
    let finished = search.whole(starts).is_some();
    SearchResult { best: search.best(), tried: search.tried, finished }
}

/// How often a forecast is followed from one position.
const FOLLOWED: usize = 5;
/// What is forecast to save less of the cost or the error is not worth measuring.
const GAIN: f64 = 0.01;
/// How many turns beyond the goal are tried to be made room for.
const BEYOND: usize = 3;
/// Most combinations of turns that are kept while others are added to them.
const COMBINATIONS: usize = 2000;

struct Search<'s, M> {
    knobs: &'s [Steps],
    goal: Goal,
    measure: M,
    tried: Vec<Tried>,
}

/// What a turn does: costs are multiplied, and squares of errors add up, as those of independent causes do.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Effect {
    cost: f64,
    square: f64,
}

impl Effect {
    const NONE: Self = Self { cost: 1.0, square: 0.0 };

    fn between(from: &Tried, to: &Tried) -> Self {
        // A graph may have nothing that is counted.
        let cost = |tried: &Tried| tried.cost + 1e-9;
        Self { cost: cost(to) / cost(from), square: to.error * to.error - from.error * from.error }
    }

    fn and(self, other: Self) -> Self {
        Self { cost: self.cost * other.cost, square: self.square + other.square }
    }

    fn reversed(self) -> Self {
        Self { cost: 1.0 / self.cost, square: -self.square }
    }

    /// What it makes of a position.
    fn on(self, from: &Tried, assignment: Vec<usize>) -> Tried {
        let error = (from.error * from.error + self.square).max(0.0).sqrt();
        Tried { assignment, cost: from.cost * self.cost, error }
    }
}

impl<M: FnMut(&[usize]) -> Option<(f64, f64)>> Search<'_, M> {
    /// `None` where measuring ended before the search.
    fn whole(&mut self, starts: &[Vec<usize>]) -> Option<()> {
        for start in starts {
            self.measured(start)?;
        }
        let best = self.best();
        let missing = (0..self.tried.len()).filter(|&at| !self.tried[at].fits(self.goal) && self.saves(at));
        let nearest = missing.reduce(|a, b| if self.bounded(b) < self.bounded(a) { b } else { a });
        for from in best.into_iter().chain(nearest) {
            self.improve(from)?;
        }
        if self.best().is_none() && matches!(self.goal, Goal::Cost(_)) {
            self.least_of_all()?;
        }
        while let Some(best) = self.best() {
            for from in self.beyond(best) {
                self.improve(from)?;
            }
            if self.best() == Some(best) {
                break;
            }
        }
        Some(())
    }

    /// Where nothing is known to fit a cost, the position with every knob at its least, and from there to better ones.
    fn least_of_all(&mut self) -> Option<()> {
        let Some(nearest) = self.nearest() else { return Some(()) };
        let mut least = self.tried[nearest].assignment.clone();
        for (at, _) in least.iter_mut().zip(self.knobs).filter(|(_, knob)| knob.ordered) {
            *at = 0;
        }
        let least = self.measured(&least)?;
        if self.tried[least].fits(self.goal) { self.improve(least) } else { Some(()) }
    }

    /// What misses the goal by the least of all that was tried.
    fn nearest(&self) -> Option<usize> {
        (0..self.tried.len()).reduce(|a, b| if self.bounded(b) < self.bounded(a) { b } else { a })
    }

    /// What a single turn of a position led to that would save most, and does not fit.
    fn beyond(&self, from: usize) -> Vec<usize> {
        let here = &self.tried[from];
        let turned = |t: &Tried| t.assignment.iter().zip(&here.assignment).filter(|(a, b)| a != b).count();
        let mut all: Vec<usize> = (0..self.tried.len())
            .filter(|&at| turned(&self.tried[at]) == 1 && !self.tried[at].fits(self.goal) && self.saves(at))
            .collect();
        all.sort_by(|&a, &b| self.tried[a].paid(self.goal).total_cmp(&self.tried[b].paid(self.goal)));
        all.truncate(BEYOND);
        all
    }

    fn bounded(&self, at: usize) -> f64 {
        self.tried[at].bounded(self.goal)
    }

    /// Whether a position pays less than the best that fits, as far as is known.
    fn saves(&self, at: usize) -> bool {
        self.best().is_none_or(|best| self.tried[at].paid(self.goal) < self.tried[best].paid(self.goal))
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

    fn best(&self) -> Option<usize> {
        best(&self.tried, self.goal)
    }

    /// Goes on from a position to better ones until nothing is forecast to be, and no single turn is.
    fn improve(&mut self, mut from: usize) -> Option<()> {
        let mut stage = 0;
        while stage < if self.tried[from].fits(self.goal) { 5 } else { 2 } {
            let before = self.best();
            self.turn_each(from, stage)?;
            let nearer = self.follow(from)?;
            let better = self.best().filter(|_| self.best() != before);
            match better.or(nearer) {
                Some(next) => (from, stage) = (next, 0),
                None => stage += 1,
            }
        }
        Some(())
    }

    /// Turns every knob alone of which it is not known what that does: of what fits in turn to save and to make room,
    /// by whole steps and then by halves, and at last to save where it is known as well; else towards fitting.
    fn turn_each(&mut self, from: usize, stage: usize) -> Option<()> {
        let here = self.tried[from].clone();
        let fits = here.fits(self.goal);
        let down = (fits && stage.is_multiple_of(2)) == matches!(self.goal, Goal::Error(_));
        let (halves, again) = (stage >= if fits { 2 } else { 1 }, stage == 4);
        let effects = self.effects(&here);
        for (knob, Steps { values, step, .. }) in self.knobs.iter().enumerate() {
            let (at, by) = (here.assignment[knob], if halves { 1 } else { *step });
            let to = if down { at.saturating_sub(by) } else { (at + by).min(values - 1) };
            if again || effects[knob].iter().all(|(value, _)| *value != to) {
                let mut assignment = here.assignment.clone();
                assignment[knob] = to;
                self.measured(&assignment)?;
            }
        }
        Some(())
    }

    /// Measures what is forecast to be best, and from there again, until it is. From what does not fit gives, where nothing
    /// is forecast to, a position that is nearer to it.
    fn follow(&mut self, from: usize) -> Option<Option<usize>> {
        let (before, mut at) = (self.best(), from);
        for _ in 0..FOLLOWED {
            let Some(next) = self.forecast(at, true) else { break };
            at = self.measured(&next)?;
            if self.best() != before {
                return Some(None);
            }
        }
        if self.tried[from].fits(self.goal) {
            return Some(None);
        }
        let next = match self.forecast(from, false) {
            Some(next) => Some(self.measured(&next)?),
            // Turns alone may have led nearer, where there is nothing to combine: on from there, as long as nothing fits.
            None if self.best().is_none() => self.nearest(),
            None => None,
        };
        Some(next.filter(|&next| self.bounded(next) < self.bounded(from)))
    }

    /// The assignment not yet measured that is forecast to serve the goal best, and better than all that is known; else the one
    /// to come nearest to fitting for less.
    fn forecast(&self, from: usize, fitting: bool) -> Option<Vec<usize>> {
        let (here, goal) = (&self.tried[from], self.goal);
        let bar = self.best().map_or(f64::INFINITY, |best| (1.0 - GAIN) * self.tried[best].paid(goal));
        let key = |t: &Tried| if fitting { t.paid(goal) } else { t.bounded(goal) };
        let known = |t: &Tried| self.tried.iter().any(|tried| tried.assignment == t.assignment);
        let all = combinations(here, &self.effects(here)).into_iter();
        let able = all.filter(|t| t.paid(goal) < bar && (!fitting || t.fits(goal)) && !known(t));
        let next = able.reduce(|a, b| if key(&b) < key(&a) { b } else { a })?;
        (fitting || next.bounded(goal) < here.bounded(goal)).then_some(next.assignment)
    }

    /// For each knob the values it can be turned to from a position and what that does, its own value first: as measured
    /// by turns of it alone, the shortest and those where most other knobs stood as they do here.
    fn effects(&self, here: &Tried) -> Vec<Vec<(usize, Effect)>> {
        let mut turns: Vec<Vec<Turn>> = vec![Vec::new(); self.knobs.len()];
        for (index, a) in self.tried.iter().enumerate() {
            for b in &self.tried[..index] {
                let mut other = (0..self.knobs.len()).filter(|&k| a.assignment[k] != b.assignment[k]);
                if let (Some(knob), None) = (other.next(), other.next()) {
                    let rest = (0..self.knobs.len()).filter(|&k| k != knob);
                    let apart = rest.filter(|&k| a.assignment[k] != here.assignment[k]).count();
                    let (from, to) = (a.assignment[knob], b.assignment[knob]);
                    let (way, effect) = ((apart + 1) * from.abs_diff(to), Effect::between(a, b));
                    turns[knob].push(Turn { way, from, to, effect });
                    turns[knob].push(Turn { way, from: to, to: from, effect: effect.reversed() });
                }
            }
        }
        turns.iter().zip(&here.assignment).map(|(turns, &at)| Turn::all_from(at, turns)).collect()
    }
}

/// A turn of one knob that was measured.
#[derive(Debug, Clone)]
struct Turn {
    from: usize,
    to: usize,
    effect: Effect,
    /// How little it says of a turn elsewhere.
    way: usize,
}

impl Turn {
    /// Where turns lead from a value, one after the other, by the shortest way.
    fn all_from(at: usize, turns: &[Self]) -> Vec<(usize, Effect)> {
        let mut known = vec![(at, Effect::NONE, 0)];
        let place = |known: &[(usize, Effect, usize)], value| known.iter().position(|(to, ..)| *to == value);
        loop {
            let next = turns.iter().filter(|turn| place(&known, turn.to).is_none());
            let next = next.filter_map(|turn| {
                let (_, before, way) = known[place(&known, turn.from)?];
                Some((turn.to, before.and(turn.effect), way + turn.way))
            });
            match next.min_by_key(|(.., way)| *way) {
                Some(next) => known.push(next),
                None => return known.into_iter().map(|(to, effect, _)| (to, effect)).collect(),
            }
        }
    }
}

/// Of all that turns from a position can be combined to, what no other combination is forecast to beat in both.
fn combinations(here: &Tried, effects: &[Vec<(usize, Effect)>]) -> Vec<Tried> {
    let mut front = vec![(Vec::new(), Effect::NONE)];
    for values in effects {
        let mut all = Vec::with_capacity(front.len() * values.len());
        for (assignment, effect) in &front {
            all.extend(values.iter().map(|(value, more)| {
                let mut assignment = assignment.clone();
                assignment.push(*value);
                (assignment, effect.and(*more))
            }));
        }
        all.sort_by(|(_, a), (_, b)| a.cost.total_cmp(&b.cost).then(a.square.total_cmp(&b.square)));
        let mut least = f64::INFINITY;
        all.retain(|(_, effect)| {
            let better = effect.square < least;
            least = least.min(effect.square);
            better
        });
        let every = all.len().div_ceil(COMBINATIONS);
        front = all.into_iter().step_by(every.max(1)).collect();
    }
    front.into_iter().map(|(assignment, effect)| effect.on(here, assignment)).collect()
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
        values.map(|values| Steps { values, step: 1, ordered: true })
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

    // One knob costs, and it takes more than one step to where that fits; and all of them must be at their least.
    #[test]
    fn a_cost_below_the_cheapest_start_is_walked_down_to() {
        let measure = |assignment: &[usize]| {
            let [a, b] = [0, 1].map(|knob| assignment[knob] as f64);
            Some((50.0 + 40.0 * a + b, 10.0 - a - 0.1 * b))
        };
        let halves =
            [Steps { values: 8, step: 2, ordered: true }, Steps { values: 3, step: 1, ordered: true }];
        for (most, expected) in [(51.5, vec![0, 1]), (50.0, vec![0, 0]), (129.0, vec![1, 2])] {
            let SearchResult { tried, best, finished } =
                search(&[vec![7, 2], vec![6, 0]], &halves, Goal::Cost(most), measure);
            assert!(
                finished && best.is_some_and(|best| tried[best].assignment == expected),
                "{most}: {tried:?}"
            );
        }
        let SearchResult { tried, best, finished } =
            search(&[vec![7, 2]], &halves, Goal::Cost(49.0), measure);
        assert!(finished && best.is_none() && tried.iter().any(|t| t.assignment == [0, 0]), "{tried:?}");
        // No turn saves alone.
        let level = |a: &[usize]| Some((if a == [0, 0, 0] { 1.0 } else { 9.0 }, a[0] as f64));
        let SearchResult { tried, best, .. } =
            search(&[vec![3, 3, 3]], &steps([4; 3]), Goal::Cost(2.0), level);
        assert!(best.is_some_and(|best| tried[best].assignment == [0, 0, 0]), "{tried:?}");
    }

    // Two values make a step: one is tried where no step helps.
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
}
