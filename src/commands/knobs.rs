//! `knobs`: what trades work for accuracy in a graph.

use clap::Args;
use engine::{GraphKnob, PRESETS};
use serde_json::json;

use crate::session::{Error, GraphArgs};
use crate::trade::tunables::presets;

/// Lists what trades work for accuracy in a graph, and which outputs it reaches.
///
/// A knob has a value in each preset, from the least work to the least error: draft, preview, final, reference. One that
/// varies along an axis, of which the list shows the first value, is no preset's and no search's to set.
/// `run --preset draft` sets all of them; `tune` looks for better settings by measuring.
#[derive(Debug, Args)]
pub struct Knobs {
    #[command(flatten)]
    graph: GraphArgs,
    /// One JSON object on standard output
    #[arg(long)]
    pub json: bool,
}

impl Knobs {
    /// Prints one line a knob.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load_to_turn()?;
        let graph = &loaded.graph;
        let knobs = graph.knobs(&loaded.only);
        // A graph's own preset may set what the program's of that name does not.
        let laid = presets(graph, &nodes::registry())?.map(|laid| {
            // By name, since a preset may take an axis away.
            let asked = loaded.only.iter().filter_map(|&index| laid.find(&graph.nodes[index].id));
            laid.knobs(&asked.collect::<Vec<_>>())
        });
        // What varies under a preset, too, has no value there.
        let levels = |knob: &GraphKnob| {
            let same = |other: &&GraphKnob| other.node == knob.node && other.parameter == knob.parameter;
            laid.each_ref().map(|laid| {
                let knob = laid.iter().find(same).filter(|knob| !knob.varies);
                knob.map(|knob| knob.value.clone())
            })
        };
        let range = |knob: &GraphKnob| {
            let node = &graph.nodes[*graph.find_all(&knob.node).first()?];
            node.kind.params.iter().find(|spec| spec.name == knob.parameter)?.range
        };
        if self.json {
            let told = |knob: &GraphKnob| {
                let mut told = json!(knob);
                (told["presets"], told["range"]) = (json!(levels(knob)), json!(range(knob)));
                // From the least work to the least error.
                told["values"] = json!(knob.knob.values());
                told
            };
            let told: Vec<_> = knobs.iter().map(told).collect();
            super::print(&format!("{}\n", json!({"presets": PRESETS, "knobs": told})))?;
            return Ok(0);
        }
        if knobs.is_empty() {
            super::print("no node of this graph has a knob\n")?;
            return Ok(0);
        }
        let name = |knob: &GraphKnob| format!("{}.{}", knob.node, knob.parameter);
        let mut rows = vec![["knob", "kind", "now"].map(str::to_owned).to_vec()];
        rows[0].extend(PRESETS.iter().map(|preset| (*preset).to_owned()));
        rows[0].extend(["range", "reaches"].map(str::to_owned));
        for knob in &knobs {
            let now = if knob.varies { format!("{}, ..", knob.value) } else { knob.value.clone() };
            let mut row = vec![name(knob), knob.knob.kind.name().to_owned(), now];
            // A dot: the preset leaves what the graph says.
            let left = knob.knob.ladder.map(str::is_empty);
            let level = |(value, left): (Option<String>, bool)| {
                value.filter(|value| !(left && *value == knob.value)).unwrap_or_else(|| ".".to_owned())
            };
            row.extend(levels(knob).into_iter().zip(left).map(level));
            row.push(range(knob).map(|(low, high)| format!("{low} to {high}")).unwrap_or_default());
            row.push(knob.reaches.join(", "));
            rows.push(row);
        }
        super::print(&columns(&rows))?;
        Ok(0)
    }
}

/// Rows of equally many cells as lines, each column as wide as its widest cell.
pub fn columns(rows: &[Vec<String>]) -> String {
    let count = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, at: usize| row.get(at).map_or(0, |text| text.chars().count());
    let widths: Vec<usize> =
        (0..count).map(|at| rows.iter().map(|row| cell(row, at)).max().unwrap_or(0)).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(text, width)| format!("{text:<width$}"));
        format!("{}\n", cells.collect::<Vec<_>>().join("  ").trim_end())
    };
    rows.iter().map(line).collect()
}
