//! Counts of work, and what code took.

use std::collections::BTreeMap;

/// Deterministic counts of work.
pub type Counts = BTreeMap<String, u64>;

/// What the code of a node or a part took.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Effort {
    pub seconds: f64,
    pub cpu_seconds: f64,
    pub counts: Counts,
}

impl Effort {
    pub fn add(&mut self, other: &Self) {
        self.seconds += other.seconds;
        self.cpu_seconds += other.cpu_seconds;
        for (name, n) in &other.counts {
            *self.counts.entry(name.clone()).or_default() += n;
        }
    }
}
