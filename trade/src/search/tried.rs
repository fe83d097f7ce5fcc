//! Measured positions, and their order with respect to a goal.

/// The goal of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// Minimize the cost, with at most this error.
    Error(f64),
    /// Minimize the error, with at most this cost.
    Cost(f64),
}

/// An assignment with its measured cost and error.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// For each knob, the index of its value.
    pub assignment: Vec<usize>,
    /// Measured cost, in the unit of the goal.
    pub cost: f64,
    /// Measured error.
    pub error: f64,
}

impl Tried {
    /// The value that the goal bounds: error or cost.
    pub(super) fn bounded(&self, goal: Goal) -> f64 {
        if matches!(goal, Goal::Error(_)) { self.error } else { self.cost }
    }

    /// The value that the search minimizes: cost or error.
    pub(super) fn paid(&self, goal: Goal) -> f64 {
        if matches!(goal, Goal::Error(_)) { self.cost } else { self.error }
    }

    pub(super) fn fits(&self, goal: Goal) -> bool {
        let (Goal::Error(most) | Goal::Cost(most)) = goal;
        self.bounded(goal) <= most
    }

    /// True if this position is better than `other`. Both must reach the goal.
    pub(super) fn beats(&self, other: &Self, goal: Goal) -> bool {
        let key = |t: &Self| [t.paid(goal), t.bounded(goal)];
        key(self) < key(other)
    }
}

/// The indices of the positions that no other position beats in both cost and error, sorted by cost. If several
/// positions are equal, only the first is listed.
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

/// The index of the best position that reaches the goal. If several positions are equally good, the index of the
/// first.
pub fn best(tried: &[Tried], goal: Goal) -> Option<usize> {
    let fitting = (0..tried.len()).filter(|&at| tried[at].fits(goal));
    fitting.reduce(|a, b| if tried[b].beats(&tried[a], goal) { b } else { a })
}
