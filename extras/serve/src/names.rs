//! Names in a graph file: those of nodes and their instances, and those of the blocks `scene` and `parameters`, which
//! nodes may have as well.

use std::borrow::Cow;

use engine::{Graph, GraphText};

/// Names of the blocks whose fields can be edited.
const BLOCKS: [&str; 2] = ["scene", "parameters"];

/// The nodes of the graph that one node of the file defines: one node, or one instance for each combination of axis
/// values.
pub fn instances<'g>(graph: &'g Graph, name: &str) -> impl Iterator<Item = usize> + use<'g> {
    let name = name.to_owned();
    let is = move |node: &engine::Node| {
        node.id == name || !node.point.is_empty() && node.id.split('/').next() == Some(name.as_str())
    };
    graph.nodes.iter().enumerate().filter(move |(_, node)| is(node)).map(|(index, _)| index)
}

/// True if `name` means a block: it is the name of one, and no node of this name has the field.
pub fn is_block(graph: &Graph, name: &str, field: &str) -> bool {
    let has = |index: usize| {
        let kind = &graph.nodes[index].kind;
        kind.params.iter().any(|param| param.name == field)
            || kind.inputs.iter().any(|port| port.name == field)
    };
    BLOCKS.contains(&name) && !instances(graph, name).any(has)
}

/// A text of the same length in which `name` means the block if [`is_block`] is true: a node of this name has another
/// one. Byte ranges in it are those in `text`. The node that `init` calls `scene` has the name of the block.
pub fn unshadowed<'t>(graph: &Graph, name: &str, field: &str, text: &'t str) -> Cow<'t, str> {
    let node = GraphText::new(text).node(name).filter(|_| is_block(graph, name, field));
    match node {
        Some(span) if text[span.start..].starts_with(name) => {
            let rest = &text[span.start + name.len()..];
            Cow::Owned([&text[..span.start], "x".repeat(name.len()).as_str(), rest].concat())
        }
        _ => Cow::Borrowed(text),
    }
}
