//! Measurement of work and error. The crate lists the knobs of a graph, searches for settings that reach a required
//! error with little work, and makes a page that shows the cost of each node and the error that the node causes.
//!
//! A [`bench::Bench`] runs a graph at settings of its knobs and compares the pictures with the pictures of the
//! preset `reference`. [`tune`] uses it for searches, and [`report`] to make a page. This crate prints nothing; the
//! subcommands of the program do.

pub mod attribution;
pub mod below;
pub mod bench;
mod deadline;
mod error;
pub mod escape;
pub mod html;
pub mod judge;
pub mod knobs;
pub mod left_out;
mod metric;
mod off;
mod outlook;
pub mod plot;
pub mod report;
pub mod search;
pub mod tunables;
pub mod tune;
pub mod work;

pub use error::Error;
pub use metric::{Metric, number};
pub use off::Off;
pub use outlook::Outlook;
