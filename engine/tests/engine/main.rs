//! Tests of the guarantees of the engine. They run graphs of small arithmetic kinds and check the events.
#![allow(clippy::unwrap_used, reason = "a test may panic")]
#![allow(missing_docs, reason = "the names are self-explanatory")]

mod actions;
mod architecture;
mod arithmetic;
mod axes;
mod bundles;
mod columns;
mod failures;
mod faults;
mod fuzz;
mod includes;
mod invalidation;
#[cfg(unix)]
mod kills;
mod lab;
mod mistakes;
mod panics;
mod plans;
mod reparse;
mod running;
mod scheduling;
mod shapes;
mod subgraphs;
mod unchanged;
mod warm;
mod watching;
mod workers;
