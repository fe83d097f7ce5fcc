//! Overlays: values that override fields of nodes in the graph file.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::ops::Range;

use crate::text::diag::{Code, Diagnostic, nearest, shown};
use crate::text::document::{Document, RawField, RawNode, RawScene, SCENE_FIELDS};
use crate::text::syntax::twice;

/// Blocks of a graph that overlays can change.
const BLOCKS: [&str; 3] = ["scene", "axes", "parameters"];

/// The part of a graph that an overlay changes.
enum Target<'t> {
    Block(&'static str),
    Node(Cow<'t, str>),
    /// The block or the node of this name, which are distinguished by their fields.
    Either(&'static str),
}

/// The overlays of a graph. Later overlays override earlier overlays.
#[derive(Debug, Default)]
pub(crate) struct Overlays<'t> {
    /// The overlays in order, and whether each is a block outside `nodes`.
    given: Vec<(bool, RawNode<'t>)>,
    /// The overlays of each node, by the name of the node.
    nodes: BTreeMap<Cow<'t, str>, Vec<RawNode<'t>>>,
    /// Names and byte ranges of the axes that are defined only in overlays.
    axes: Vec<(&'t str, Range<usize>)>,
}

impl<'t> Overlays<'t> {
    /// Adds an overlay, which overrides the overlays added before.
    pub fn push(&mut self, overlay: Document<'t>, diagnostics: &mut Vec<Diagnostic>) {
        let mut seen = BTreeMap::new();
        for node in &overlay.nodes {
            if let Some(first) = seen.insert(node.id.clone(), node.id_span.clone()) {
                diagnostics.push(twice(&node.id, node.id_span.clone(), first));
            }
        }
        self.given.extend(overlay.blocks.into_iter().map(|block| (true, block)));
        self.given.extend(overlay.nodes.into_iter().map(|node| (false, node)));
    }

    /// Applies the overlays of `scene`, `axes` and `parameters`, and sorts the others by node. If a node has the
    /// name of a block, the fields decide which of them is meant: `nodes.scene` always means the node, and
    /// `graph.scene` the block.
    pub fn lay_on_blocks(&mut self, document: &mut Document<'t>, diagnostics: &mut Vec<Diagnostic>) {
        let has = |name: &str| document.nodes.iter().any(|node| node.id == name);
        let named = ["graph", "nodes"].map(has);
        let mut blocks: BTreeMap<&'static str, Vec<RawNode<'t>>> = BTreeMap::new();
        for (outside, over) in std::mem::take(&mut self.given) {
            match target(&over.id, outside, named) {
                Target::Block(name) => blocks.entry(name).or_default().push(over),
                Target::Node(id) => self.nodes.entry(id.clone()).or_default().push(RawNode { id, ..over }),
                Target::Either(name) => {
                    let [block, node] = divided(name, over, document, diagnostics);
                    blocks.entry(name).or_default().extend(block);
                    if let Some(node) = node {
                        self.nodes.entry(name.into()).or_default().push(node);
                    }
                }
            }
        }
        for name in BLOCKS {
            if let Some(block) = blocks.remove(name) {
                self.lay_on_block(name, block, document, diagnostics);
            }
        }
    }

    fn lay_on_block(
        &mut self,
        name: &'static str,
        block: Vec<RawNode<'t>>,
        document: &mut Document<'t>,
        diagnostics: &mut Vec<Diagnostic>,
    ) {
        if name == "parameters" {
            let known: Vec<&str> = document.parameters.iter().map(|parameter| parameter.name).collect();
            let unknown = block.iter().flat_map(|over| &over.fields);
            diagnostics.extend(unknown.filter(|field| !known.contains(&field.name)).map(|field| {
                let what = format!("the graph has no parameter `{}`", shown(field.name));
                Diagnostic::of(Code::UnknownField, field.name_span.clone(), what)
                    .suggest(field.name, known.iter().copied())
            }));
        }
        if name == "axes" {
            let own: Vec<&str> = document.axes.iter().map(|axis| axis.name).collect();
            let added = block.iter().flat_map(|over| &over.fields).filter(|axis| !own.contains(&axis.name));
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
        if let Some(fields) = fields {
            block.into_iter().for_each(|over| lay(fields, over.fields));
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

/// The part of the graph that an overlay of the name `id` changes. `outside` is true for a block outside `nodes`.
/// `named` states whether the graph has nodes named `graph` and `nodes`, whose names precede a dot in the names of
/// their inner nodes.
fn target<'t>(id: &Cow<'t, str>, outside: bool, [graph, nodes]: [bool; 2]) -> Target<'t> {
    let block = |name: &str| BLOCKS.into_iter().find(|block| *block == name);
    match (id.split_once('.'), block(id)) {
        (_, Some(name)) if outside => Target::Block(name),
        (_, Some(name)) => Target::Either(name),
        (Some(("graph", rest)), _) if !graph && let Some(name) = block(rest) => Target::Block(name),
        (Some(("nodes", rest)), _) if !nodes => Target::Node(rest.to_owned().into()),
        _ => Target::Node(id.clone()),
    }
}

/// Divides an overlay of the name `name` between the block and the node of this name. Each field belongs to the one
/// that has it, and to the block if there is no such node. A field that both may have is recorded in
/// [`Document::contested`].
fn divided<'t>(
    name: &'static str,
    over: RawNode<'t>,
    document: &mut Document<'t>,
    diagnostics: &mut Vec<Diagnostic>,
) -> [Option<RawNode<'t>>; 2] {
    let Some(node) = document.nodes.iter().find(|node| node.id == name) else { return [Some(over), None] };
    let in_block = |field: &str| match name {
        "scene" => SCENE_FIELDS.contains(&field),
        "axes" => document.axes.iter().any(|axis| axis.name == field),
        _ => document.parameters.iter().any(|parameter| parameter.name == field),
    };
    let (mut of_block, mut of_node) = (Vec::new(), Vec::new());
    for field in over.fields {
        if !in_block(field.name) {
            of_node.push(field);
        } else if node.fields.iter().any(|own| own.name == field.name) {
            diagnostics.push(ambiguous(name, &field));
        } else {
            document.contested.push((name, field.clone()));
            of_block.push(field);
        }
    }
    let part = |fields: Vec<RawField<'t>>| {
        let (id, kind) = (over.id.clone(), over.kind);
        let (id_span, kind_span, span) = (over.id_span.clone(), over.kind_span.clone(), over.span.clone());
        (!fields.is_empty()).then_some(RawNode {
            id,
            id_span,
            kind,
            kind_span,
            span,
            fields,
            scope: over.scope,
        })
    };
    [part(of_block), part(of_node)]
}

/// The mistake of an overlay that sets a field by a name that a block and a node share, if both have the field.
pub(crate) fn ambiguous(name: &str, field: &RawField<'_>) -> Diagnostic {
    let field_name = shown(field.name);
    let what = format!("the block `{name}` and the node `{name}` both have a field `{field_name}`");
    Diagnostic::of(Code::UnknownField, field.name_span.clone(), what).label("ambiguous").hint(format!(
        "write `nodes.{name}.{field_name}` for the field of the node, or `graph.{name}.{field_name}` for the field of the block; in an overlay, `nodes.{name}: ({field_name}: ..)` or `graph.{name}: ({field_name}: ..)`"
    ))
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
