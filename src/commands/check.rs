//! `check`: every mistake of a graph file, without running it.

use clap::Args;

use crate::session::{Error, GraphArgs};

/// Reads a graph and reports every mistake in it.
#[derive(Debug, Args)]
pub struct Check {
    #[command(flatten)]
    graph: GraphArgs,
}

impl Check {
    /// Exit code 0 for a graph that can run; mistakes are an error.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let graph = &loaded.graph;
        let sinks = graph.nodes.iter().filter(|node| node.sink_path.is_some()).count();
        super::print(&format!(
            "{}: {} nodes, {sinks} sinks, no mistakes\n",
            graph.source.name,
            graph.nodes.len()
        ))?;
        Ok(0)
    }
}
