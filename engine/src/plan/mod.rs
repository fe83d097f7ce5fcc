//! What a run would do, and what earlier runs did: plans, last values, locks, differences.

pub(crate) mod diff;
pub(crate) mod last_values;
pub(crate) mod lock;
pub(crate) mod plan;
