//! Forecasts the combined effect of changes to several knobs from the effect of each single change.

use super::tried::Tried;

/// Maximum number of combinations that are kept after the changes of each knob have been added.
const COMBINATIONS: usize = 2000;

/// Effect of a change on cost and error. Two effects are combined by multiplying the cost factors and adding the
/// changes of the squared error, as if the errors had independent causes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Effect {
    cost: f64,
    square: f64,
}

impl Effect {
    const NONE: Self = Self { cost: 1.0, square: 0.0 };

    fn between(from: &Tried, to: &Tried) -> Self {
        // The cost may be 0, if no node of the graph has counts.
        let cost = |tried: &Tried| tried.cost + 1e-9;
        Self { cost: cost(to) / cost(from), square: to.error * to.error - from.error * from.error }
    }

    fn and(self, other: Self) -> Self {
        Self { cost: self.cost * other.cost, square: self.square + other.square }
    }

    fn reversed(self) -> Self {
        Self { cost: 1.0 / self.cost, square: -self.square }
    }

    /// Returns the position `assignment` with its forecast cost and error, which are the cost and error of `from`
    /// changed by this effect.
    fn on(self, from: &Tried, assignment: Vec<usize>) -> Tried {
        let error = (from.error * from.error + self.square).max(0.0).sqrt();
        Tried { assignment, cost: from.cost * self.cost, error }
    }
}

/// A measured change of one knob.
#[derive(Debug, Clone)]
struct Turn {
    from: usize,
    to: usize,
    effect: Effect,
    /// Distance between the two values, multiplied by `n + 1`, where `n` is the number of other knobs whose values
    /// during the measurement differ from their values at the current position.
    way: usize,
}

impl Turn {
    /// The values of a knob that can be reached from the value `at` by successive measured changes, each with the
    /// combined effect of the changes. For each value, the sequence with the smallest sum of `way` is used.
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

/// For each knob, the values to which it can be changed from the position `here`, with the effects of these
/// changes. The current value of the knob comes first. Each effect is derived from measured changes of this knob
/// alone. Small changes, and changes that were measured near `here`, are preferred.
pub(super) fn effects(tried: &[Tried], here: &Tried) -> Vec<Vec<(usize, Effect)>> {
    let knobs = here.assignment.len();
    let mut turns: Vec<Vec<Turn>> = vec![Vec::new(); knobs];
    for (index, a) in tried.iter().enumerate() {
        for b in &tried[..index] {
            let mut other = (0..knobs).filter(|&k| a.assignment[k] != b.assignment[k]);
            if let (Some(knob), None) = (other.next(), other.next()) {
                let rest = (0..knobs).filter(|&k| k != knob);
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

/// The positions that can be reached from `here` by combining changes. A position is left out if another position
/// is forecast to be at least as good in both cost and error.
pub(super) fn combinations(here: &Tried, effects: &[Vec<(usize, Effect)>]) -> Vec<Tried> {
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
