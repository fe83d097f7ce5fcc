//! The search for settings. Knobs are first changed one at a time. Then several knobs are changed together, as
//! suggested by a forecast.

mod forecast;
mod tried;

use forecast::{combinations, effects};

pub use tried::{Goal, Tried, best, pareto};

/// The result of a search.
#[derive(Debug, PartialEq)]
pub struct SearchResult {
    /// All measured settings, in the order of measurement.
    pub tried: Vec<Tried>,
    /// The index of the best setting that reaches the goal.
    pub best: Option<usize>,
    /// True if the search finished; false if measuring ended first.
    pub finished: bool,
}

/// The range of a knob.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steps {
    /// Number of values.
    pub values: usize,
    /// Number of values by which the search moves in one step.
    pub step: usize,
    /// True if the values are sorted by increasing work; false if they have no order, for example if they are names
    /// of methods.
    pub ordered: bool,
}

/// Searches for the best assignment, starting from the assignments in `starts`. `knobs` contains the range of each
/// knob. `measure` returns the cost and error of an assignment, or `None` to end the search. Each assignment is
/// measured only once.
///
/// The search begins with the best start that reaches the goal:
/// 1. Every knob is changed alone, by one step.
/// 2. From the results, the cost and error of all combinations of changes are forecast, and the best combination is
///    measured. The measurement corrects the forecast, and this step is repeated a few times.
/// 3. When a better position is found, the whole procedure starts again from there.
///
/// Changes that reduce the value to minimize are tried first, then changes that reduce the bounded value, then half
/// steps. The search may miss better positions if the start spends cost on knobs with little effect, or on two
/// knobs that help only together. It is therefore repeated from the start that comes closest to the goal without
/// reaching it.
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

/// Maximum number of forecasts that are measured one after another from one position.
const FOLLOWED: usize = 5;
/// Minimum saving that a forecast must promise before it is measured, as a share of the value to minimize.
const GAIN: f64 = 0.01;
/// Maximum number of positions that miss the goal but from which the search still continues. Each of these
/// positions differs from the best position in one knob.
const BEYOND: usize = 3;

struct Search<'s, M> {
    knobs: &'s [Steps],
    goal: Goal,
    measure: M,
    tried: Vec<Tried>,
}

impl<M: FnMut(&[usize]) -> Option<(f64, f64)>> Search<'_, M> {
    /// Runs the whole search. Returns `None` if measuring ended before the search finished.
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

    /// Measures the position with every ordered knob at its minimum, and improves it if it reaches the goal. Called
    /// if no known position reaches the goal.
    fn least_of_all(&mut self) -> Option<()> {
        let Some(nearest) = self.nearest() else { return Some(()) };
        let mut least = self.tried[nearest].assignment.clone();
        for (at, _) in least.iter_mut().zip(self.knobs).filter(|(_, knob)| knob.ordered) {
            *at = 0;
        }
        let least = self.measured(&least)?;
        if self.tried[least].fits(self.goal) { self.improve(least) } else { Some(()) }
    }

    /// The measured position with the smallest bounded value. If no position reaches the goal, this position comes
    /// closest to it.
    fn nearest(&self) -> Option<usize> {
        (0..self.tried.len()).reduce(|a, b| if self.bounded(b) < self.bounded(a) { b } else { a })
    }

    /// The positions that miss the goal, differ from `from` in one knob, and have a smaller value to minimize than
    /// the best position that reaches the goal. At most [`BEYOND`] positions with the smallest such values are
    /// returned.
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

    /// True if the value to minimize is smaller at the position `at` than at the best known position that reaches
    /// the goal, or if no known position reaches the goal.
    fn saves(&self, at: usize) -> bool {
        self.best().is_none_or(|best| self.tried[at].paid(self.goal) < self.tried[best].paid(self.goal))
    }

    /// Measures an assignment, unless it was measured before. Returns its index in `tried`; `None` ends the search.
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

    /// Moves from position to position as long as a forecast or a change of one knob leads to a better position.
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

    /// Changes each knob whose effect is unknown, one at a time. `stage` selects the direction, and whole or half
    /// steps. From a position that reaches the goal, even stages reduce the value to minimize, and odd stages
    /// reduce the bounded value; the last stage also changes knobs whose effect is known. From any other position,
    /// all changes reduce the bounded value.
    fn turn_each(&mut self, from: usize, stage: usize) -> Option<()> {
        let here = self.tried[from].clone();
        let fits = here.fits(self.goal);
        let down = (fits && stage.is_multiple_of(2)) == matches!(self.goal, Goal::Error(_));
        let (halves, again) = (stage >= if fits { 2 } else { 1 }, stage == 4);
        let effects = effects(&self.tried, &here);
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

    /// Measures the position with the best forecast, and continues from there until no better position is forecast.
    /// If neither `from` nor any position measured here reaches the goal, returns a position that is nearer to the
    /// goal, if one is found. If the outer option is `None`, the search ends.
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
            // If there is nothing to combine, single changes may have led nearer to the goal. The search continues
            // from there as long as no position reaches it.
            None if self.best().is_none() => self.nearest(),
            None => None,
        };
        Some(next.filter(|&next| self.bounded(next) < self.bounded(from)))
    }

    /// The unmeasured assignment with the best forecast. If `fitting` is true, the forecast must reach the goal and
    /// be better than all known positions that reach it. Otherwise, the forecast must be nearer to the goal than
    /// `from`.
    fn forecast(&self, from: usize, fitting: bool) -> Option<Vec<usize>> {
        let (here, goal) = (&self.tried[from], self.goal);
        let bar = self.best().map_or(f64::INFINITY, |best| (1.0 - GAIN) * self.tried[best].paid(goal));
        let key = |t: &Tried| if fitting { t.paid(goal) } else { t.bounded(goal) };
        let known = |t: &Tried| self.tried.iter().any(|tried| tried.assignment == t.assignment);
        let all = combinations(here, &effects(&self.tried, here)).into_iter();
        let able = all.filter(|t| t.paid(goal) < bar && (!fitting || t.fits(goal)) && !known(t));
        let next = able.reduce(|a, b| if key(&b) < key(&a) { b } else { a })?;
        (fitting || next.bounded(goal) < here.bounded(goal)).then_some(next.assignment)
    }
}

#[cfg(test)]
mod tests;
