//! `plan`: prints what a run would compute, and why.

use std::sync::atomic::AtomicBool;

use clap::Args;
use engine::{Engine, Event, Fate, Forecast, Graph, Planned, bytes_text};

use crate::session::{EngineArgs, Error, GraphArgs, RemoteArgs};
use crate::terminal::causes::reason;
use crate::terminal::planned::planned_json;
use crate::terminal::{self, counts_text, forecast_text, seconds_text};

/// Shows what a run would compute, why, and about how long it takes.
#[derive(Debug, Args)]
pub struct Plan {
    #[command(flatten)]
    graph: GraphArgs,
    /// Also print nodes with a known result, and the time and estimated memory of each node in its last run
    #[arg(long, short)]
    verbose: bool,
    /// Print one JSON object per line on standard output: one for each wanted node, then one with the totals
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    engine: EngineArgs,
    #[command(flatten)]
    remote: RemoteArgs,
}

impl Plan {
    /// Prints one line per node that may run, and the totals.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let (graph, only) = (&loaded.graph, &loaded.only);
        let mut engine = self.engine.open()?;
        // Only the placement of nodes depends on the server.
        if self.remote.executes()? {
            let cancel = AtomicBool::new(false);
            (engine, _) = self.remote.connect(engine, &cancel, |warning| {
                if let Event::Warning { text, .. } = warning {
                    terminal::remark(text);
                }
            })?;
        }
        let plan = engine.plan(graph, only);
        if self.json {
            return Ok(print_json(&engine, graph, &plan));
        }
        let mut text = String::new();
        for (index, node) in plan.iter().enumerate().filter(|(_, node)| node.fate != Fate::Unwanted) {
            if node.fate == Fate::Known && !self.verbose {
                continue;
            }
            let about = match (node.forecast, &node.fate) {
                (Some(seconds), _) => format!("about {}", seconds_text(seconds)),
                (None, Fate::Known | Fate::Fails(_)) => String::new(),
                (None, _) => "unknown".to_owned(),
            };
            let why = reason(graph, index, &node.fate);
            let place = engine.placement(graph, index, node);
            let place = place.map(|place| format!("; {place}")).unwrap_or_default();
            text.push_str(&format!("{:<12} {:<16} {about:<14} {why}{place}\n", node.id, node.kind));
            let past = self.verbose.then(|| engine.past(graph, index, node));
            if let Some(last) = past.and_then(|past| past.spent) {
                let [seconds, cpu] = [last.seconds, last.cpu_seconds].map(seconds_text);
                let (memory, counts) = (bytes_text(last.memory), counts_text(&last.counts));
                text.push_str(&format!(
                    "{:<29} last run {seconds} ({cpu} of CPU time), estimated memory {memory}{counts}\n",
                    ""
                ));
            }
        }
        text.push_str(&forecast_text(&Forecast::of(&plan)));
        text.push('\n');
        terminal::print(&text)?;
        Ok(exit_code(&plan))
    }
}

/// Returns exit code 1 if a node would fail, otherwise 0.
fn exit_code(plan: &[Planned]) -> u8 {
    u8::from(plan.iter().any(|node| matches!(node.fate, Fate::Fails(_))))
}

fn print_json(engine: &Engine, graph: &Graph, plan: &[Planned]) -> u8 {
    for (index, node) in plan.iter().enumerate().filter(|(_, node)| node.fate != Fate::Unwanted) {
        terminal::json_line(&planned_json(engine, graph, index, node));
    }
    terminal::json_line(&Event::Plan(Forecast::of(plan)));
    exit_code(plan)
}
