//! Plans of runs, and comparisons of earlier ones: last values, locks, differences.

pub(crate) mod diff;
pub(crate) mod last_values;
pub(crate) mod lock;
pub(crate) mod plan;
