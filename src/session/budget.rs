//! An error or a time for a whole run, as values laid over its graph: so the plan of samples is fixed before the
//! run, stands in the recipes of its pictures, and can be run again.

use std::sync::Arc;

use engine::{Engine, Fate, Forecast, Graph, GraphKnob, overlay_text};

use super::error::Error;
use super::graph::Loaded;

/// The parameter of kinds that take samples until an error is reached.
const ERROR: &str = "max_error";
/// A picture of fewer samples than these tells nothing.
const FEWEST: u64 = 4;

/// Values in place of those of the graph: (node, parameter, value).
type Fields = Vec<(String, &'static str, String)>;

/// What was laid over a graph, `trace.samples=16`.
pub type Chosen = Vec<String>;

/// Nothing to bound.
fn no_samples() -> Error {
    Error::usage(
        "no node of this graph takes samples that an error or a time could bound; `path-trace` does, where its \
         `samples` do not vary along an axis",
    )
}

/// Lays an error over every node that takes samples until one is reached. At most as many are taken as the graph
/// says; a preset that says fewer says so of runs that are given no error, and what it would bound is told.
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

/// The samples that a graph says, where a preset says fewer.
fn raised(loaded: &Loaded) -> Fields {
    let graph = &loaded.graph;
    let bare = graph.source.without_presets();
    if bare == graph.source {
        return Vec::new();
    }
    // A graph that is none without its preset says nothing.
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

/// Lays the fewest samples over a graph in which a node takes samples whose time no forecast knows; `None` where every
/// one has a forecast. A run of it up to its files gives them all, and what it traces is kept.
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

/// Lays as many samples over a graph, at most its own, as its forecast says there is time for. Gives what was
/// chosen, and the forecast.
pub fn to_time(loaded: Loaded, engine: &Engine, seconds: f64) -> Result<(Loaded, Chosen, Forecast), Error> {
    let own = samples(&loaded.graph, &loaded.only);
    let mut most = own.iter().map(|(_, n)| *n).max().ok_or_else(no_samples)?;
    loop {
        let graph = capped(&loaded.graph, &own, most)?;
        let forecast = Forecast::of(&engine.plan(&graph, &loaded.only));
        if forecast.seconds <= seconds || most <= FEWEST {
            return Ok((Loaded { graph, ..loaded }, settings(&fields(&own, most)), forecast));
        }
        // The next power of two below, down to the fewest.
        most = (most.next_power_of_two() / 2).max(FEWEST);
    }
}

/// The knobs of a graph that say how many samples a node takes, and how many.
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

/// A graph with at most so many samples.
fn capped(graph: &Graph, own: &[(GraphKnob, u64)], most: u64) -> Result<Arc<Graph>, Error> {
    laid(graph, "--time", &fields(own, most))
}

fn laid(graph: &Graph, name: &str, fields: &Fields) -> Result<Arc<Graph>, Error> {
    let fields = fields.iter().map(|(node, parameter, value)| (node.as_str(), *parameter, value.as_str()));
    let source = graph.source.clone().overlaid(name, &overlay_text(fields));
    Graph::parse(source, &nodes::registry(), graph.root.clone()).map(Arc::new).map_err(Error::Graph)
}
