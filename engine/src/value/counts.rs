//! Counts of work, and the time that code took.

use std::collections::BTreeMap;

/// Counts of work by name. They are deterministic.
pub type Counts = BTreeMap<String, u64>;

/// Time and counts of the code of a node or a part.
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
