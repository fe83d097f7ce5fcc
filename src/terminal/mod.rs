//! What people and programs read: lines, bars, JSON, and events in words.

pub mod causes;
pub mod measuring;
mod output;
pub mod planned;
mod report;
#[cfg(feature = "learned")]
pub mod training;
mod words;

pub use output::{colours, error, json_line, mistakes, names, no_file, print, remark};
pub use report::Report;
pub use words::{columns, counts_text, forecast_text, seconds_text};
