//! Plans of runs, and queries about earlier runs: last values, locks, differences.

pub(crate) mod diff;
pub(crate) mod last_values;
pub(crate) mod lock;
pub(crate) mod plan;
