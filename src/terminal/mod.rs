//! Output for people and programs: lines, bars, JSON, and events in words.

pub mod causes;
mod layout;
pub mod measuring;
mod output;
pub mod planned;
mod progress;
mod report;
#[cfg(feature = "learned")]
pub mod training;
mod words;

pub use layout::{paragraphs, width, wrapped};
pub use output::{colours, error, json_line, mistakes, no_file, print, remark};
pub use report::Report;
pub use words::{columns, counts_text, forecast_text, seconds_text};
