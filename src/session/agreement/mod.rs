//! Checks after a run whether the splats, the mesh and the cameras of a place agree.

mod advice;
mod before_object;
mod memory;
mod pair;

use engine::{Digest, Engine, Graph, Scene, Wire};
use glam::DVec3;
use nodes::geometry::support::corners;
use nodes::math::equirect::axes;
use nodes::render::agreement::{CapturedPlace, Comparison, compare};
use nodes::types::{Mesh, Placed, Rig, Splats};

use super::wires;
use memory::Key;
pub use memory::{Done, Memory};
pub use pair::Finding;
use pair::{Pair, above, of_kind};

/// Maximum number of pairs of splats and mesh that are compared. This bounds the time of the check.
const MOST_PLACES: usize = 2;
/// Maximum number of rigs, and of objects, that are considered for each pair.
const MOST_INPUTS: usize = 3;
/// Kinds that make the mesh of a place from its splats. Such a mesh is always in the frame of the splats.
const MADE_OF_SPLATS: [&str; 2] = ["extract-mesh", "plane"];

/// Checks the pairs of splats and mesh of a graph. `done` has the keys of the nodes whose results this run computed
/// or found in the cache; other pairs are skipped. The findings of each comparison are remembered with the keys of
/// its nodes, so that each run reports them and only a change leads to a new comparison.
pub fn findings(engine: &Engine, graph: &Graph, done: &Done, memory: &mut Memory) -> Vec<Finding> {
    let mut found = Vec::new();
    let compared = pairs(graph).into_iter().filter(|pair| !is_made_of_splats(graph, pair.mesh.node));
    let keyed = compared.filter_map(|pair| Some((key(graph, &pair, done)?, pair)));
    for (key, pair) in keyed.take(MOST_PLACES) {
        let compare = || {
            let comparison = of_pair(engine, graph, &pair)?;
            Some(comparison.map_or_else(Vec::new, |found| advice::texts(graph, &pair, &found)))
        };
        found.extend(memory.remembered(key, compare));
    }
    if found.is_empty() {
        found = before_object::findings(engine, graph, done, memory);
    }
    found
}

/// Digest of everything that the findings about a pair depend on. `None` if the run has no result of its splats, its
/// mesh or one of its rigs.
fn key(graph: &Graph, pair: &Pair, done: &Done) -> Option<Digest> {
    let mut key = Key::new("pair");
    let Scene { up, metres_per_unit, .. } = graph.scene;
    key.text(up.name());
    key.bytes(&metres_per_unit.to_le_bytes());
    for (wire, input) in [(pair.splats, "splats"), (pair.mesh, "mesh")] {
        key.output(graph, wire, done)?;
        // The text names the loader.
        above(graph, wire.node, input).for_each(|node| key.text(&graph.nodes[node].id));
    }
    pair.rigs.iter().try_for_each(|&rig| key.output(graph, rig, done))?;
    key.text("objects");
    for &object in &pair.objects {
        // An object whose node failed is left out of the comparison.
        let _ = key.output(graph, object, done);
    }
    Some(key.digest())
}

/// True if a mesh is made from splats.
fn is_made_of_splats(graph: &Graph, mesh: usize) -> bool {
    above(graph, mesh, "mesh").any(|node| MADE_OF_SPLATS.contains(&graph.nodes[node].kind.name))
}

/// Pairs of splats and a receiver that are rendered with the same cameras. Each pair is listed once.
fn pairs(graph: &Graph) -> Vec<Pair> {
    let mut pairs: Vec<Pair> = Vec::new();
    for trace in of_kind(graph, "path-trace") {
        let rig = wires(graph, trace, "rig");
        let (Some(&mesh), Some(&camera)) = (wires(graph, trace, "receiver").first(), rig.first()) else {
            continue;
        };
        for render in of_kind(graph, "splat-render").filter(|&node| wires(graph, node, "rig") == rig) {
            let Some(&splats) = wires(graph, render, "splats").first() else { continue };
            let known = pairs.iter().position(|pair| pair.splats == splats && pair.mesh == mesh);
            let index = known.unwrap_or_else(|| {
                pairs.push(Pair { splats, mesh, rigs: Vec::new(), objects: Vec::new() });
                pairs.len() - 1
            });
            let pair = &mut pairs[index];
            let mut add = |to: fn(&mut Pair) -> &mut Vec<Wire>, wire: Wire| {
                let list = to(pair);
                if list.len() < MOST_INPUTS && !list.contains(&wire) {
                    list.push(wire);
                }
            };
            add(|pair| &mut pair.rigs, camera);
            wires(graph, trace, "objects").iter().for_each(|&object| add(|pair| &mut pair.objects, object));
        }
    }
    pairs
}

/// Compares splats and mesh in the views of the cameras and around the objects. Returns `None` if a value is not in
/// the cache, and `Some(None)` if there is nothing to compare.
fn of_pair(engine: &Engine, graph: &Graph, pair: &Pair) -> Option<Option<Comparison>> {
    let splats = engine.value::<Splats>(graph, pair.splats)?;
    let mesh = engine.value::<Mesh>(graph, pair.mesh)?;
    let rigs = pair.rigs.iter().filter_map(|&wire| engine.value::<Rig>(graph, wire));
    let cameras: Vec<_> = rigs.flat_map(|rig| rig.cameras).collect();
    let objects = pair.objects.iter().filter_map(|&wire| engine.value::<Placed>(graph, wire));
    let around: Vec<DVec3> = objects.filter_map(|placed| middle(&placed)).collect();
    let Scene { up, metres_per_unit, .. } = graph.scene;
    let place = CapturedPlace {
        splats: &splats,
        mesh: &mesh,
        cameras: &cameras,
        around: &around,
        axes: axes(up),
        metre: 1.0 / metres_per_unit,
    };
    compare(&place, &super::splats::context(up)).ok()
}

/// Middle of the bounding box of an object in the world.
fn middle(placed: &Placed) -> Option<DVec3> {
    let all = corners(placed).map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)));
    all.map(|(low, high)| (low + high) * 0.5)
}
