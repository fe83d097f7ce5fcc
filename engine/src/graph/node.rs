//! A node of a checked graph, and the wires between nodes.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use crate::graph::lazy::{LazyStep, Places};
use crate::kind::context::Point;
use crate::kind::fields::Fields;
use crate::kind::param_type::Role;
use crate::kind::params::Params;
use crate::kind::registry::{KindEntry, Step};
use crate::text::document::RawField;
use crate::value::artifact::Encoder;
use crate::value::root::{InputFile, SourceRoot};

/// One end of a wire: an output of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Wire {
    /// Index into [`Graph::nodes`](crate::Graph::nodes).
    pub node: usize,
    /// Index into the outputs of its kind.
    pub port: usize,
}

/// A node whose every field is right.
#[derive(Clone)]
pub struct Node {
    /// Name in the file; with axes the name of the instance: `trace/yaw=15.0`.
    pub id: String,
    /// What it does.
    pub kind: Arc<KindEntry>,
    /// For each input port of the kind, its wires in order.
    pub inputs: Vec<Vec<Wire>>,
    /// The path a sink writes to, with its placeholders.
    pub sink_path: Option<String>,
    /// The value of each axis that it or its inputs read, in the order of the axes: `("yaw", "15.0")`.
    pub point: Point,
    /// Where it stood in the text that it was read from; [`Graph::place`] knows where it is now.
    pub(crate) span: Range<usize>,
    pub(crate) places: Places,
    pub(crate) step: LazyStep,
}

/// Reads parameters of a kind from their canonical texts.
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
    /// Where a field stood in the text that the node was read from, or the whole node.
    pub(crate) fn place(&self, field: Option<&str>) -> Range<usize> {
        field.and_then(|name| self.places.of(&self.kind, name)).unwrap_or(self.span.clone())
    }

    /// Every parameter with its value in canonical text.
    pub(crate) fn values(&self) -> Vec<(&'static str, String)> {
        let mut values = Vec::with_capacity(self.kind.params.len());
        // A value that is not canonical was refused when the graph was checked.
        self.step.visit(&mut |name, value| values.extend(value.text().ok().map(|text| (name, text))));
        values
    }

    /// The parameters of a node whose kind has these; `None` where it has others.
    pub fn params<P: Params>(&self) -> Option<P> {
        read(self.kind.name, &self.values(), P::read)
    }

    /// What the node does with another value of one parameter; `None` where its kind refuses that.
    pub(crate) fn with(&self, parameter: &str, text: &str) -> Option<Arc<dyn Step>> {
        let mut values = self.values();
        values.iter_mut().find(|(name, _)| *name == parameter)?.1 = text.to_owned();
        read(self.kind.name, &values, |fields| (self.kind.read)(fields)).filter(|step| step.check().is_ok())
    }

    /// The files that its parameters name.
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
    /// Number and canonical text of each parameter, for [`KindEntry::step_of`].
    pub(crate) fn texts(&self) -> Vec<u8> {
        let mut to = Encoder::default();
        self.step.texts(&self.kind, &mut |index, text| {
            to.u32(index as u32);
            to.str(text);
        });
        to.finish()
    }
}
