//! `pack`: writes a graph, its inputs and its results to one file.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use engine::{Results, bytes_text};

use crate::session::{EngineArgs, Error, GraphArgs};
use crate::terminal::{self, remark};

/// Packs a graph, its input files, its lock and chosen results into one file.
#[derive(Debug, Args)]
pub struct Pack {
    #[command(flatten)]
    graph: GraphArgs,
    /// The bundle to write
    bundle: PathBuf,
    /// The nodes whose values are packed; digests of all known results are always included
    #[arg(long, value_enum, default_value_t = Which::Sinks)]
    results: Which,
    #[command(flatten)]
    engine: EngineArgs,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Which {
    /// Digests only
    None,
    /// The sinks, or the nodes of `--only`
    Sinks,
    /// Every node, so that `verify` need not compute the inputs of the nodes that it checks
    All,
}

impl Pack {
    /// Writes the bundle and prints a summary of it.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        loaded.check_output(&self.bundle)?;
        let engine = self.engine.open()?;
        let results = match self.results {
            Which::None => Results::Digests,
            Which::Sinks => Results::Targets,
            Which::All => Results::All,
        };
        let named = |error: engine::BundleError| Error::of_file(&self.bundle, &error);
        let mut packed = None;
        cache::publish_through(&self.bundle, |mut to| {
            packed = Some(engine.pack(&loaded.graph, &loaded.only, results, &mut to).map_err(named)?);
            Ok::<(), Error>(())
        })?;
        let packed = packed.unwrap_or_default();
        let bytes = std::fs::metadata(&self.bundle)?.len();
        terminal::print(&format!(
            "wrote {} ({}; inputs: {}, nodes with a result: {}, nodes with values: {})\n",
            self.bundle.display(),
            bytes_text(bytes),
            packed.inputs,
            packed.known,
            packed.values
        ))?;
        if !packed.unknown.is_empty() {
            let nodes = packed.unknown.join(", ");
            remark(&format!("warning: no result is known for {nodes}; run the graph first"));
        }
        if !packed.gone.is_empty() {
            let nodes = packed.gone.join(", ");
            remark(&format!(
                "warning: the values of {nodes} are no longer in the cache; run the graph first"
            ));
        }
        Ok(0)
    }
}
