//! `lock`: records the inputs, kinds and results of a graph by digest.

use std::path::PathBuf;

use crate::session::{EngineArgs, Error, GraphArgs, locked};
use crate::terminal;
use clap::Args;

/// Writes a lock file: the digests of the inputs of a graph, the versions of its kinds and its known results.
#[derive(Debug, Args)]
pub struct MakeLock {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    /// The file to write; default: the graph file with the extension `.lock`
    #[arg(long, value_name = "FILE")]
    to: Option<PathBuf>,
}

impl MakeLock {
    /// Writes the lock and prints a summary of it.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let path = self.to.map_or_else(|| locked::path(&loaded), Ok)?;
        loaded.check_output(&path)?;
        let lock = self.engine.open()?.lock(&loaded.graph, &loaded.only)?;
        cache::publish_file(&path, lock.text().as_bytes())?;
        let (inputs, kinds, results) = (lock.inputs.len(), lock.kinds.len(), lock.results.len());
        terminal::print(&format!(
            "wrote {} (inputs: {inputs}, kinds: {kinds}, nodes with a result: {results} of {})\n",
            path.display(),
            loaded.graph.nodes.len()
        ))?;
        Ok(0)
    }
}
