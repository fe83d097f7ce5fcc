//! Keys, records, recipes and timings: the identity of results, and the form in which they are stored.

pub(crate) mod action;
pub(crate) mod key;
pub(crate) mod pace;
pub(crate) mod recipe;
pub(crate) mod record;
