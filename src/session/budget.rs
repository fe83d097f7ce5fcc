//! Converts a limit on the error or the time of a whole run, before the run, to values that override the graph.
//! These values are written into the recipes of the pictures, so that the pictures can be reproduced.

use std::sync::Arc;

use engine::{Engine, Fate, Forecast, Graph, GraphKnob, overlay_text};

use super::error::Error;
use super::graph::Loaded;

/// Name of the parameter that makes a node take samples until its error is at most a given value.
const ERROR: &str = "max_error";
/// Minimum number of samples.
const FEWEST: u64 = 4;

/// Values that override the graph, each as (node, parameter, value).
type Fields = Vec<(String, &'static str, String)>;

/// Settings that override a graph, such as `trace.samples=16`.
pub type Chosen = Vec<String>;

/// The error for a graph in which no node takes samples.
fn no_samples() -> Error {
    Error::usage(
        "no node of this graph takes samples that an error bound or a time limit could control; `path-trace` does if its \
         `samples` do not vary along an axis",
    )
}

/// Sets `max_error` of every node that has this parameter. Such a node takes samples until its error is at most
/// `error` or the maximum number of samples is reached. If a preset reduces this maximum, the value in the graph is
/// restored, since the preset is meant for runs without an error bound. Also returns the settings that override the
/// graph.
pub fn to_error(loaded: Loaded, error: f64) -> Result<(Loaded, Chosen), Error> {
    let takes = |knob: &GraphKnob| knob.parameter == ERROR;
    let knobs = loaded.graph.knobs(&loaded.only).into_iter().filter(takes);
    let mut fields: Fields = knobs.map(|knob| (knob.node, ERROR, format!("{error:?}"))).collect();
    if fields.is_empty() {
        return Err(no_samples());
    }
    let raised = raised(&loaded);
    let chosen = settings(&raised);
    fields.extend(raised);
    let graph = laid(&loaded.graph, "--max-error", &fields)?;
    Ok((Loaded { graph, ..loaded }, chosen))
}

/// The numbers of samples that the graph itself sets, for the nodes whose number a preset reduces.
fn raised(loaded: &Loaded) -> Fields {
    let graph = &loaded.graph;
    let bare = graph.source.without_presets();
    if bare == graph.source {
        return Vec::new();
    }
    // A graph that is invalid without its preset has no numbers of its own.
    let Ok(bare) = Graph::parse(bare, &nodes::registry(), graph.root.clone()) else { return Vec::new() };
    let own = samples(&bare, &[]);
    let now = samples(graph, &loaded.only).into_iter();
    let more = now.filter_map(|(knob, now)| {
        let (_, most) =
            own.iter().find(|(own, _)| own.node == knob.node && own.parameter == knob.parameter)?;
        (*most > now).then(|| (knob.node, knob.parameter, most.to_string()))
    });
    more.collect()
}

/// Returns the graph with the minimum number of samples if any node that takes samples has no forecast, otherwise
/// `None`. A run of the returned graph provides the missing forecasts, and its samples are kept.
pub fn pilot(loaded: &Loaded, engine: &Engine) -> Result<Option<(Arc<Graph>, Chosen)>, Error> {
    let own = samples(&loaded.graph, &loaded.only);
    if own.is_empty() {
        return Err(no_samples());
    }
    let graph = capped(&loaded.graph, &own, FEWEST)?;
    let plan = engine.plan(&graph, &loaded.only);
    let untimed = plan.iter().zip(&graph.nodes).any(|(planned, node)| {
        let open = matches!(planned.fate, Fate::Runs(_) | Fate::Follows(_) | Fate::Lost);
        open && planned.forecast.is_none() && node.kind.preview.refines.is_some()
    });
    Ok(untimed.then(|| (graph, settings(&fields(&own, FEWEST)))))
}

/// Sets the largest number of samples whose forecast fits the time, but at most the number in the graph. Returns
/// the settings and the forecast.
pub fn to_time(loaded: Loaded, engine: &Engine, seconds: f64) -> Result<(Loaded, Chosen, Forecast), Error> {
    let own = samples(&loaded.graph, &loaded.only);
    let mut most = own.iter().map(|(_, n)| *n).max().ok_or_else(no_samples)?;
    loop {
        let graph = capped(&loaded.graph, &own, most)?;
        let forecast = Forecast::of(&engine.plan(&graph, &loaded.only));
        if forecast.seconds <= seconds || most <= FEWEST {
            return Ok((Loaded { graph, ..loaded }, settings(&fields(&own, most)), forecast));
        }
        // The next lower power of two, down to the minimum.
        most = (most.next_power_of_two() / 2).max(FEWEST);
    }
}

/// The knobs that set a number of samples, with their values.
fn samples(graph: &Graph, only: &[usize]) -> Vec<(GraphKnob, u64)> {
    let counts = |knob: &GraphKnob| {
        !knob.varies
            && graph.nodes[graph.find_all(&knob.node)[0]].kind.preview.refines == Some(knob.parameter)
    };
    let knobs = graph.knobs(only).into_iter().filter(counts);
    knobs.filter_map(|knob| knob.value.parse().ok().map(|n| (knob, n))).collect()
}

fn fields(own: &[(GraphKnob, u64)], most: u64) -> Fields {
    own.iter().map(|(knob, n)| (knob.node.clone(), knob.parameter, most.min(*n).to_string())).collect()
}

fn settings(fields: &Fields) -> Chosen {
    fields.iter().map(|(node, parameter, value)| format!("{node}.{parameter}={value}")).collect()
}

/// Returns the graph with the number of samples of each node limited to `most`.
fn capped(graph: &Graph, own: &[(GraphKnob, u64)], most: u64) -> Result<Arc<Graph>, Error> {
    laid(graph, "--time", &fields(own, most))
}

fn laid(graph: &Graph, name: &str, fields: &Fields) -> Result<Arc<Graph>, Error> {
    let fields = fields.iter().map(|(node, parameter, value)| (node.as_str(), *parameter, value.as_str()));
    let source = graph.source.clone().overlaid(name, &overlay_text(fields));
    Graph::parse(source, &nodes::registry(), graph.root.clone()).map(Arc::new).map_err(Error::Graph)
}
