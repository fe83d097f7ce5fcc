//! The measurements of the subcommand `report`: the graph at each preset, with its own settings, and with one node
//! at a time at the reference.

mod json;
mod measure;
mod page;

pub use json::as_json;
pub use measure::{Measured, Stop, measure_all, settings};
pub use page::page;
