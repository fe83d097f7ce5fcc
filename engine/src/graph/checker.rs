//! State of the check of one graph.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use crate::graph::axis::{Axis, at_point};
use crate::graph::axis_names::{file_text, is_held, with_value};
use crate::graph::node::Node;
use crate::kind::registry::Registry;
use crate::text::diag::Diagnostic;
use crate::text::document::{Document, RawNode, Scope};
use crate::text::source::Source;
use crate::value::root::SourceRoot;

/// The check of a graph: the facts known so far, and the mistakes found.
pub(crate) struct Check<'t, 'a> {
    pub text: &'t str,
    pub source: &'t Source,
    pub registry: &'a Registry,
    pub root: &'a SourceRoot,
    pub diagnostics: &'a mut Vec<Diagnostic>,
    pub scopes: &'a [Scope<'t>],
    pub ids: HashMap<&'a str, usize>,
    pub names: Vec<&'a str>,
    pub broken: HashSet<&'a str>,
    /// The source files that nodes name.
    pub files: Vec<PathBuf>,
    /// The axes of the graph.
    pub axes: Arc<[Axis<'t>]>,
    pub gathers: HashMap<usize, Gather>,
    /// Number of wires, among those checked so far, that refer to nodes that do not exist.
    pub missing_nodes: usize,
}

impl<'t, 'a> Check<'t, 'a> {
    /// Creates a check that adds mistakes to `diagnostics`.
    pub fn new(
        source: &'t Source,
        registry: &'a Registry,
        root: &'a SourceRoot,
        document: &'a Document<'t>,
        diagnostics: &'a mut Vec<Diagnostic>,
    ) -> Self {
        Self {
            text: &source.text,
            source,
            registry,
            root,
            diagnostics,
            scopes: &document.scopes,
            ids: HashMap::with_capacity(document.nodes.len()),
            names: document.nodes.iter().map(|node| &*node.id).collect(),
            broken: document.broken.iter().map(|name| &**name).collect(),
            files: Vec::new(),
            axes: Arc::new([]),
            gathers: HashMap::new(),
            missing_nodes: 0,
        }
    }

    pub fn report(&mut self, diagnostic: Diagnostic) {
        self.diagnostics.push(diagnostic);
    }

    /// Number of mistakes found so far.
    pub fn mistakes(&self) -> usize {
        self.diagnostics.len()
    }

    /// True if the graph has axes or gathers, so that the expanded graph may have more or fewer nodes than the
    /// file.
    pub fn is_multiple(&self) -> bool {
        !self.axes.is_empty() || !self.gathers.is_empty()
    }
}

/// A field with each `Param` call replaced by its value.
#[derive(Clone)]
pub(crate) struct Field<'t> {
    pub name: &'t str,
    pub text: Cow<'t, str>,
    /// Byte range of the field or, if the field is a single `Param` call, of the value of the parameter.
    pub span: Range<usize>,
    /// True if the field names files to read, whose paths may contain placeholders such as `{frame}`.
    pub is_path: bool,
}

/// Replaces the axis calls and the placeholders in the fields of a node with the values at a point. `at` maps the index of an axis to
/// the index of the value that this axis has at the point.
pub(crate) fn at_each<'f>(
    fields: &'f [Field<'_>],
    axes: &[Axis<'_>],
    at: impl Fn(usize) -> usize,
) -> Vec<Field<'f>> {
    let here = |field: &'f Field<'_>| {
        let mut text = at_point(&field.text, axes, &at);
        for (index, axis) in axes.iter().enumerate().filter(|_| field.is_path) {
            if is_held(&text, axis.name) {
                let value = |width| file_text(&axis.values[at(index)], axis.padding, width);
                text = Cow::Owned(with_value(&text, axis.name, value));
            }
        }
        Field { name: field.name, text, span: field.span.clone(), is_path: field.is_path }
    };
    fields.iter().map(here).collect()
}

/// A node of the file before its expansion along axes. Its parameters are read at the first value of each axis.
pub(crate) struct Template<'r, 't> {
    /// The node. Its wires refer to templates by index.
    pub node: Node,
    pub raw: &'r RawNode<'t>,
    /// Fields of the node, in which axis calls are not yet replaced by values.
    pub fields: Vec<Field<'t>>,
    /// Indices of the axes that the node's own fields read.
    pub own: Vec<usize>,
    /// For each wire to a `Gather`, the indices of the axes that it gathers. The key is the index of the input port
    /// and the position of the wire in the port.
    pub gathers: BTreeMap<(usize, usize), Vec<usize>>,
}

/// `Gather(input: "node.port", over: "axis")`: wires to all instances of a node.
pub(crate) struct Gather {
    /// Index of the gathered node among the nodes of the file.
    pub node: usize,
    pub output: Option<String>,
    /// Indices of the gathered axes. In the order of the wires, the last axis varies fastest.
    pub over: Vec<usize>,
}

/// Name of the pseudo-kind `Gather`.
pub(crate) const GATHER: &str = "Gather";
