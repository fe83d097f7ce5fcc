//! `plan`: what a run would do and why.

use clap::Args;
use engine::{Change, Fate, Forecast, Planned, Why};

use crate::report::{forecast_text, seconds_text};
use crate::session::{EngineArgs, Error, GraphArgs, Loaded};

/// Tells what a run would compute, why, and about how long it takes.
#[derive(Debug, Args)]
pub struct Plan {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
}

impl Plan {
    /// Prints one line a node that may run, and the sum.
    pub fn run(self) -> Result<u8, Error> {
        let Loaded { graph, only } = self.graph.load()?;
        let plan = self.engine.open()?.plan(&graph, &only);
        let mut text = String::new();
        let wanted: Vec<&Planned> = plan.iter().filter(|node| node.fate != Fate::Unwanted).collect();
        for node in &wanted {
            if node.fate == Fate::Known {
                continue;
            }
            let about = node.forecast.map(|s| format!("about {}", seconds_text(s))).unwrap_or_default();
            text.push_str(&format!("{:<12} {:<16} {about:<14} {}\n", node.id, node.kind, reason(&node.fate)));
        }
        text.push_str(&forecast_text(&Forecast::of(&plan)));
        text.push('\n');
        super::print(&text)?;
        Ok(u8::from(wanted.iter().any(|node| matches!(node.fate, Fate::Fails(_)))))
    }
}

/// Why a node runs, in a few words.
pub fn reason(fate: &Fate) -> String {
    match fate {
        Fate::Unwanted => "not wanted".to_owned(),
        Fate::Known => "its result is known".to_owned(),
        Fate::Lost => "known, but gone from the cache: runs again if its values are needed".to_owned(),
        Fate::Runs(Why::New) => "runs: its result is not kept".to_owned(),
        Fate::Runs(Why::Changed(changes)) => match changes.as_slice() {
            [] => "runs: the result of the last run is no longer kept".to_owned(),
            [first, rest @ ..] => {
                let more = if rest.is_empty() { String::new() } else { format!(" and {} more", rest.len()) };
                format!("runs: {}{more}", change(first))
            }
        },
        Fate::Follows(above) => format!("depends on what `{above}` gives"),
        Fate::Fails(why) => format!("fails: {why}"),
    }
}

/// `yaw_deg 30.0 -> 35.0`.
pub fn change(change: &Change) -> String {
    let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "nothing".to_owned());
    format!("`{}` {} -> {}", change.path, value(&change.old), value(&change.new))
}
