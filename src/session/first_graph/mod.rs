//! The first graph for a capture: what is measured about the files, what is assumed, and the text of the graph.
//! `init` and the live page write it.

pub mod assumptions;
pub mod graph;
mod sky;
pub mod survey;
