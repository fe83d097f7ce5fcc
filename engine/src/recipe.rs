//! Recipes: the canonical text of what stands above a node, for the metadata of written pictures.
//!
//! Nodes are renamed in the order in which they are first read, defaults are left out, paths are cut to
//! the name of the file and followed by the digest of its content. So renaming, reordering and comments
//! in the graph file leave the recipe as it is.

use std::fmt::Write as _;

use crate::context::{ReadSource, Scene};
use crate::graph::Graph;
use crate::param::Role;
use crate::port::Arity;

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
    let mut text = format!(
        "Graph(version:1,scene:(up:\"{}\",metres_per_unit:{metres_per_unit:?},seed:{seed}),nodes:(\n",
        up.name()
    );
    let mut files = String::new();
    for &index in &order {
        let node = &graph.nodes[index];
        let mut fields: Vec<String> = Vec::new();
        let mut params = node.kind.params.iter();
        node.step.visit(&mut |name, value| {
            let (Some(spec), Ok(value)) = (params.next(), value.text()) else { return };
            if spec.default.as_deref() == Some(value.as_str()) {
                return;
            }
            let value = match spec.role {
                Role::Value => value,
                Role::Input | Role::Output => file_name(&value, spec.role),
            };
            fields.push(format!("{name}:{value}"));
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
            let name = source.file.name.rsplit('/').next().unwrap_or_default();
            let _ = writeln!(files, "// n{} reads {name} {}", number[index], source.digest);
        }
    }
    text.push_str("))\n");
    text + &files
}

/// A quoted path without its folders; what a picture was called is no part of how it was made.
fn file_name(quoted: &str, role: Role) -> String {
    let plain = quoted.trim_matches('"');
    let name = plain.rsplit('/').next().unwrap_or(plain);
    match (role, name.rsplit_once('.')) {
        (Role::Output, Some((_, ending))) => format!("\"out.{}\"", ending.to_lowercase()),
        _ => format!("\"{name}\""),
    }
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
