//! Splats and meshes that belong together, and how they are found.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use engine::{Digest, Graph, Wire};

use super::nearest::Nearest;
use crate::session::wires;

/// A finding: its id, and a text that names the nodes.
pub type Finding = (&'static str, String);

/// Digest of the value of an output in this run; `None` if this run has no such value.
pub(super) type DigestOf<'a> = &'a dyn Fn(Wire) -> Option<Digest>;

/// Kinds that render splats.
const RENDERS: [&str; 2] = ["splat-render", "splat-panorama"];

/// Splats and a mesh that show the same place, and the wires of the cameras of the mesh and of the inserted
/// objects. The values are pairwise different.
#[derive(Debug, PartialEq)]
pub(super) struct Pair {
    pub(super) splats: Wire,
    pub(super) mesh: Wire,
    pub(super) rigs: Vec<Wire>,
    pub(super) objects: Vec<Wire>,
}

/// The given node, followed by the nodes upstream of it that are reached by repeatedly following the first wire of
/// the input `input`.
pub(super) fn above<'a>(graph: &'a Graph, node: usize, input: &'a str) -> impl Iterator<Item = usize> + 'a {
    std::iter::successors(Some(node), move |&node| wires(graph, node, input).first().map(|wire| wire.node))
}

/// Indices of the nodes of a kind.
pub(super) fn of_kind<'a>(graph: &'a Graph, kind: &'a str) -> impl Iterator<Item = usize> + 'a {
    (0..graph.nodes.len()).filter(move |&node| graph.nodes[node].kind.name == kind)
}

/// Name of a node as written in the graph file, without the axis values of an instance.
pub(super) fn written(graph: &Graph, node: usize) -> &str {
    graph.nodes[node].id.split('/').next().unwrap_or_default()
}

/// Name of a node as written in the graph file, in backticks, followed by the axis values of an instance.
pub(super) fn instance(graph: &Graph, node: usize) -> String {
    match graph.nodes[node].id.split_once('/') {
        Some((name, values)) => format!("`{name}` (at `{values}`)"),
        None => format!("`{}`", graph.nodes[node].id),
    }
}

/// Indices from 0 to `count` (excluded): all, or `most` of them from the first to the last, spread evenly.
pub(super) fn spread(count: usize, most: usize) -> Vec<usize> {
    if count <= most {
        return (0..count).collect();
    }
    match most.checked_sub(1) {
        None => Vec::new(),
        Some(0) => vec![0],
        Some(steps) => (0..most).map(|step| (step * (count - 1) + steps / 2) / steps).collect(),
    }
}

/// True if no axis has different values at two nodes.
pub(super) fn at_one_point(graph: &Graph, a: usize, b: usize) -> bool {
    let other = |axis: &str| graph.nodes[b].point.iter().find(|(known, _)| known == axis);
    graph.nodes[a].point.iter().all(|(axis, value)| other(axis).is_none_or(|(_, known)| known == value))
}

/// The renders of splats and the traces that each node draws.
pub(super) struct Composites {
    behind: Nearest,
    traces: Nearest,
}

impl Composites {
    pub(super) fn new(graph: &Graph) -> Self {
        // What is upstream of a trace is not part of the background.
        Self {
            behind: Nearest::new(graph, &RENDERS, &["path-trace"]),
            traces: Nearest::new(graph, &["path-trace"], &[]),
        }
    }

    /// The renders of splats that a composite has as its background.
    pub(super) fn backgrounds(&self, graph: &Graph, composite: usize) -> Rc<[usize]> {
        self.behind.of(wires(graph, composite, "background"))
    }

    /// The traces whose objects a composite draws.
    pub(super) fn traces(&self, graph: &Graph, composite: usize) -> Rc<[usize]> {
        self.traces.of(wires(graph, composite, "object"))
    }
}

/// Pairs of splats and a receiver of which this run has the values. Each pair of different values is listed once.
///
/// The splats of a trace are those of the background of its composite or, without such a composite, those that are
/// rendered with equal cameras; and those from which the light of the trace is rendered. Without any of these, they
/// are the splats of the run, if it has only one set of splats. Nodes at different values of an axis do not belong
/// together.
pub(super) fn pairs(graph: &Graph, digest: DigestOf<'_>) -> Vec<Pair> {
    let mut behind: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    let composites = Composites::new(graph);
    for composite in of_kind(graph, "composite") {
        let renders = composites.backgrounds(graph, composite);
        for &trace in &*composites.traces(graph, composite) {
            behind.entry(trace).or_default().extend(&*renders);
        }
    }
    let lighting = Nearest::new(graph, &RENDERS, &[]);
    let mut by_rig: BTreeMap<Digest, Vec<usize>> = BTreeMap::new();
    for render in of_kind(graph, "splat-render") {
        if let Some(rig) = value(graph, render, "rig", digest) {
            by_rig.entry(rig.1).or_default().push(render);
        }
    }
    let only = only_splats(graph, digest);
    let mut found: Vec<Pair> = Vec::new();
    let mut known: BTreeMap<(Digest, Digest), usize> = BTreeMap::new();
    let mut seen: BTreeSet<(usize, Digest)> = BTreeSet::new();
    for trace in of_kind(graph, "path-trace") {
        let of = |input| value(graph, trace, input, digest);
        let (Some((mesh, of_mesh)), Some((rig, of_rig))) = (of("receiver"), of("rig")) else { continue };
        let splats_of = |node: &usize| value(graph, *node, "splats", digest);
        let belongs = |node: &&usize| at_one_point(graph, trace, **node);
        let in_background = behind.get(&trace).into_iter().flatten().filter(belongs);
        let mut splats: Vec<(Wire, Digest)> = in_background.filter_map(splats_of).collect();
        if splats.is_empty() {
            let equal = by_rig.get(&of_rig).into_iter().flatten().filter(belongs);
            splats.extend(equal.filter_map(splats_of));
        }
        splats.extend(lighting.of(wires(graph, trace, "env")).iter().filter_map(splats_of));
        if splats.is_empty() {
            splats.extend(only);
        }
        let mut of_trace = BTreeSet::new();
        for (splats, of_splats) in splats {
            if !of_trace.insert(of_splats) {
                continue;
            }
            let index = *known.entry((of_splats, of_mesh)).or_insert_with(|| {
                found.push(Pair { splats, mesh, rigs: Vec::new(), objects: Vec::new() });
                found.len() - 1
            });
            if seen.insert((index, of_rig)) {
                found[index].rigs.push(rig);
            }
            for &object in wires(graph, trace, "objects") {
                if digest(object).is_some_and(|of_object| seen.insert((index, of_object))) {
                    found[index].objects.push(object);
                }
            }
        }
    }
    found
}

/// The first wire of an input, with the digest of its value. `None` if nothing is wired, or if this run has no such
/// value.
fn value(graph: &Graph, node: usize, input: &str, digest: DigestOf<'_>) -> Option<(Wire, Digest)> {
    let wire = *wires(graph, node, input).first()?;
    Some((wire, digest(wire)?))
}

/// The splats that the nodes of this run read, if they all have the same value.
fn only_splats(graph: &Graph, digest: DigestOf<'_>) -> Option<(Wire, Digest)> {
    let mut all = (0..graph.nodes.len()).filter_map(|node| value(graph, node, "splats", digest));
    let first = all.next()?;
    all.all(|(_, other)| other == first.1).then_some(first)
}

#[cfg(test)]
mod tests;
