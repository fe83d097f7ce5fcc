//! A graph file by its structure: nodes and fields with their places, their values unread.

use std::borrow::Cow;
use std::ops::Range;

/// `name: text`, as it stands in the file.
#[derive(Debug, Clone)]
pub(crate) struct RawField<'t> {
    pub name: &'t str,
    pub name_span: Range<usize>,
    pub text: &'t str,
    pub span: Range<usize>,
    /// Where the names in the text are looked for, by its place in [`Document::scopes`].
    pub scope: usize,
}

impl<'t> RawField<'t> {
    /// A value that stands in no file.
    pub fn plain(name: &'t str, text: &'t str) -> Self {
        Self { name, name_span: 0..0, text, span: 0..0, scope: 0 }
    }
}

/// `id: Kind(fields)`.
#[derive(Debug, Clone)]
pub(crate) struct RawNode<'t> {
    /// Its name in the whole graph: in a subgraph behind the names of those around it.
    pub id: Cow<'t, str>,
    pub id_span: Range<usize>,
    pub kind: &'t str,
    pub kind_span: Range<usize>,
    /// The kind and the fields.
    pub span: Range<usize>,
    pub fields: Vec<RawField<'t>>,
    /// The subgraph it is a node of, by its place in [`Document::scopes`].
    pub scope: usize,
}

/// The `scene` block.
#[derive(Debug, Clone)]
pub(crate) struct RawScene<'t> {
    pub span: Range<usize>,
    pub fields: Vec<RawField<'t>>,
}

/// A whole graph file, unchecked.
#[derive(Debug, Default, Clone)]
pub(crate) struct Document<'t> {
    pub version: Option<RawField<'t>>,
    pub scene: Option<RawScene<'t>>,
    /// The versions and scenes that the other files of the graph state; they have none but must be right.
    pub others: Vec<(Option<RawField<'t>>, Option<RawScene<'t>>)>,
    /// What stands in `axes`.
    pub axes: Vec<RawField<'t>>,
    /// What its fields read by `Param("name")`, with the values where nothing else is given.
    pub parameters: Vec<RawField<'t>>,
    /// The files whose nodes are part of the graph.
    pub include: Option<RawField<'t>>,
    /// Named overlays, unread.
    pub presets: Vec<RawField<'t>>,
    pub nodes: Vec<RawNode<'t>>,
    /// Where names are looked for: the graph itself, then each use of a subgraph.
    pub scopes: Vec<Scope<'t>>,
    /// Names of nodes whose text could not be read, so that wires to them are no second mistake.
    pub broken: Vec<Cow<'t, str>>,
    /// False where something may be missing only because it could not be read.
    pub whole: bool,
}

/// Where names are looked for: the graph, or one use of a subgraph.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scope<'t> {
    /// In front of the name of each node: empty, or with a `.` at its end.
    pub prefix: String,
    /// The file that it is used from, as it is known; empty for the graph itself.
    pub file: &'t str,
    /// What is given, or else the file's own values.
    pub values: Vec<RawField<'t>>,
    /// Where it is used, and in which scope.
    pub used: Option<(Range<usize>, usize)>,
    pub depth: usize,
}
