//! A check after a run: whether the splats and the mesh of a place agree in the wanted views.

use std::collections::BTreeSet;

use engine::{Engine, Graph, Wire};
use nodes::geometry::agreement::{Agreement, Depths, ELSEWHERE};
use nodes::types::{Images, Picture};

use super::wires;

/// Maximum number of pairs that are compared, each of a picture of splats and a trace. This bounds the time of the
/// check. Only the first view of each pair is compared.
const MOST_PAIRS: usize = 4;

/// Kinds that make the mesh of a place from its splats.
const MADE_OF_SPLATS: [&str; 2] = ["extract-mesh", "plane"];

/// A finding about a pair of nodes: its id, and a text that names the nodes.
pub type Finding = (&'static str, String);

/// Compares each picture of splats with each trace of the same cameras that has a mesh of the place. `ran` has the
/// names of the nodes that this run computed. A pair without any of them is skipped, since an earlier run reported
/// its findings. Pairs whose values are not in the cache are left out.
pub fn findings(engine: &Engine, graph: &Graph, ran: &BTreeSet<String>) -> Vec<Finding> {
    let mut found = Vec::new();
    let is_new = |node: usize| ran.contains(graph.nodes[node].id.as_str());
    let new = pairs(graph).into_iter().filter(|&(splats, trace)| is_new(splats) || is_new(trace));
    for (splats, trace) in new.take(MOST_PAIRS) {
        let is_own = is_made_of_splats(graph, trace);
        for (id, text) in of_pair(engine, graph, splats, trace).unwrap_or_default() {
            if is_own && id == ELSEWHERE {
                continue;
            }
            let [a, b] = [splats, trace].map(|node| &graph.nodes[node].id);
            found.push((id, format!("`{a}` and `{b}`: {text}")));
        }
    }
    found
}

/// True if the receiver of a trace is made from splats and is therefore in the same frame as the splats.
fn is_made_of_splats(graph: &Graph, trace: usize) -> bool {
    let mut open: Vec<usize> = wires(graph, trace, "receiver").iter().map(|wire| wire.node).collect();
    let mut seen = BTreeSet::new();
    while let Some(node) = open.pop() {
        if MADE_OF_SPLATS.contains(&graph.nodes[node].kind.name) {
            return true;
        }
        if seen.insert(node) {
            open.extend(wires(graph, node, "mesh").iter().map(|wire| wire.node));
        }
    }
    false
}

/// Pairs of a `splat-render` without `limit` and a `path-trace` with a receiver that have the same cameras. A trace
/// that is the `limit` of any `splat-render` is left out, since that render also draws the splats in front of the
/// objects.
fn pairs(graph: &Graph) -> Vec<(usize, usize)> {
    let of = |kind: &str| -> Vec<usize> {
        (0..graph.nodes.len()).filter(|&node| graph.nodes[node].kind.name == kind).collect()
    };
    let (renders, mut pairs) = (of("splat-render"), Vec::new());
    let traces = of("path-trace").into_iter().filter(|&node| !wires(graph, node, "receiver").is_empty());
    for trace in traces.take(MOST_PAIRS) {
        let limits = |node: usize| wires(graph, node, "limit").iter().any(|wire| wire.node == trace);
        if renders.iter().any(|&node| limits(node)) {
            continue;
        }
        let rig = wires(graph, trace, "rig");
        let same = |node: usize| wires(graph, node, "limit").is_empty() && wires(graph, node, "rig") == rig;
        pairs.extend(renders.iter().filter(|&&node| same(node)).map(|&node| (node, trace)));
    }
    pairs
}

/// Compares the first view of a pair.
fn of_pair(engine: &Engine, graph: &Graph, splats: usize, trace: usize) -> Option<Vec<Finding>> {
    let picture = |node: usize, output: &str| -> Option<Picture> {
        let port = graph.nodes[node].kind.outputs.iter().position(|port| port.name == output)?;
        let images = engine.value::<Images>(graph, Wire { node, port })?;
        images.0.into_iter().next().map(|view| view.picture)
    };
    let (depth, alpha) = (picture(splats, "depth")?, picture(splats, "alpha")?);
    let (surface, object) = (picture(trace, "depth")?, picture(trace, "object")?);
    let channels = object.size().2;
    let objects: Vec<f32> = match channels {
        4 => object.samples().iter().skip(3).step_by(4).copied().collect(),
        _ => return None,
    };
    let pixels = objects.len();
    let same = [&depth, &alpha, &surface].iter().all(|picture| picture.samples().len() == pixels);
    same.then(|| {
        let depths = Depths {
            splats: depth.samples(),
            coverage: alpha.samples(),
            surface: surface.samples(),
            objects: &objects,
        };
        Agreement::of(&depths).findings()
    })
}
