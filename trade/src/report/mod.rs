//! The measurements of `report`: the graph at its presets and as it is, and with one node at the reference at a
//! time.

mod json;
mod measure;
mod page;

pub use json::as_json;
pub use measure::{Measured, Stop, measure_all, settings};
pub use page::page;
