//! Benchmark of insertions: sets of cases whose truth is known, the graph that runs a method over all cases, and the
//! tables and the page that report its errors by region.
//!
//! A [`set::Set`] is read and checked as a whole. [`graph::compose`] makes one graph of all cases, which the engine
//! runs like any other, after [`mod@write`] has put it in a folder. [`scores`] reads the results of that run,
//! [`summary`] computes means with bootstrap intervals over scenes, and [`tables`] and [`page`] write them. This crate
//! prints nothing.

pub mod bootstrap;
pub mod case;
pub mod checksums;
mod error;
mod fields;
pub mod graph;
pub mod method;
pub mod page;
pub mod pictures;
pub mod scores;
pub mod set;
pub mod summary;
pub mod tables;
pub mod tier;
mod views;
pub mod write;

pub use error::{Error, Mistake, Mistakes};
