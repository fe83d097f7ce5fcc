//! Checks after a run whether the splats, the mesh and the cameras of a place agree.

mod advice;
mod before_object;
mod memory;
mod nearest;
mod pair;
mod values;

use std::collections::BTreeSet;

use engine::{Digest, Engine, Graph, Scene};
use glam::DVec3;
use render::agreement::{CapturedPlace, Comparison, compare};
use render::geometry::support::corners;
use scene::math::equirect::axes;
use scene::types::{Mesh, Placed, Rig, Splats};

use memory::Key;
pub use memory::{Done, Memory};
pub use pair::Finding;
use pair::{DigestOf, Pair, above, of_kind, pairs, spread};
use values::Values;

/// Maximum number of pairs of splats and mesh that a run compares, in addition to those that it remembers. This
/// bounds the time of the check.
const MOST_PLACES: usize = 8;
/// Maximum number of rigs that are considered for each pair. The comparison uses three views.
const MOST_RIGS: usize = 3;
/// Maximum number of objects that are considered for each pair.
const MOST_OBJECTS: usize = 2;
/// Kinds that make the mesh of a place from its splats. Such a mesh is always in the frame of the splats.
const MADE_OF_SPLATS: [&str; 2] = ["extract-mesh", "plane"];

/// Compares the splats and the meshes that took part in a run. `done` has the keys of the nodes whose results this
/// run computed or found in the cache; only their values are compared. The findings of each comparison are
/// remembered with the values that it depends on, so that each run reports them and only a change leads to a new
/// comparison.
pub fn findings(engine: &Engine, graph: &Graph, done: &Done, memory: &mut Memory) -> Vec<Finding> {
    if of_kind(graph, "path-trace").next().is_none() {
        return Vec::new();
    }
    let values = Values::new(engine, graph, done);
    let digest: DigestOf<'_> = &|wire| values.digest(wire);
    let mut pairs = pairs(graph, digest);
    pairs.retain(|pair| !is_made_of_splats(graph, pair.mesh.node));
    pairs.iter_mut().for_each(Pair::limit);
    let keyed = pairs.into_iter().filter_map(|pair| Some((key(graph, &pair, done, digest)?, pair)));
    let (keys, pairs): (Vec<Digest>, Vec<Pair>) = keyed.unzip();
    let compared = memory.each(&keys, MOST_PLACES, |index| {
        let pair = &pairs[index];
        let comparison = of_pair(engine, graph, done, pair)?;
        Some(comparison.map_or_else(Vec::new, |found| advice::texts(graph, pair, &found)))
    });
    let (mut found, mut wrong, mut left) = (Vec::new(), BTreeSet::new(), 0);
    for (pair, of_pair) in pairs.iter().zip(compared) {
        match of_pair {
            Some(of_pair) => {
                if !of_pair.is_empty() {
                    wrong.extend(digest(pair.mesh));
                }
                found.extend(of_pair);
            }
            None => left += 1,
        }
    }
    if left > 0 {
        found.push((
            "agreement-unchecked",
            format!(
                "{left} of {} pairs of splats and mesh were not compared, since a run compares at most {MOST_PLACES} new \
                 pairs. Run a part of the graph with `--frames` or `--only` to compare others",
                pairs.len()
            ),
        ));
    }
    found.extend(before_object::findings((engine, graph), done, (digest, &wrong), memory));
    if values.lacks_records() {
        memory.set_incomplete();
    }
    found
}

impl Pair {
    /// Leaves out rigs and objects above the maximum numbers. The remaining ones are spread evenly.
    fn limit(&mut self) {
        for (list, most) in [(&mut self.rigs, MOST_RIGS), (&mut self.objects, MOST_OBJECTS)] {
            *list = spread(list.len(), most).into_iter().map(|index| list[index]).collect();
        }
    }
}

/// Digest of everything that the findings about a pair depend on. `None` if the run lacks a value of the pair.
fn key(graph: &Graph, pair: &Pair, done: &Done, digest: DigestOf<'_>) -> Option<Digest> {
    let mut key = Key::new("pair");
    let Scene { up, metres_per_unit, .. } = graph.scene;
    key.text(up.name());
    key.bytes(&metres_per_unit.to_le_bytes());
    for (wire, input) in [(pair.splats, "splats"), (pair.mesh, "mesh")] {
        key.value(wire, digest)?;
        // The text names these nodes, and its advice depends on the parameters of the loader.
        above(graph, wire.node, input).try_for_each(|node| key.node(graph, node, done))?;
    }
    for (what, list) in [("rigs", &pair.rigs), ("objects", &pair.objects)] {
        key.text(what);
        list.iter().try_for_each(|&wire| key.value(wire, digest))?;
    }
    Some(key.digest())
}

/// True if a mesh is made from splats.
fn is_made_of_splats(graph: &Graph, mesh: usize) -> bool {
    above(graph, mesh, "mesh").any(|node| MADE_OF_SPLATS.contains(&graph.nodes[node].kind.name))
}

/// Compares splats and mesh in the views of the cameras and around the objects. Returns `None` if a value is not in
/// the cache, and `Some(None)` if there is nothing to compare.
fn of_pair(engine: &Engine, graph: &Graph, done: &Done, pair: &Pair) -> Option<Option<Comparison>> {
    let keys = |node: usize| done.key(graph, node).copied();
    // The run may have left values on a server; computing them here would take as long as the run.
    let splats = engine.value_at_hand::<Splats>(graph, &keys, pair.splats)?;
    let mesh = engine.value_at_hand::<Mesh>(graph, &keys, pair.mesh)?;
    let rigs = pair.rigs.iter().map(|&wire| engine.value_at_hand::<Rig>(graph, &keys, wire));
    let rigs = rigs.collect::<Option<Vec<Rig>>>()?;
    let cameras: Vec<_> = rigs.into_iter().flat_map(|rig| rig.cameras).collect();
    let objects = pair.objects.iter().map(|&wire| engine.value_at_hand::<Placed>(graph, &keys, wire));
    let objects = objects.collect::<Option<Vec<Placed>>>()?;
    let around: Vec<DVec3> = objects.iter().filter_map(middle).collect();
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
