//! Recipes: the canonical text of what stands above a node, for the metadata of written pictures.
//!
//! Nodes are renamed in the order in which they are first read, every parameter is written, since defaults
//! may change, and the kinds are named with their versions. Paths are cut to the name of the file; the digest
//! of its content follows at the end. So renaming, reordering and comments in the graph file leave the recipe
//! as it is.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use crate::context::{ReadSource, Scene};
use crate::edit::replace_strings;
use crate::graph::Graph;
use crate::param::Role;
use crate::port::Arity;

/// How a recipe begins; the kinds follow.
pub(crate) const HEAD: &str = "// lightharmony recipe 2: ";
/// Between a node and a file that it reads.
pub(crate) const READS: &str = " reads ";

/// The recipe of `target`. `sources` gives the sources of a node, digests known.
pub(crate) fn recipe<'s>(
    graph: &Graph,
    target: usize,
    sources: impl Fn(usize) -> &'s [ReadSource],
) -> String {
    let order = reading_order(graph, target);
    let mut number = vec![usize::MAX; graph.nodes.len()];
    for (index, &node) in order.iter().enumerate() {
        number[node] = index;
    }
    let Scene { up, metres_per_unit, seed } = graph.scene;
    let kinds: BTreeSet<String> = order
        .iter()
        .map(|&node| &graph.nodes[node].kind)
        .map(|kind| format!("{} {} {}", kind.name, kind.version, kind.profile))
        .collect();
    let kinds: Vec<String> = kinds.into_iter().collect();
    let mut text = format!(
        "{HEAD}{}\nGraph(version:1,scene:(up:\"{}\",metres_per_unit:{metres_per_unit:?},seed:{seed}),nodes:(\n",
        kinds.join(", "),
        up.name()
    );
    let mut files = String::new();
    for &index in &order {
        let node = &graph.nodes[index];
        let mut fields: Vec<String> = Vec::new();
        node.step.texts(&node.kind, &mut |index, text| {
            let Some(spec) = node.kind.params.get(index) else { return };
            fields.push(match spec.role {
                Role::Value => format!("{}:{text}", spec.name),
                Role::Input => {
                    format!("{}:{}", spec.name, replace_strings(text, |path| last(path).to_owned()))
                }
                Role::Output => format!("{}:{}", spec.name, replace_strings(text, output_name)),
            });
        });
        for (port, wires) in node.kind.inputs.iter().zip(&node.inputs) {
            let names: Vec<String> = wires
                .iter()
                .map(|wire| {
                    let output = graph.nodes[wire.node].kind.outputs[wire.port].name;
                    format!("\"n{}.{output}\"", number[wire.node])
                })
                .collect();
            match (port.arity, names.as_slice()) {
                (_, []) => {}
                (Arity::Many, names) => fields.push(format!("{}:[{}]", port.name, names.join(","))),
                (_, [name, ..]) => fields.push(format!("{}:{name}", port.name)),
            }
        }
        // Writing to a string cannot fail.
        let _ = writeln!(text, "n{}:{}({}),", number[index], node.kind.camel_name(), fields.join(","));
        for source in sources(index) {
            let _ = writeln!(
                files,
                "// n{}{READS}{} {}",
                number[index],
                last(&source.file.name).replace(char::is_control, "_"),
                source.digest
            );
        }
    }
    text.push_str("))\n");
    text + &files
}

/// The name of a file without its folders.
pub(crate) fn last(path: &str) -> &str {
    let path = path.trim_end_matches('/');
    path.rsplit('/').next().unwrap_or(path)
}

/// What a picture was called is no part of how it was made, but for the ending and whether views stand apart.
fn output_name(path: &str) -> String {
    let ending = last(path)
        .rsplit_once('.')
        .map_or_else(String::new, |(_, ending)| format!(".{}", ending.to_lowercase()));
    format!("{}{ending}", if path.contains("{view}") { "{view}" } else { "out" })
}

/// Nodes above `target` and itself, inputs first, in the order in which the ports name them.
fn reading_order(graph: &Graph, target: usize) -> Vec<usize> {
    let mut order = Vec::new();
    let mut seen = vec![false; graph.nodes.len()];
    let mut stack = vec![(target, false)];
    while let Some((node, inputs_done)) = stack.pop() {
        if inputs_done {
            order.push(node);
        } else if !std::mem::replace(&mut seen[node], true) {
            stack.push((node, true));
            let above: Vec<usize> = graph.nodes[node].inputs.iter().flatten().map(|wire| wire.node).collect();
            stack.extend(above.into_iter().rev().map(|node| (node, false)));
        }
    }
    order
}
