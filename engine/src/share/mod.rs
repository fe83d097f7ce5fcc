//! Sharing graphs: bundles, and recipes in pictures.

pub(crate) mod action;
pub(crate) mod bundle;
pub(crate) mod canary;
pub(crate) mod pairing;
pub(crate) mod recipe_error;
pub(crate) mod rerun;
pub(crate) mod source_index;
