//! Differences between two graphs: in their text, and in their results.

use std::collections::{BTreeMap, HashMap};

use cache::{Change, Digest};

use crate::graph::graph::Graph;
use crate::graph::node::Wire;
use crate::plan::plan::{Fate, Outlook};
use crate::run::engine::Engine;
use crate::run::job::stored_value;
use crate::value::artifact::{AnyArtifact, Difference};
use crate::value::files::Files;

/// The difference of a node between two graphs.
#[derive(Debug, Clone, PartialEq)]
pub enum NodeDifference {
    /// The node exists only in the first graph.
    Gone,
    /// The node exists only in the second graph.
    New,
    /// Parameters, wires, or the kind itself differ.
    Changed(Vec<Change>),
}

/// Lists the differences between two graphs by name: `scene`, then the nodes in the order of the first graph, then
/// the nodes that only the second graph has. Layout, comments, and defaults that are written out make no
/// difference.
pub fn graph_differences(a: &Graph, b: &Graph) -> Vec<(String, NodeDifference)> {
    let mut found = Vec::new();
    let scene = |graph: &Graph| {
        let scene = graph.scene;
        let fields = [
            ("up", scene.up.name().to_owned()),
            ("metres_per_unit", format!("{:?}", scene.metres_per_unit)),
            ("seed", scene.seed.to_string()),
            ("exhaustive", scene.exhaustive.to_string()),
        ];
        fields.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
    };
    let changes = changes(scene(a), scene(b));
    if !changes.is_empty() {
        found.push(("scene".to_owned(), NodeDifference::Changed(changes)));
    }
    let (in_a, in_b) = (by_name(a), by_name(b));
    for (index, node) in a.nodes.iter().enumerate() {
        let difference = match in_b.get(node.id.as_str()).copied() {
            None => NodeDifference::Gone,
            Some(other) => NodeDifference::Changed(self::changes(fields(a, index), fields(b, other))),
        };
        if difference != NodeDifference::Changed(Vec::new()) {
            found.push((node.id.clone(), difference));
        }
    }
    let new = b.nodes.iter().filter(|node| !in_a.contains_key(node.id.as_str()));
    found.extend(new.map(|node| (node.id.clone(), NodeDifference::New)));
    found
}

fn by_name(graph: &Graph) -> HashMap<&str, usize> {
    graph.nodes.iter().enumerate().map(|(index, node)| (node.id.as_str(), index)).collect()
}

/// The kind, the parameters (including defaults) and the wires of a node, as pairs of name and text.
fn fields(graph: &Graph, index: usize) -> Vec<(String, String)> {
    let node = &graph.nodes[index];
    let mut fields = vec![("kind".to_owned(), node.kind.name.to_owned())];
    node.step.visit(&mut |name, value| fields.push((name.to_owned(), value.text().unwrap_or_default())));
    let wire = |wire: &Wire| {
        let above = &graph.nodes[wire.node];
        format!("{}.{}", above.id, above.kind.outputs[wire.port].name)
    };
    for (port, wires) in node.kind.inputs.iter().zip(&node.inputs).filter(|(_, wires)| !wires.is_empty()) {
        let wires: Vec<String> = wires.iter().map(wire).collect();
        fields.push((port.name.to_owned(), wires.join(", ")));
    }
    fields
}

/// Fields that were removed, added or changed.
pub(crate) fn changes(old: Vec<(String, String)>, new: Vec<(String, String)>) -> Vec<Change> {
    let before: BTreeMap<&String, &String> = old.iter().map(|(name, value)| (name, value)).collect();
    let after: BTreeMap<&String, &String> = new.iter().map(|(name, value)| (name, value)).collect();
    let gone = old.iter().filter(|(name, _)| !after.contains_key(name));
    let gone = gone.map(|(name, value)| (name, Some(value.clone()), None));
    let other = new.iter().filter(|(name, value)| before.get(name) != Some(&value));
    let other =
        other.map(|(name, value)| (name, before.get(name).map(|v| (*v).clone()), Some(value.clone())));
    other.chain(gone).map(|(path, old, new)| Change { path: path.clone(), old, new }).collect()
}

/// A node whose stored results differ.
#[derive(Debug, Clone, PartialEq)]
pub struct ResultDifference {
    /// Name of the node.
    pub id: String,
    /// Names of the outputs that differ. For each, the difference between the two values if both are stored.
    pub outputs: Vec<(String, Option<Difference>)>,
    /// True if no input of the node differs, so that the difference originates in the node itself.
    pub first: bool,
}

/// Comparison of the results of two graphs. Nodes that have the same name and kind in both graphs are compared, in
/// topological order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ResultDifferences {
    /// Number of nodes that have a result in both graphs.
    pub compared: usize,
    /// Nodes whose results differ.
    pub unequal: Vec<ResultDifference>,
    /// For the first and for the second graph, the names of the nodes that have no result there.
    pub unknown: [Vec<String>; 2],
}

/// Compares the stored results of two graphs, each in the store of its engine. `of_files` describes the difference
/// between two outputs of sinks, since the engine itself can only compare their bytes.
pub fn result_differences(
    a: (&Engine, &Graph),
    b: (&Engine, &Graph),
    of_files: impl Fn(&Files, &Files) -> Difference,
) -> ResultDifferences {
    let known = |(engine, graph): (&Engine, &Graph)| {
        let mut outlook = Outlook::new(engine, graph);
        let mut known = vec![false; graph.nodes.len()];
        for &index in graph.order() {
            known[index] = matches!(outlook.fate(index), Fate::Known | Fate::Lost);
        }
        (outlook.records, known)
    };
    let ((records_a, known_a), (records_b, known_b)) = (known(a), known(b));
    let (mut found, in_b) = (ResultDifferences::default(), by_name(b.1));
    let mut differs = vec![false; a.1.nodes.len()];
    for &index in a.1.order() {
        let node = &a.1.nodes[index];
        let Some(other) = in_b.get(node.id.as_str()).copied() else { continue };
        if node.kind.name != b.1.nodes[other].kind.name {
            continue;
        }
        for (unknown, known) in found.unknown.iter_mut().zip([known_a[index], known_b[other]]) {
            if !known {
                unknown.push(node.id.clone());
            }
        }
        let (true, true, Some(then), Some(now)) =
            (known_a[index], known_b[other], &records_a[index], &records_b[other])
        else {
            continue;
        };
        found.compared += 1;
        let mut outputs = Vec::new();
        for (port, (then, now)) in node.kind.outputs.iter().zip(then.outputs.iter().zip(&now.outputs)) {
            if then.digest != now.digest {
                let value =
                    |engine: &Engine, digest: &Digest| stored_value(engine.store(), &port.artifact, digest);
                let pair = value(a.0, &then.digest).zip(value(b.0, &now.digest));
                let difference = |(a, b): (AnyArtifact, AnyArtifact)| match a
                    .downcast_ref::<Files>()
                    .zip(b.downcast_ref::<Files>())
                {
                    Some((a, b)) => of_files(a, b),
                    None => port.artifact.difference(&a, &b),
                };
                outputs.push((port.name.to_owned(), pair.map(difference)));
            }
        }
        if !outputs.is_empty() {
            differs[index] = true;
            let first = !a.1.reads(index).iter().any(|&above| differs[above]);
            found.unequal.push(ResultDifference { id: node.id.clone(), outputs, first });
        }
    }
    found
}
