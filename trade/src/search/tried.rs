//! Tried positions, and their order by a goal.

/// The goal of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// The least work whose error is at most this.
    Error(f64),
    /// The least error whose cost is at most this.
    Cost(f64),
}

/// An assignment with its measured cost and error.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// For each knob the index of its value.
    pub assignment: Vec<usize>,
    /// Measured cost, in the unit of the goal.
    pub cost: f64,
    /// Measured error.
    pub error: f64,
}

impl Tried {
    /// The value that the goal bounds.
    pub(super) fn bounded(&self, goal: Goal) -> f64 {
        if matches!(goal, Goal::Error(_)) { self.error } else { self.cost }
    }

    /// The value to minimize.
    pub(super) fn paid(&self, goal: Goal) -> f64 {
        if matches!(goal, Goal::Error(_)) { self.cost } else { self.error }
    }

    pub(super) fn fits(&self, goal: Goal) -> bool {
        let (Goal::Error(most) | Goal::Cost(most)) = goal;
        self.bounded(goal) <= most
    }

    /// True if it serves the goal better than another that fits.
    pub(super) fn beats(&self, other: &Self, goal: Goal) -> bool {
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

/// The best position for a goal of those that fit; of equal ones the first.
pub fn best(tried: &[Tried], goal: Goal) -> Option<usize> {
    let fitting = (0..tried.len()).filter(|&at| tried[at].fits(goal));
    fitting.reduce(|a, b| if tried[b].beats(&tried[a], goal) { b } else { a })
}
