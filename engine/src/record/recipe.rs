//! Recipes: the canonical graph upstream of a node as text, for the metadata of written pictures.
//!
//! Nodes are numbered in the order in which they are first read. All parameters are written, since defaults may
//! change, and kinds are listed with their versions. Paths are reduced to file names; the content digests of the
//! files follow at the end. So renaming, reordering and comments in the graph file do not change the recipe.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use crate::graph::graph::Graph;
use crate::kind::context::ReadSource;
use crate::kind::param_type::Role;
use crate::kind::port::Arity;
use crate::kind::registry::KindEntry;
use crate::kind::scene::Scene;
use crate::text::edit::replace_strings;

/// Start of a recipe. The list of kinds follows on the same line.
pub(crate) const HEAD: &str = "// lightharmony recipe 2: ";
/// Separator between a node and a file that it reads.
pub(crate) const READS: &str = " reads ";

/// The recipe of `target`. `sources` returns the source files of a node with their digests.
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
    let Scene { up, metres_per_unit, seed, exhaustive } = graph.scene;
    let exhaustive = if exhaustive { ",exhaustive:true" } else { "" };
    let kinds: BTreeMap<&str, &KindEntry> =
        order.iter().map(|&node| &graph.nodes[node].kind).map(|kind| (kind.name, &**kind)).collect();
    let kinds: Vec<String> =
        kinds.values().map(|kind| format!("{} {} {}", kind.name, kind.version, kind.profile)).collect();
    let mut text = format!(
        "{HEAD}{}\nGraph(version:1,scene:(up:\"{}\",metres_per_unit:{metres_per_unit:?},seed:{seed}{exhaustive}),nodes:(\n",
        kinds.join(", "),
        up.name()
    );
    let mut files = String::new();
    // Writing to a string cannot fail. Fields are written directly, since a large graph has many.
    for &index in &order {
        let node = &graph.nodes[index];
        let _ = write!(text, "n{}:{}(", number[index], node.kind.camel_name());
        let start = text.len();
        node.visit_texts(|index, value| {
            let Some(spec) = node.kind.params.get(index) else { return };
            let _ = match spec.role {
                Role::Value => write!(text, "{}:{value},", spec.name),
                Role::Input => {
                    write!(text, "{}:{},", spec.name, replace_strings(value, |path| last(path).to_owned()))
                }
                Role::Output => write!(text, "{}:{},", spec.name, replace_strings(value, output_name)),
            };
        });
        for (port, wires) in node.kind.inputs.iter().zip(&node.inputs).filter(|(_, wires)| !wires.is_empty())
        {
            let many = port.arity == Arity::Many;
            let _ = write!(text, "{}:{}", port.name, if many { "[" } else { "" });
            for wire in wires {
                let output = graph.nodes[wire.node].kind.outputs[wire.port].name;
                let _ = write!(text, "\"n{}.{output}\",", number[wire.node]);
            }
            if many {
                text.truncate(text.len() - 1);
                text.push_str("],");
            }
        }
        // Removes the comma after the last field.
        text.truncate(text.len().saturating_sub(1).max(start));
        text.push_str("),\n");
        for source in sources(index) {
            let _ = writeln!(
                files,
                "// n{}{READS}{} {}",
                number[index],
                one_line_name(&source.file.name),
                source.digest
            );
        }
    }
    text.push_str("))\n");
    text + &files
}

/// Returns the last component of a path. Returns [`ANY_FOLDER`] for `.` and `..`, since the names of these folders
/// depend on the location of the graph.
pub(crate) fn last(path: &str) -> &str {
    let path = path.trim_end_matches('/');
    match path.rsplit('/').next().unwrap_or(path) {
        ".." => ANY_FOLDER,
        name => name,
    }
}

/// The name in a recipe that stands for a folder with any name.
pub(crate) const ANY_FOLDER: &str = ".";

/// The name of a source file as written at the end of a recipe, on one line.
pub(crate) fn one_line_name(path: &str) -> String {
    last(path).replace(char::is_control, "_")
}

/// Returns the part of the name of a picture that affects how the picture is made: its extension, and `{view}` if
/// the name contains it.
fn output_name(path: &str) -> String {
    let ending = last(path)
        .rsplit_once('.')
        .map_or_else(String::new, |(_, ending)| format!(".{}", ending.to_lowercase()));
    format!("{}{ending}", if path.contains("{view}") { "{view}" } else { "out" })
}

/// `target` and the nodes upstream of it, inputs first, in the order of the ports.
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
