//! Splats and a mesh that belong together, and how they are found.

use engine::{Graph, Wire};

use crate::session::wires;

/// A finding: its id, and a text that names the nodes.
pub type Finding = (&'static str, String);

/// Splats and a mesh that are rendered with the same cameras, and the wires of these cameras and of the inserted
/// objects.
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
