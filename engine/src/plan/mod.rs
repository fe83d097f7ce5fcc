//! The steps of a run beforehand, and the results of earlier runs: plans, last values, locks, differences.

pub(crate) mod diff;
pub(crate) mod last_values;
pub(crate) mod lock;
pub(crate) mod plan;
