//! `plan`: what a run would do and why.

use clap::Args;
use engine::{Fate, Forecast};

use crate::causes::reason;
use crate::report::{counts_text, forecast_text, seconds_text};
use crate::session::{EngineArgs, Error, GraphArgs, size_text};

/// Tells what a run would compute, why, and about how long it takes.
#[derive(Debug, Args)]
pub struct Plan {
    #[command(flatten)]
    graph: GraphArgs,
    /// Tell every node, and what each took the last time
    #[arg(long, short)]
    verbose: bool,
    #[command(flatten)]
    engine: EngineArgs,
}

impl Plan {
    /// Prints one line a node that may run, and the sum.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let (graph, only) = (&loaded.graph, &loaded.only);
        let engine = self.engine.open()?;
        let plan = engine.plan(graph, only);
        let mut text = String::new();
        for (index, node) in plan.iter().enumerate().filter(|(_, node)| node.fate != Fate::Unwanted) {
            if node.fate == Fate::Known && !self.verbose {
                continue;
            }
            let about = node.forecast.map(|s| format!("about {}", seconds_text(s))).unwrap_or_default();
            let why = reason(graph, index, &node.fate);
            text.push_str(&format!("{:<12} {:<16} {about:<14} {why}\n", node.id, node.kind));
            let past = self.verbose.then(|| engine.past(graph, index, node));
            if let Some(last) = past.and_then(|past| past.spent) {
                let (seconds, memory) = (seconds_text(last.seconds), size_text(last.memory));
                let counts = counts_text(&last.counts);
                text.push_str(&format!("{:<29} last time {seconds}, {memory}{counts}\n", ""));
            }
        }
        text.push_str(&forecast_text(&Forecast::of(&plan)));
        text.push('\n');
        super::print(&text)?;
        Ok(u8::from(plan.iter().any(|node| matches!(node.fate, Fate::Fails(_)))))
    }
}
