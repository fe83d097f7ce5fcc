//! `explain`: the reasons why a node would run again, and the content of its key.

use clap::Args;
use engine::{Graph, bytes_text};

use crate::session::{EngineArgs, Error, GraphArgs, find};
use crate::terminal::causes::trail;
use crate::terminal::planned::{changes_json, planned_json};
use crate::terminal::{self, counts_text, seconds_text};

/// Shows why a node would run again, or why it last ran, back to the first cause.
#[derive(Debug, Args)]
pub struct Explain {
    #[command(flatten)]
    graph: GraphArgs,
    /// Name of the node
    node: String,
    /// Also print everything that the node's key consists of
    #[arg(long)]
    key: bool,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    engine: EngineArgs,
}

impl Explain {
    /// Prints the first causes, the nodes between these causes and the requested node, and the time and memory that
    /// the requested node took in its last run.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let graph = &loaded.graph;
        let index = find(graph, &self.node)?;
        let engine = self.engine.open()?;
        let plan = engine.plan(graph, &[index]);
        let trail = trail(&engine, graph, &plan, index);
        let node = &plan[index];
        let past = engine.past(graph, index, node);
        if self.json {
            let mut object = planned_json(&engine, graph, index, node);
            object["event"] = "explained".into();
            object["because"] = trail.roots.into();
            object["trail"] = trail.lines.into();
            object["before"] = changes_json(&past.changes).into();
            if let Some(manifest) = node.manifest.as_ref().filter(|_| self.key) {
                object["key"] = manifest.to_string().lines().map(str::to_owned).collect::<Vec<_>>().into();
            }
            terminal::json_line(&object);
            return Ok(0);
        }
        let mut text = String::new();
        if !trail.roots.is_empty() {
            text.push_str("because\n");
            for root in &trail.roots {
                text.push_str(&format!("    {root}\n"));
            }
            text.push('\n');
        }
        for line in &trail.lines {
            text.push_str(&format!("{line}\n"));
        }
        if let Some(last) = past.spent {
            let [seconds, cpu] = [last.seconds, last.cpu_seconds].map(seconds_text);
            let memory = bytes_text(last.memory);
            let counts = counts_text(&last.counts);
            text.push_str(&format!(
                "\nthe last run of the node took {seconds} ({cpu} of CPU time) and an estimated {memory} of memory{counts}\n"
            ));
        }
        if let Some(seconds) = node.forecast {
            text.push_str(&format!("the next run of the node would take about {}\n", seconds_text(seconds)));
        }
        if let Some(manifest) = node.manifest.as_ref().filter(|_| self.key) {
            text.push_str("\nthe key of the node consists of:\n");
            for line in manifest.to_string().lines() {
                text.push_str(&format!("    {}\n", by_wire(graph, index, line)));
            }
        }
        terminal::print(&text)?;
        Ok(0)
    }
}

/// Replaces the number in brackets in a line of a key. The number is the index of a field; it becomes the index of
/// the wire to which the field belongs. In a key, each wire of an input has three fields: type, format and content.
fn by_wire(graph: &Graph, index: usize, line: &str) -> String {
    let numbered = || {
        let (name, rest) = line.split_once('[')?;
        graph.nodes[index].kind.inputs.iter().find(|port| port.name == name)?;
        let (field, rest) = rest.split_once(']')?;
        Some(format!("{name}[{}]{rest}", field.parse::<usize>().ok()? / 3))
    };
    numbered().unwrap_or_else(|| line.to_owned())
}
