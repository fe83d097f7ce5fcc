//! The state of the check of one graph: what is known so far, and the mistakes.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use crate::graph::axis::{Axis, at_point};
use crate::graph::node::Node;
use crate::kind::registry::Registry;
use crate::text::diag::Diagnostic;
use crate::text::document::{Document, RawNode, Scope};
use crate::text::source::{Piece, Source};
use crate::value::root::SourceRoot;

/// The check of one graph.
pub(crate) struct Check<'t, 'a> {
    pub text: &'t str,
    pub pieces: Vec<Piece<'t>>,
    pub registry: &'a Registry,
    pub root: &'a SourceRoot,
    pub diagnostics: &'a mut Vec<Diagnostic>,
    pub scopes: &'a [Scope<'t>],
    pub ids: HashMap<&'a str, usize>,
    pub names: Vec<&'a str>,
    pub broken: HashSet<&'a str>,
    /// The files that nodes name.
    pub files: Vec<PathBuf>,
    /// What the graph runs along.
    pub axes: Arc<[Axis<'t>]>,
    pub gathers: HashMap<usize, Gather>,
    /// Wires to nodes that do not exist, so far.
    pub strangers: usize,
}

impl<'t, 'a> Check<'t, 'a> {
    /// Mistakes go to `diagnostics`.
    pub fn new(
        source: &'t Source,
        registry: &'a Registry,
        root: &'a SourceRoot,
        document: &'a Document<'t>,
        diagnostics: &'a mut Vec<Diagnostic>,
    ) -> Self {
        Self {
            text: &source.text,
            pieces: source.pieces(),
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
            strangers: 0,
        }
    }

    pub fn report(&mut self, diagnostic: Diagnostic) {
        self.diagnostics.push(diagnostic);
    }

    /// How many mistakes were found.
    pub fn mistakes(&self) -> usize {
        self.diagnostics.len()
    }

    /// Whether a node of the file may be several, or none.
    pub fn is_multiple(&self) -> bool {
        !self.axes.is_empty() || !self.gathers.is_empty()
    }
}

/// A field with values in place of the parameters that it reads.
#[derive(Clone)]
pub(crate) struct Field<'t> {
    pub name: &'t str,
    pub text: Cow<'t, str>,
    /// Where it stands, or the value that is all of it.
    pub span: Range<usize>,
}

/// The fields of a node where each axis has the value that `at` gives.
pub(crate) fn at_each<'f>(
    fields: &'f [Field<'_>],
    axes: &[Axis<'_>],
    at: impl Fn(usize) -> usize,
) -> Vec<Field<'f>> {
    let here = |field: &'f Field<'_>| {
        let text = at_point(&field.text, axes, &at);
        Field { name: field.name, text, span: field.span.clone() }
    };
    fields.iter().map(here).collect()
}

/// A node as written, read at the first value of each axis.
pub(crate) struct Template<'r, 't> {
    /// Its wires lead to templates, by the index of their node in the file.
    pub node: Node,
    pub raw: &'r RawNode<'t>,
    /// Its parameters as they are read.
    pub fields: Vec<Field<'t>>,
    /// The axes that its own fields read.
    pub own: Vec<usize>,
    /// The axes that a wire gathers, by its port and its place there.
    pub gathers: BTreeMap<(usize, usize), Vec<usize>>,
}

/// `Gather(input: "node.port", over: "axis")`, whose wires are those to every instance of the node.
pub(crate) struct Gather {
    /// Whose output, by the index of the node in the file.
    pub node: usize,
    pub output: Option<String>,
    /// Along which axes, the last running fastest.
    pub over: Vec<usize>,
}

/// The kind that is none.
pub(crate) const GATHER: &str = "Gather";
