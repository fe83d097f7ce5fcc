//! Finds splats in front of an inserted object, from the pictures of a run.

use engine::{Engine, Graph, Wire};
use nodes::geometry::before_object::{Depths, share};
use nodes::types::{Images, Picture};

use super::memory::{Done, Key, Memory};
use super::pair::{Finding, of_kind};
use crate::session::wires;

/// Maximum number of compared pairs. A pair consists of a picture of splats and a trace; only its first view is
/// compared. This bounds the time of the check.
const MOST_PAIRS: usize = 4;
/// Splats in front of an object are reported if they cover at least this share of its pixels. A smaller share is
/// normal, because splats extend beyond the surface that they represent. For example, the splats of a post in front
/// of an object covered 11 % of the object along the edge of the post.
const LEAST: f64 = 0.2;

/// Compares each picture of splats with each trace of the same cameras. Pairs of which this run has no results are
/// left out. The findings are remembered with the keys of the nodes.
pub fn findings(engine: &Engine, graph: &Graph, done: &Done, memory: &mut Memory) -> Vec<Finding> {
    let key = |(splats, trace): (usize, usize)| {
        let mut key = Key::new("before object");
        [splats, trace].into_iter().try_for_each(|node| key.output(graph, Wire { node, port: 0 }, done))?;
        Some(key.digest())
    };
    let text = |(splats, trace): (usize, usize)| {
        let share = of_pair(engine, graph, splats, trace)?;
        if share < LEAST {
            return Some(Vec::new());
        }
        let [a, b] = [splats, trace].map(|node| &graph.nodes[node].id);
        let text = format!(
            "`{a}` and `{b}`: splats are in front of the object at {:.0} % of its pixels, but the object is drawn over \
             them, because the mesh of the place has no surface there. To draw these splats over the object, wire \
             `{b}.nearest` to `limit` of a second `SplatRender`, and its picture to `front` of `Composite`",
            100.0 * share
        );
        Some(vec![("splats-before-object", text)])
    };
    let keyed = pairs(graph).into_iter().filter_map(|pair| Some((key(pair)?, pair)));
    keyed.take(MOST_PAIRS).flat_map(|(key, pair)| memory.remembered(key, || text(pair))).collect()
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
