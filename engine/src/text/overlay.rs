//! Overlays: values that override fields of nodes in the graph file.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::ops::Range;

use crate::text::diag::{Code, Diagnostic, nearest, shown};
use crate::text::document::{Document, RawField, RawNode, RawScene};
use crate::text::syntax::twice;

/// The overlays of each node, by the name of the node. Later overlays override earlier overlays.
#[derive(Debug, Default)]
pub(crate) struct Overlays<'t> {
    nodes: BTreeMap<Cow<'t, str>, Vec<RawNode<'t>>>,
    /// Names and byte ranges of the axes that are defined only in overlays.
    axes: Vec<(&'t str, Range<usize>)>,
}

impl<'t> Overlays<'t> {
    /// Adds an overlay, which overrides the overlays added before.
    pub fn push(&mut self, overlay: Document<'t>, diagnostics: &mut Vec<Diagnostic>) {
        let mut seen = BTreeMap::new();
        for node in overlay.nodes {
            if let Some(first) = seen.insert(node.id.clone(), node.id_span.clone()) {
                diagnostics.push(twice(&node.id, node.id_span.clone(), first));
            }
            self.nodes.entry(node.id.clone()).or_default().push(node);
        }
    }

    /// Applies the overlays of `scene`, `axes` and `parameters`.
    pub fn lay_on_blocks(&mut self, document: &mut Document<'t>, diagnostics: &mut Vec<Diagnostic>) {
        let known: Vec<&str> = document.parameters.iter().map(|parameter| parameter.name).collect();
        for name in ["scene", "axes", "parameters"] {
            let own = document.nodes.iter().find(|node| node.id == name).map(|node| &node.fields);
            // A node may also be named `scene`. Fields that the node does not have belong to the block.
            let is_nodes = |over: &RawNode<'t>| {
                own.is_some_and(|own| {
                    over.fields.iter().all(|field| own.iter().any(|o| o.name == field.name))
                })
            };
            let (nodes, block): (Vec<_>, Vec<_>) =
                self.nodes.remove(name).unwrap_or_default().into_iter().partition(is_nodes);
            if name == "parameters" {
                let unknown = block.iter().flat_map(|over| &over.fields);
                diagnostics.extend(unknown.filter(|field| !known.contains(&field.name)).map(|field| {
                    let what = format!("the graph has no parameter `{}`", shown(field.name));
                    Diagnostic::of(Code::UnknownField, field.name_span.clone(), what)
                        .suggest(field.name, known.iter().copied())
                }));
            }
            if name == "axes" {
                let own: Vec<&str> = document.axes.iter().map(|axis| axis.name).collect();
                let added =
                    block.iter().flat_map(|over| &over.fields).filter(|axis| !own.contains(&axis.name));
                self.axes.extend(added.map(|axis| (axis.name, axis.name_span.clone())));
            }
            if name == "scene" && document.scene.is_none() {
                let span = block.first().map(|over| over.span.clone());
                document.scene = span.map(|span| RawScene { span, fields: Vec::new() });
            }
            let fields = match name {
                "axes" => Some(&mut document.axes),
                "parameters" => Some(&mut document.parameters),
                _ => document.scene.as_mut().map(|scene: &mut RawScene<'t>| &mut scene.fields),
            };
            match fields {
                Some(fields) => block.into_iter().for_each(|over| lay(fields, over.fields)),
                None => drop(self.nodes.insert(name.into(), block)),
            }
            if !nodes.is_empty() {
                self.nodes.insert(name.into(), nodes);
            }
        }
    }

    /// Applies the overlays of a node.
    pub fn lay_on(&mut self, node: &mut RawNode<'t>) {
        if !self.nodes.is_empty()
            && let Some(over) = self.nodes.remove(&node.id)
        {
            over.into_iter().for_each(|over| lay(&mut node.fields, over.fields));
        }
    }

    /// Reports overlays of nodes that do not exist. Also reports axes that are defined only in an overlay and are
    /// not read by any node.
    pub fn report_unused(self, document: &Document<'t>, diagnostics: &mut Vec<Diagnostic>) {
        let given = || document.scopes.iter().flat_map(|scope| &scope.values);
        let fields = || document.nodes.iter().flat_map(|node| &node.fields).chain(given());
        for (axis, span) in self.axes {
            let quoted = format!("\"{axis}\"");
            if !fields().any(|field| field.text.contains(&quoted)) {
                let what = format!(
                    "the graph does not declare an axis `{}`, and no node uses an axis of that name",
                    shown(axis)
                );
                let others = document.axes.iter().map(|known| known.name).filter(|known| *known != axis);
                diagnostics.push(Diagnostic::of(Code::UnknownField, span, what).suggest(axis, others));
            }
        }
        for node in self.nodes.into_values().flatten() {
            let what = format!("no node is named `{}`", shown(&node.id));
            let mistake = Diagnostic::of(Code::UnknownNode, node.id_span, what);
            let near = nearest(&node.id, document.nodes.iter().map(|known| &*known.id));
            let known = |id: &str| document.nodes.iter().any(|known| known.id == id);
            diagnostics.push(match (near, node.id.split_once('.')) {
                (Some(near), _) => mistake.hint(format!("did you mean `{near}`?")),
                (None, Some((id, rest))) if known(id) => {
                    let parameter = rest.split('.').next().unwrap_or(rest);
                    mistake.hint(format!("set the whole parameter: `{id}.{parameter}=..`"))
                }
                (None, _) => mistake,
            });
        }
    }
}

fn lay<'t>(fields: &mut Vec<RawField<'t>>, over: Vec<RawField<'t>>) {
    for field in over {
        match fields.iter_mut().find(|known| known.name == field.name) {
            Some(known) => *known = field,
            None => fields.push(field),
        }
    }
}

/// Built-in presets, from the least work to the smallest error. A preset of the same name in the graph replaces the
/// built-in one.
pub const PRESETS: [&str; 4] = ["draft", "preview", "final", "reference"];

/// The text of an overlay that sets fields, each given as node, parameter and value in RON. Nodes are in order of
/// first appearance.
pub fn overlay_text<'s>(fields: impl IntoIterator<Item = (&'s str, &'s str, &'s str)>) -> String {
    let mut nodes: Vec<(&str, String)> = Vec::new();
    for (node, parameter, value) in fields {
        let field = format!("{parameter}: {value}");
        match nodes.iter_mut().find(|(name, _)| *name == node) {
            Some((_, fields)) => {
                // Writing to a string cannot fail.
                let _ = write!(fields, ", {field}");
            }
            None => nodes.push((node, field)),
        }
    }
    let lines: String = nodes.iter().map(|(node, fields)| format!("        {node}: ({fields}),\n")).collect();
    format!("Overlay(\n    nodes: (\n{lines}    ),\n)\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_overlay_names_each_node_once() {
        let text = overlay_text([("a", "x", "1"), ("b", "y", "2"), ("a", "z", "Hard")]);
        let plain: String = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(plain, "Overlay( nodes: ( a: (x: 1, z: Hard), b: (y: 2), ), )");
    }
}
