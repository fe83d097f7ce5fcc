//! Identity and stored form of results: keys, records, recipes, timings.

pub(crate) mod action;
pub(crate) mod key;
pub(crate) mod pace;
pub(crate) mod recipe;
pub(crate) mod record;
