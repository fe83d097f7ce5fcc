//! The contract with the crates of kinds: what a kind declares, and what its code may ask for.

pub(crate) mod context;
pub(crate) mod contract;
pub(crate) mod fields;
pub(crate) mod knob;
pub(crate) mod param_type;
pub(crate) mod params;
pub(crate) mod port;
pub(crate) mod registry;
pub(crate) mod tiles;
