//! A node of a checked graph, and the wires between nodes.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use cache::KeyWriter;

use crate::kind::fields::Fields;
use crate::kind::param_type::Role;
use crate::kind::params::Params;
use crate::kind::registry::{KindEntry, Step, read_params};
use crate::kind::scene::Point;
use crate::text::document::RawField;
use crate::value::codec::{Decoder, Encoder};
use crate::value::root::{InputFile, SourceRoot};

/// The start of a wire, which is an output of another node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Wire {
    /// Index into [`Graph::nodes`](crate::Graph::nodes).
    pub node: usize,
    /// Index into the outputs of the node's kind.
    pub port: usize,
}

/// Names and byte ranges of the fields of a node.
pub(crate) type FieldPlaces = Vec<(&'static str, Range<usize>)>;

/// A checked node.
#[derive(Clone)]
pub struct Node {
    /// Name in the file, followed by axis values if the node is an instance: `trace/yaw=15.0`.
    pub id: String,
    /// Kind of the node.
    pub kind: Arc<KindEntry>,
    /// The wires of each input port, in order.
    pub inputs: Vec<Vec<Wire>>,
    /// The output path of a sink, with placeholders.
    pub sink_path: Option<String>,
    /// The axes that the node or its inputs read, each with its value, such as `("yaw", "15.0")`. They are in the
    /// order of the axes in the graph.
    pub point: Point,
    /// Byte range of the node in the text from which it was parsed. [`Graph::place`](crate::Graph) returns its
    /// current byte range.
    pub(crate) span: Range<usize>,
    pub(crate) places: FieldPlaces,
    pub(crate) step: Arc<dyn Step>,
}

/// Parses the parameters of a kind from their canonical texts, by calling `read`.
fn read<T>(
    kind: &'static str,
    values: &[(&'static str, String)],
    read: impl FnOnce(&mut Fields<'_, '_>) -> Option<T>,
) -> Option<T> {
    let fields: Vec<RawField<'_>> =
        values.iter().map(|(name, text)| RawField::plain(name, text.as_str())).collect();
    read(&mut Fields { fields: &fields, node_span: 0..0, kind, diagnostics: &mut Vec::new() })
}

impl Node {
    /// Byte range of a field in the text from which the node was parsed. The range of the whole node if `field` is
    /// `None` or the node does not set the field.
    pub(crate) fn place(&self, field: Option<&str>) -> Range<usize> {
        field.and_then(|name| self.field_place(name)).unwrap_or(self.span.clone())
    }

    /// Byte range of a field; `None` if the node does not set the field.
    pub(crate) fn field_place(&self, field: &str) -> Option<Range<usize>> {
        self.places.iter().find(|(name, _)| *name == field).map(|(_, place)| place.clone())
    }

    /// All parameters as (name, canonical text), in the order of declaration.
    pub fn values(&self) -> Vec<(&'static str, String)> {
        let mut values = Vec::with_capacity(self.kind.params.len());
        // Values that are not canonical were rejected by the check.
        self.step.visit(&mut |name, value| values.extend(value.text().ok().map(|text| (name, text))));
        values
    }

    /// The parameters of the node as a `P`; `None` if its kind has different parameters.
    pub fn params<P: Params>(&self) -> Option<P> {
        read(self.kind.name, &self.values(), read_params)
    }

    /// The node's parameters with one value replaced; `None` if its kind rejects the new value.
    pub(crate) fn with(&self, parameter: &str, text: &str) -> Option<Arc<dyn Step>> {
        let mut values = self.values();
        values.iter_mut().find(|(name, _)| *name == parameter)?.1 = text.to_owned();
        read(self.kind.name, &values, |fields| (self.kind.read)(fields)).filter(|step| step.check().is_ok())
    }

    /// The source files that the node's parameters name.
    pub(crate) fn named_files(&self, root: &SourceRoot) -> Vec<PathBuf> {
        let mut files = Vec::new();
        let is_file = |name| self.kind.params.iter().any(|p| p.name == name && p.role == Role::Input);
        self.step.visit(&mut |name, value| {
            if is_file(name) {
                files.extend(
                    value.paths().into_iter().map(|path| root.file(&InputFile(path.to_owned())).path),
                );
            }
        });
        files
    }
}

impl Node {
    /// Calls `visit` with the index and the canonical text of each parameter.
    pub(crate) fn visit_texts(&self, mut visit: impl FnMut(usize, &str)) {
        let mut params = self.kind.params.iter().enumerate();
        self.step.visit(&mut |_, value| {
            // Values that are not canonical were rejected by the check.
            if let (Some((index, _)), Ok(text)) = (params.next(), value.text()) {
                visit(index, &text);
            }
        });
    }

    /// The index and canonical text of each parameter, encoded for [`KindEntry::step_of`].
    pub(crate) fn texts(&self) -> Vec<u8> {
        let mut to = Encoder::default();
        self.visit_texts(|index, text| {
            to.u32(index as u32);
            to.str(text);
        });
        to.finish()
    }

    /// Writes the parameters into a key.
    pub(crate) fn write_key(&self, to: &mut KeyWriter) {
        self.step.visit(&mut |name, value| {
            // Values that are not canonical were rejected by the check.
            if let Ok(Some(text)) = value.key_text() {
                to.str(name, &text);
            }
        });
    }
}

/// A node that belongs to no graph, with these parameters as (name, text) and these wires.
///
/// # Errors
/// The first mistake in the parameters.
pub(crate) fn node_of_parameters(
    kind: Arc<KindEntry>,
    parameters: &[(String, String)],
    inputs: Vec<Vec<Wire>>,
) -> Result<Node, String> {
    let names = || kind.params.iter().map(|param| param.name);
    if let Some((name, _)) = parameters.iter().find(|(name, _)| !names().any(|known| known == name)) {
        return Err(format!("`{}` has no parameter `{name}`", kind.name));
    }
    if let Some(name) = names().find(|known| !parameters.iter().any(|(name, _)| name == known)) {
        return Err(format!("the parameter `{name}` of `{}` is missing", kind.name));
    }
    let fields: Vec<RawField<'_>> =
        parameters.iter().map(|(name, text)| RawField::plain(name, text.as_str())).collect();
    let mut diagnostics = Vec::new();
    let mut fields =
        Fields { fields: &fields, node_span: 0..0, kind: kind.name, diagnostics: &mut diagnostics };
    let step = (kind.read)(&mut fields);
    let mistake = || diagnostics.first().map_or_else(String::new, |mistake| mistake.message.clone());
    let step = step.ok_or_else(mistake)?;
    step.check().map_err(|error| error.to_string())?;
    let (id, point, places) = (kind.name.to_owned(), Point::new(), FieldPlaces::new());
    Ok(Node { id, kind, inputs, sink_path: None, point, span: 0..0, places, step })
}

impl KindEntry {
    /// Reads parameters from the output of [`Node::texts`]; `None` if this kind rejects them.
    pub(crate) fn step_of(&self, texts: &[u8]) -> Option<Arc<dyn Step>> {
        let mut from = Decoder::new(texts);
        let mut fields = Vec::new();
        while from.left() > 0 {
            let index = from.u32().ok()? as usize;
            let text = str::from_utf8(from.raw().ok()?).ok()?;
            fields.push(RawField::plain(self.params.get(index)?.name, text));
        }
        let mut diagnostics = Vec::new();
        let mut fields =
            Fields { fields: &fields, node_span: 0..0, kind: self.name, diagnostics: &mut diagnostics };
        (self.read)(&mut fields)
    }
}
