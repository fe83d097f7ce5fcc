//! The search for settings: knobs turned one at a time, and together as those turns are forecast to add up.

mod forecast;
mod tried;

use forecast::{combinations, effects};

pub use tried::{Goal, Tried, best, pareto};

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

struct Search<'s, M> {
    knobs: &'s [Steps],
    goal: Goal,
    measure: M,
    tried: Vec<Tried>,
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
        let all = combinations(here, &effects(&self.tried, here)).into_iter();
        let able = all.filter(|t| t.paid(goal) < bar && (!fitting || t.fits(goal)) && !known(t));
        let next = able.reduce(|a, b| if key(&b) < key(&a) { b } else { a })?;
        (fitting || next.bounded(goal) < here.bounded(goal)).then_some(next.assignment)
    }
}

#[cfg(test)]
mod tests;
