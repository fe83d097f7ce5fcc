//! The parts that most verbs need first: a checked graph, a store, threads.

pub mod budget;
mod engine;
mod error;
mod graph;
pub mod locked;
mod names;
pub mod origin;
pub mod splats;

pub use engine::{EngineArgs, cache_folder, on_interrupt, size, time};
pub use error::Error;
pub use graph::{GraphArgs, Loaded};
pub use names::find;
