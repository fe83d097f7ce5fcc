//! What identifies a node's result and what is stored of it: keys, records, recipes, timings.

pub(crate) mod action;
pub(crate) mod key;
pub(crate) mod pace;
pub(crate) mod recipe;
pub(crate) mod record;
