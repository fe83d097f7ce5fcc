//! An error or a time for a whole run, as values laid over its graph: so the plan of samples is fixed before the
//! run, stands in the recipes of its pictures, and can be run again.

use std::sync::Arc;

use engine::{Engine, Fate, Forecast, Graph, GraphKnob, overlay_text};

use crate::session::{Error, Loaded};

/// The parameter of kinds that take samples until an error is reached.
const ERROR: &str = "max_error";
/// A picture of fewer samples than these tells nothing.
const FEWEST: u64 = 4;

/// Lays an error over every node that takes samples until one is reached.
pub fn to_error(mut loaded: Loaded, error: f64) -> Result<Loaded, Error> {
    let takes = |node: &&Arc<engine::Node>| node.kind.params.iter().any(|spec| spec.name == ERROR);
    // An axis makes several nodes of one in the file.
    let name =
        |id: &str, several: bool| if several { id.split('/').next() } else { None }.unwrap_or(id).to_owned();
    let nodes = loaded.graph.nodes.iter().filter(takes).map(|node| name(&node.id, !node.point.is_empty()));
    let mut nodes: Vec<String> = nodes.collect();
    nodes.dedup();
    if nodes.is_empty() {
        return Err(Error::NoSamples);
    }
    let value = format!("{error:?}");
    let fields = nodes.iter().map(|node| (node.as_str(), ERROR, value.as_str()));
    loaded.graph = laid(&loaded.graph, "--max-error", &overlay_text(fields))?;
    Ok(loaded)
}

/// Lays as many samples over a graph, at most its own, as its forecast says there is time for. Gives what was
/// chosen, `trace.samples=16`, and the forecast.
pub fn to_time(
    mut loaded: Loaded,
    engine: &Engine,
    seconds: f64,
) -> Result<(Loaded, Vec<String>, Forecast), Error> {
    let graph = loaded.graph.clone();
    let kind = |knob: &GraphKnob| graph.nodes[graph.find_all(&knob.node)[0]].kind.clone();
    let knobs = graph.knobs(&loaded.only).into_iter();
    let samples = knobs.filter(|knob| !knob.varies && kind(knob).refines == Some(knob.parameter));
    let own: Vec<(GraphKnob, u64)> =
        samples.filter_map(|knob| knob.value.parse().ok().map(|n| (knob, n))).collect();
    let mut most = own.iter().map(|(_, n)| *n).max().ok_or(Error::NoSamples)?;
    loop {
        let values: Vec<String> = own.iter().map(|(_, n)| most.min(*n).to_string()).collect();
        let fields =
            own.iter().zip(&values).map(|((knob, _), n)| (knob.node.as_str(), knob.parameter, n.as_str()));
        loaded.graph = laid(&graph, "--time", &overlay_text(fields.clone()))?;
        let plan = engine.plan(&loaded.graph, &loaded.only);
        let untimed = plan.iter().zip(&loaded.graph.nodes).find(|(planned, node)| {
            let open = matches!(planned.fate, Fate::Runs(_) | Fate::Follows(_) | Fate::Lost);
            open && planned.forecast.is_none() && node.kind.refines.is_some()
        });
        if let Some((planned, _)) = untimed {
            return Err(Error::NoForecast { node: planned.id.clone(), kind: planned.kind });
        }
        let forecast = Forecast::of(&plan);
        if forecast.seconds <= seconds || most <= FEWEST {
            let chosen = fields.map(|(node, parameter, n)| format!("{node}.{parameter}={n}")).collect();
            return Ok((loaded, chosen, forecast));
        }
        // The next power of two below, down to the fewest.
        most = (most.next_power_of_two() / 2).max(FEWEST);
    }
}

fn laid(graph: &Graph, name: &str, overlay: &str) -> Result<Arc<Graph>, Error> {
    let source = graph.source.clone().overlaid(name, overlay);
    Graph::parse(source, &nodes::registry(), graph.root.clone()).map(Arc::new).map_err(Error::Graph)
}
