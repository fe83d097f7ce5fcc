//! `check`: reports every mistake of a graph file, without running it.

mod sizes;

use std::path::Path;

use clap::Args;
use engine::{Diagnostics, Graph};

use crate::session::{Error, GraphArgs};
use crate::terminal;

/// Reads a graph and reports every mistake in it.
///
/// Of the files that loaders read, it reads only the number of cameras, the sizes of pictures, and the lists of
/// other files; a file that a loader refuses is reported by the run.
#[derive(Debug, Args)]
pub struct Check {
    #[command(flatten)]
    graph: GraphArgs,
    /// Print one JSON object per line on standard output: the mistakes, or a line that reports that the graph has
    /// no mistakes
    #[arg(long)]
    pub json: bool,
}

impl Check {
    /// Checks the graph. Returns exit code 0 if the graph can run, and an error if it has mistakes.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let graph = &loaded.graph;
        graph.check_sources().map_err(Error::Graph)?;
        sizes::check(graph).map_err(Error::Graph)?;
        self.check_presets(graph)?;
        // The default output folder of runs.
        loaded.check_outputs(Path::new("out"))?;
        let sinks = graph.nodes.iter().filter(|node| node.sink_path.is_some()).count();
        let (name, nodes) = (&graph.source.name, graph.nodes.len());
        if self.json {
            terminal::json_line(
                &serde_json::json!({"event": "checked", "file": name, "nodes": nodes, "sinks": sinks}),
            );
            return Ok(0);
        }
        terminal::print(&format!("{name}: no mistakes (nodes: {nodes}, sinks: {sinks})\n"))?;
        if let Some(remark) = terminal::no_file(graph, &loaded.only) {
            terminal::print(&format!("{remark}\n"))?;
        }
        Ok(0)
    }

    /// Checks each preset of the graph, including those that were not requested.
    fn check_presets(&self, graph: &Graph) -> Result<(), Error> {
        let mut found: Option<Diagnostics> = None;
        for name in graph.source.own_presets(&graph.root) {
            if self.graph.preset.contains(&name) {
                continue;
            }
            let source = graph.source.clone().with_preset(&name, &nodes::registry());
            if let Err(mistakes) = Graph::parse(source, &nodes::registry(), graph.root.clone()) {
                let of_preset = mistakes
                    .list
                    .into_iter()
                    .map(|mistake| mistake.hint(format!("with the preset `{name}`")));
                // Every source begins with the text of the graph, so places in that text are the same in all of
                // them.
                let all = found.get_or_insert_with(|| Diagnostics::new(mistakes.source, Vec::new()));
                all.list.extend(of_preset);
            }
        }
        found.map_or(Ok(()), |all| Err(Error::Graph(Diagnostics::new(all.source, all.list))))
    }
}
