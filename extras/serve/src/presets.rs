//! Presets, knobs, and skipped work of the graph that the page shows.

use engine::{Forecast, Graph, PRESETS};
use scene::types::Report;
use serde::Deserialize;
use serde_json::{Value, json};
use trade::bench::NodeCost;
use trade::knobs::{KnobRow, knob_rows};
use trade::left_out::left_out;
use trade::tunables::presets;

use crate::editor::{Refused, fixed};
use crate::live::Live;

/// A request for a preset.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Choice {
    /// Digest of the text that the client has seen.
    digest: String,
    /// Name of the preset.
    preset: String,
    /// True if the values are written into the text; false if they are tried.
    write: bool,
}

impl Live {
    /// The knobs with their values in each preset, the forecast of a run with each preset, and the work that was
    /// skipped because a check found it unnecessary.
    ///
    /// # Errors
    /// [`Refused`] if the graph has mistakes.
    pub fn trade(&self) -> Result<Value, Refused> {
        let graph = self.graph()?;
        let only = self.with_state(|state| state.only.clone());
        let rows = self.rows(&graph, &only)?;
        let knobs = rows.iter().map(|KnobRow { knob, levels, .. }| {
            json!({
                "node": knob.node, "parameter": knob.parameter, "kind": knob.knob.kind, "value": knob.value,
                "varies": knob.varies, "levels": levels,
            })
        });
        let knobs: Value = knobs.collect();
        let (costs, reports) = self.measured(&graph);
        let skips = left_out(&costs, &reports).into_iter().map(|row| {
            json!({
                "what": row.what, "nodes": row.nodes, "left_out": row.left_out, "found": row.found,
                "check": row.check, "force": row.force,
            })
        });
        Ok(
            json!({"knobs": knobs, "presets": self.forecasts(&graph, &only)?, "left_out": skips.collect::<Value>()}),
        )
    }

    /// Applies the values of a preset to all knobs of the text that do not vary along an axis: as trial values, or
    /// by writing them into the text in one edit.
    ///
    /// # Errors
    /// [`Refused`]; nothing was changed.
    pub fn preset(&self, choice: &Choice) -> Result<Value, Refused> {
        let level = PRESETS.iter().position(|name| *name == choice.preset);
        let level = level.ok_or_else(|| fixed(format!("there is no preset `{}`", choice.preset)))?;
        let graph = self.graph()?;
        // Values that are tried now do not count, since they are replaced.
        let rows = self.rows(&self.own_graph(&graph)?, &[])?;
        let value = |row: &KnobRow| {
            let value =
                row.levels[level].clone().filter(|value| !row.knob.varies && *value != row.knob.value)?;
            Some((row.knob.node.clone(), row.knob.parameter.to_owned(), value))
        };
        let fields: Vec<_> = rows.iter().filter_map(value).collect();
        if choice.write {
            let label = format!("values of the preset {}", choice.preset);
            return self.write(|editor| editor.set_all(&graph, &choice.digest, &fields, &label));
        }
        Ok(self.try_all(fields))
    }

    fn rows(&self, graph: &Graph, only: &[usize]) -> Result<Vec<KnobRow>, Refused> {
        knob_rows(graph, only, &nodes::registry()).map_err(|error| fixed(error.to_string()))
    }

    /// For each preset, the forecast of a run.
    fn forecasts(&self, graph: &Graph, only: &[usize]) -> Result<Value, Refused> {
        let all = presets(graph, &nodes::registry()).map_err(|error| fixed(error.to_string()))?;
        let forecast = |(name, laid): (&str, Graph)| {
            let only: Vec<usize> =
                only.iter().filter_map(|&index| laid.find(&graph.nodes[index].id)).collect();
            let forecast = Forecast::of(&self.engine.plan(&laid, &only));
            json!({"name": name, "forecast": forecast})
        };
        Ok(PRESETS.into_iter().zip(all).map(forecast).collect())
    }

    /// The notes, counts and reports of the nodes, from their last results.
    fn measured(&self, graph: &Graph) -> (Vec<NodeCost>, Vec<(String, Report)>) {
        let (facts, digests) = self.with_state(|state| {
            let facts: Vec<_> = graph.nodes.iter().map(|node| state.facts(&node.id)).collect();
            (facts, state.outputs(&["report"]))
        });
        let cost = |(index, (notes, key))| {
            let spent = self.engine.spent(graph, index).unwrap_or_default();
            NodeCost::of(&graph.nodes[index], spent, notes, key)
        };
        let costs = facts.into_iter().enumerate().map(cost).collect();
        let report = |(id, port, digest): (String, usize, String)| {
            let node = &graph.nodes[graph.find(&id)?];
            let name = format!("{id}.{}", node.kind.outputs.get(port)?.name);
            Some((name, self.value(&digest)?.report.clone()?))
        };
        let reports = digests.into_iter().filter_map(report).collect();
        (costs, reports)
    }
}
