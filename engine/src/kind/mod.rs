//! The interface for crates that define kinds: declarations of kinds, and the services available to their code.

pub(crate) mod context;
pub(crate) mod contract;
pub(crate) mod fields;
pub(crate) mod knob;
pub(crate) mod param_type;
pub(crate) mod params;
pub(crate) mod part;
pub(crate) mod port;
pub(crate) mod registry;
pub(crate) mod scene;
pub(crate) mod tiles;
