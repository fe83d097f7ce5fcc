//! The topological order of a graph, and diagnostics for cycles.
//!
//! No function recurses, so a chain may be as long as memory allows.

use std::collections::BTreeMap;
use std::ops::Range;

use petgraph::algo::{kosaraju_scc, toposort};
use petgraph::graph::{DiGraph, NodeIndex};

use crate::text::diag::{Code, Diagnostic};
use crate::text::document::RawNode;

/// For each node, the indices of the nodes that it reads, each with the byte range of the wire in the text.
pub(crate) type Wiring = Vec<Vec<(usize, Range<usize>)>>;

/// A topological order of the nodes. If there are cycles, the error contains the strongly connected components that
/// contain them.
pub(crate) fn order_of(wiring: &Wiring) -> Result<Vec<usize>, Vec<Vec<usize>>> {
    let wires: usize = wiring.iter().map(Vec::len).sum();
    let mut graph: DiGraph<(), ()> = DiGraph::with_capacity(wiring.len(), wires);
    for _ in wiring {
        graph.add_node(());
    }
    for (index, reads) in wiring.iter().enumerate() {
        for (above, _) in reads {
            graph.add_edge(NodeIndex::new(*above), NodeIndex::new(index), ());
        }
    }
    match toposort(&graph, None) {
        Ok(order) => Ok(order.into_iter().map(NodeIndex::index).collect()),
        Err(_) => Err(kosaraju_scc(&graph)
            .into_iter()
            .map(|group| group.into_iter().map(NodeIndex::index).collect::<Vec<_>>())
            .filter(|group| group.len() > 1 || wiring[group[0]].iter().any(|(above, _)| *above == group[0]))
            .collect()),
    }
}

/// The diagnostic for one cycle within a strongly connected component. It refers to the first wires of the cycle.
pub(crate) fn describe_cycle(raw: &[RawNode<'_>], wiring: &Wiring, group: &[usize]) -> Diagnostic {
    let members: std::collections::BTreeSet<usize> = group.iter().copied().collect();
    let inside = |node: usize| wiring[node].iter().find(|(above, _)| members.contains(above));
    let mut at = group.iter().copied().min().unwrap_or_default();
    let mut seen = BTreeMap::new();
    let mut walked = Vec::new();
    while let (None, Some((above, _))) = (seen.insert(at, walked.len()), inside(at)) {
        walked.push(at);
        at = *above;
    }
    let start = walked.iter().position(|&node| node == at).unwrap_or_default();
    let mut cycle = walked.split_off(start);
    cycle.reverse();
    // The description starts with the node that is first in the file.
    let first = (0..cycle.len()).min_by_key(|&place| cycle[place]).unwrap_or_default();
    cycle.rotate_left(first);
    let shown = 12;
    let mut names: Vec<&str> = cycle.iter().take(shown).map(|&node| &*raw[node].id).collect();
    if cycle.len() > shown {
        names.push("..");
    }
    names.push(&raw[cycle[0]].id);
    let place = |node: usize| inside(node).map_or(raw[node].id_span.clone(), |(_, span)| span.clone());
    let mut diagnostic = Diagnostic::of(
        Code::Cycle,
        place(cycle[0]),
        format!("the nodes form a cycle: {}", names.join(" -> ")),
    )
    .label(format!("`{}` depends on itself", raw[cycle[0]].id));
    for &node in cycle.iter().skip(1).take(shown) {
        diagnostic = diagnostic.related(place(node), format!("through `{}`", raw[node].id));
    }
    diagnostic
}
