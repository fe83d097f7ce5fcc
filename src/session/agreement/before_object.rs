//! Finds splats in front of an inserted object, from the pictures of a run.

use std::collections::BTreeSet;

use engine::{Engine, Graph, Wire};
use nodes::geometry::before_object::{Depths, share};
use nodes::types::{Images, Picture};

use super::pair::{Finding, of_kind};
use crate::session::wires;

/// Maximum number of compared pairs. A pair consists of a picture of splats and a trace; only its first view is
/// compared. This bounds the time of the check.
const MOST_PAIRS: usize = 4;
/// Splats in front of an object are reported if they cover at least this share of its pixels. A smaller share is
/// normal, because splats extend beyond the surface that they represent. For example, the splats of a post in front
/// of an object covered 11 % of the object along the edge of the post.
const LEAST: f64 = 0.2;

/// Compares each picture of splats with each trace of the same cameras. `ran` has the names of the nodes that this
/// run computed. A pair that contains none of these nodes is skipped, since an earlier run reported its findings.
/// Pairs whose values are not in the cache are left out.
pub fn findings(engine: &Engine, graph: &Graph, ran: &BTreeSet<String>) -> Vec<Finding> {
    let is_new = |node: usize| ran.contains(graph.nodes[node].id.as_str());
    let new = pairs(graph).into_iter().filter(|&(splats, trace)| is_new(splats) || is_new(trace));
    let text = |(splats, trace): (usize, usize)| {
        let share = of_pair(engine, graph, splats, trace).filter(|share| *share >= LEAST)?;
        let [a, b] = [splats, trace].map(|node| &graph.nodes[node].id);
        let text = format!(
            "`{a}` and `{b}`: splats are in front of the object at {:.0} % of its pixels, but the object is drawn over \
             them, because the mesh of the place has no surface there. To draw these splats over the object, wire \
             `{b}.nearest` to `limit` of a second `SplatRender`, and its picture to `front` of `Composite`",
            100.0 * share
        );
        Some(("splats-before-object", text))
    };
    new.take(MOST_PAIRS).filter_map(text).collect()
}

/// Pairs of a `splat-render` without `limit` and a `path-trace` with a receiver that have the same cameras. A trace
/// that is the `limit` of any `splat-render` is left out, since that render also draws the splats in front of the
/// objects.
fn pairs(graph: &Graph) -> Vec<(usize, usize)> {
    let renders: Vec<usize> = of_kind(graph, "splat-render").collect();
    let mut pairs = Vec::new();
    let traces = of_kind(graph, "path-trace").filter(|&node| !wires(graph, node, "receiver").is_empty());
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

/// Share of the object's pixels that have splats in front of the object, in the first view of a pair.
fn of_pair(engine: &Engine, graph: &Graph, splats: usize, trace: usize) -> Option<f64> {
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
        share(&Depths {
            splats: depth.samples(),
            coverage: alpha.samples(),
            surface: surface.samples(),
            objects: &objects,
        })
    })
}
