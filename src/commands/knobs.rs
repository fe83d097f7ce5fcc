//! `knobs`: lists the parameters of a graph that trade work for accuracy.

use clap::Args;
use engine::{GraphKnob, PRESETS};
use serde_json::json;
use trade::knobs::{KnobRow, knob_rows};

use crate::session::{Error, GraphArgs};
use crate::terminal;

/// Lists the knobs of a graph and the outputs that each knob changes. Knobs are the parameters that trade work for
/// accuracy.
///
/// A knob has a value in each preset, from the least work to the least error: draft, preview, final, reference.
/// Presets and searches do not change a knob that varies along an axis; the list shows its first value. `run
/// --preset draft` sets all knobs; `tune` measures to find better settings.
#[derive(Debug, Args)]
pub struct Knobs {
    #[command(flatten)]
    graph: GraphArgs,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
}

impl Knobs {
    /// Prints one line per knob.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load_to_turn()?;
        let knobs = knob_rows(&loaded.graph, &loaded.only, &nodes::registry())?;
        if self.json {
            let object = |KnobRow { knob, levels, range }: &KnobRow| {
                let mut row = json!(knob);
                (row["presets"], row["range"]) = (json!(levels), json!(range));
                // From the least work to the least error.
                row["values"] = json!(knob.knob.values());
                row
            };
            let objects: Vec<_> = knobs.iter().map(object).collect();
            terminal::print(&format!("{}\n", json!({"presets": PRESETS, "knobs": objects})))?;
            return Ok(0);
        }
        if knobs.is_empty() {
            terminal::print("no node of this graph has a knob\n")?;
            return Ok(0);
        }
        let name = |knob: &GraphKnob| format!("{}.{}", knob.node, knob.parameter);
        let mut rows = vec![["knob", "kind", "now"].map(str::to_owned).to_vec()];
        rows[0].extend(PRESETS.iter().map(|preset| (*preset).to_owned()));
        rows[0].extend(["range", "reaches"].map(str::to_owned));
        for KnobRow { knob, levels, range } in &knobs {
            let now = if knob.varies { format!("{}, ..", knob.value) } else { knob.value.clone() };
            let mut row = vec![name(knob), knob.knob.kind.name().to_owned(), now];
            // A dot means that the preset keeps the value of the graph.
            let left = knob.knob.ladder.map(str::is_empty);
            let level = |(value, left): (&Option<String>, bool)| {
                let shown = value.as_ref().filter(|value| !(left && **value == knob.value));
                shown.cloned().unwrap_or_else(|| ".".to_owned())
            };
            row.extend(levels.iter().zip(left).map(level));
            row.push(range.map(|(low, high)| format!("{low} to {high}")).unwrap_or_default());
            row.push(knob.reaches.join(", "));
            rows.push(row);
        }
        terminal::print(&terminal::columns(&rows))?;
        Ok(0)
    }
}
