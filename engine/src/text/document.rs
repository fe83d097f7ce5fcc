//! The structure of a graph file: nodes and fields with their byte ranges. Values are still text.

use std::borrow::Cow;
use std::ops::Range;

/// A field `name: text`.
#[derive(Debug, Clone)]
pub(crate) struct RawField<'t> {
    pub name: &'t str,
    pub name_span: Range<usize>,
    pub text: &'t str,
    pub span: Range<usize>,
    /// The scope in which names in the text are resolved: an index into [`Document::scopes`].
    pub scope: usize,
}

impl<'t> RawField<'t> {
    /// Creates a field that does not come from a file.
    pub fn plain(name: &'t str, text: &'t str) -> Self {
        Self { name, name_span: 0..0, text, span: 0..0, scope: 0 }
    }
}

/// A node `id: Kind(fields)`.
#[derive(Debug, Clone)]
pub(crate) struct RawNode<'t> {
    /// Name in the whole graph. For a node in a subgraph, it begins with the names of the surrounding nodes.
    pub id: Cow<'t, str>,
    pub id_span: Range<usize>,
    pub kind: &'t str,
    pub kind_span: Range<usize>,
    /// Byte range of the kind and the fields.
    pub span: Range<usize>,
    pub fields: Vec<RawField<'t>>,
    /// The subgraph that contains the node: an index into [`Document::scopes`].
    pub scope: usize,
}

/// The fields of the `scene` block.
pub(crate) const SCENE_FIELDS: [&str; 4] = ["up", "metres_per_unit", "seed", "exhaustive"];

/// The `scene` block.
#[derive(Debug, Clone)]
pub(crate) struct RawScene<'t> {
    pub span: Range<usize>,
    pub fields: Vec<RawField<'t>>,
}

/// A graph file before it is checked.
#[derive(Debug, Default, Clone)]
pub(crate) struct Document<'t> {
    pub version: Option<RawField<'t>>,
    pub scene: Option<RawScene<'t>>,
    /// The version and the scene of each included file and each file used as a subgraph. They are checked but not
    /// used.
    pub others: Vec<(Option<RawField<'t>>, Option<RawScene<'t>>)>,
    /// The fields of `axes`.
    pub axes: Vec<RawField<'t>>,
    /// Parameters that fields read with `Param("name")`, with their default values.
    pub parameters: Vec<RawField<'t>>,
    /// Included files.
    pub include: Option<RawField<'t>>,
    /// Presets: named overlays. Their values are not parsed yet.
    pub presets: Vec<RawField<'t>>,
    pub nodes: Vec<RawNode<'t>>,
    /// Blocks of an overlay: `scene`, `axes` and `parameters` outside `nodes`. Their form is that of nodes.
    pub blocks: Vec<RawNode<'t>>,
    /// Fields that an overlay sets in `scene`, `axes` or `parameters` although a node has the same name as this
    /// block, as pairs of block name and field. If the node has a field of that name too, the overlay is ambiguous,
    /// which is reported as a mistake.
    pub contested: Vec<(&'static str, RawField<'t>)>,
    /// Scopes in which names are resolved: the graph itself, then each use of a subgraph.
    pub scopes: Vec<Scope<'t>>,
    /// Names of nodes that could not be parsed, so that wires to them are not reported as well.
    pub broken: Vec<Cow<'t, str>>,
    /// False if some definitions could not be parsed, so that a name may only seem to be missing.
    pub whole: bool,
}

/// A scope in which names are resolved: the graph, or one use of a subgraph.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scope<'t> {
    /// Prefix of all node names: empty, or ending with a `.`.
    pub prefix: String,
    /// Name of the file of the subgraph; empty for the graph itself.
    pub file: &'t str,
    /// Values of the parameters: the values that the use gives, and defaults for the others.
    pub values: Vec<RawField<'t>>,
    /// Byte range and scope of the node that uses the subgraph; `None` for the graph itself.
    pub used: Option<(Range<usize>, usize)>,
    pub depth: usize,
}
