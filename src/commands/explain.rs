//! `explain`: what a node's result is made of, and why it would run again.

use clap::Args;
use engine::{Fate, Planned, Why};

use super::plan::{change, reason};
use crate::report::seconds_text;
use crate::session::{EngineArgs, Error, GraphArgs, Loaded, find};

/// Tells what a node's result is made of and why it would run again.
#[derive(Debug, Args)]
pub struct Explain {
    #[command(flatten)]
    graph: GraphArgs,
    /// Name of the node
    node: String,
    #[command(flatten)]
    engine: EngineArgs,
}

impl Explain {
    /// Prints the reason, back to the node where it begins, and the key of the node.
    pub fn run(self) -> Result<u8, Error> {
        let Loaded { graph, .. } = self.graph.load()?;
        let index = find(&graph, &self.node)?;
        let plan = self.engine.open()?.plan(&graph, &[index]);
        let mut text = String::new();
        let mut at: &Planned = &plan[index];
        loop {
            text.push_str(&format!("{} ({}): ", at.id, at.kind));
            match &at.fate {
                Fate::Runs(Why::Changed(changes)) if !changes.is_empty() => {
                    text.push_str("runs, since\n");
                    for one in changes {
                        text.push_str(&format!("    {}\n", change(one)));
                    }
                }
                fate => text.push_str(&format!("{}\n", reason(fate))),
            }
            match &at.fate {
                Fate::Follows(above) => match plan.iter().find(|node| node.id == *above) {
                    Some(node) => at = node,
                    None => break,
                },
                _ => break,
            }
        }
        if let Some(seconds) = plan[index].forecast {
            text.push_str(&format!("its code took {} the last time\n", seconds_text(seconds)));
        }
        if let Some(manifest) = &plan[index].manifest {
            text.push_str("its key is made of\n");
            for line in manifest.to_string().lines() {
                text.push_str(&format!("    {line}\n"));
            }
        }
        super::print(&text)?;
        Ok(0)
    }
}
