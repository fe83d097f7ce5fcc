//! Parameters of a node that are read when they are asked for, and the places of its fields.

use std::ops::{Deref, Range};
use std::sync::{Arc, OnceLock};

use cache::KeyWriter;

use crate::kind::context::Context;
use crate::kind::contract::{Cost, Sizes, ViewCount};
use crate::kind::fields::Fields;
use crate::kind::param_type::ParamValue;
use crate::kind::port::Wired;
use crate::kind::registry::{KindEntry, Step};
use crate::text::document::RawField;
use crate::value::artifact::{AnyArtifact, Decoder, Encoder};
use crate::value::error::NodeError;
use crate::value::note::Notes;
use crate::value::root::{FileHead, SourceFile, SourceRoot};

/// The places of fields, by name.
pub(crate) type FieldPlaces = Vec<(&'static str, Range<usize>)>;

/// Everything that a node of this kind may have a field for.
fn names(kind: &KindEntry) -> impl Iterator<Item = &'static str> {
    kind.params.iter().map(|param| param.name).chain(kind.inputs.iter().map(|port| port.name))
}

pub(crate) fn walk(step: &dyn Step, to: &mut KeyWriter) {
    step.visit(&mut |name, value| {
        // A value that is not canonical was refused when the graph was checked.
        if let Ok(Some(text)) = value.key_text() {
            to.str(name, &text);
        }
    });
}

pub(crate) fn span(to: &mut Encoder, span: &Range<usize>) {
    to.u32(span.start as u32);
    to.u32(span.end as u32);
}

/// Where the fields of a node stand in the text: read, or in a compiled graph, where only mistakes ask for them.
#[derive(Clone)]
pub(crate) enum Places {
    Read(FieldPlaces),
    Stored(Arc<Vec<u8>>, Range<usize>),
}

impl Places {
    /// The place of a field, where it is written.
    pub fn of(&self, kind: &KindEntry, field: &str) -> Option<Range<usize>> {
        let (bytes, range) = match self {
            Self::Read(places) => {
                return places.iter().find(|(name, _)| *name == field).map(|(_, place)| place.clone());
            }
            Self::Stored(bytes, range) => (bytes, range.clone()),
        };
        let wanted = names(kind).position(|name| name == field)? as u32;
        let entries = bytes.get(range)?.as_chunks::<12>().0.iter();
        let mut numbers = entries.map(|entry| entry.as_chunks::<4>().0).map(|numbers| {
            let number = |index: usize| numbers.get(index).map_or(0, |raw| u32::from_le_bytes(*raw));
            (number(0), number(1) as usize..number(2) as usize)
        });
        numbers.find(|(name, _)| *name == wanted).map(|(_, place)| place)
    }

    /// For each field the number of its name among those that the kind has, and its place.
    pub fn encode(&self, kind: &KindEntry) -> Vec<u8> {
        let mut to = Encoder::default();
        for (number, name) in names(kind).enumerate() {
            if let Some(place) = self.of(kind, name) {
                to.u32(number as u32);
                span(&mut to, &place);
            }
        }
        to.finish()
    }
}

/// The parameters of a node: read, or as text that is read when first asked for.
#[derive(Clone)]
pub(crate) struct LazyStep {
    step: OnceLock<Arc<dyn Step>>,
    stored: Option<Stored>,
}

/// Where the parameters of a node lie in a compiled graph.
#[derive(Clone)]
pub(crate) struct Stored {
    pub bytes: Arc<Vec<u8>>,
    pub kind: Arc<KindEntry>,
    pub texts: Range<usize>,
    pub key_fields: Range<usize>,
}

impl LazyStep {
    pub fn of(stored: Stored) -> Self {
        Self { step: OnceLock::new(), stored: Some(stored) }
    }

    /// Visits number and canonical text of each parameter; those that are text are not read for that.
    pub fn texts(&self, kind: &KindEntry, visit: &mut dyn FnMut(usize, &str)) {
        if let Some(stored) = &self.stored {
            return texts(&stored.bytes[stored.texts.clone()]).for_each(|(index, text)| visit(index, text));
        }
        let mut params = kind.params.iter().enumerate();
        self.visit(&mut |_, value| {
            // A value that is not canonical was refused when the graph was checked.
            if let (Some((index, _)), Ok(text)) = (params.next(), value.text()) {
                visit(index, &text);
            }
        });
    }

    /// Writes the parameters into a key.
    pub fn write_key(&self, to: &mut KeyWriter) {
        match &self.stored {
            Some(stored) => to.append(&stored.bytes[stored.key_fields.clone()]),
            None => walk(&**self, to),
        }
    }
}

impl From<Arc<dyn Step>> for LazyStep {
    fn from(step: Arc<dyn Step>) -> Self {
        Self { step: OnceLock::from(step), stored: None }
    }
}

impl Deref for LazyStep {
    type Target = dyn Step;

    fn deref(&self) -> &Self::Target {
        let stored = |stored: &Stored| stored.kind.step_of(&stored.bytes[stored.texts.clone()]);
        let read = || self.stored.as_ref().and_then(stored).unwrap_or_else(|| Arc::new(Unreadable));
        &**self.step.get_or_init(read)
    }
}

/// Number and text of each stored parameter, as far as they make sense.
fn texts(stored: &[u8]) -> impl Iterator<Item = (usize, &str)> {
    let mut from = Decoder::new(stored);
    std::iter::from_fn(move || {
        let index = from.u32().ok()? as usize;
        Some((index, str::from_utf8(from.raw().ok()?).ok()?))
    })
}

impl KindEntry {
    /// The parameters that [`Node::texts`] wrote; `None` where this kind does not read them.
    pub(crate) fn step_of(&self, stored: &[u8]) -> Option<Arc<dyn Step>> {
        let field = |(index, text)| Some(RawField::plain(self.params.get::<usize>(index)?.name, text));
        let fields = texts(stored).map(field).collect::<Option<Vec<_>>>()?;
        let mut diagnostics = Vec::new();
        let mut fields =
            Fields { fields: &fields, node_span: 0..0, kind: self.name, diagnostics: &mut diagnostics };
        (self.read)(&mut fields)
    }
}

/// Stands for parameters whose text a program of the same version does not read any more.
struct Unreadable;

impl Unreadable {
    fn error() -> NodeError {
        NodeError::new("the compiled graph in the cache cannot be read")
            .hint("another build of the same version wrote it; `lightharmony cache gc --max-size 0` empties the cache")
    }
}

impl Step for Unreadable {
    fn visit(&self, _: &mut dyn FnMut(&'static str, &dyn ParamValue)) {}
    fn check(&self) -> Result<(), NodeError> {
        Err(Self::error())
    }
    fn sources(&self, _: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Err(Self::error())
    }
    fn check_wires(&self, _: &Wired) -> Result<(), NodeError> {
        Err(Self::error())
    }
    fn views(&self, _: &SourceRoot) -> Result<ViewCount, NodeError> {
        Ok(ViewCount::Unknown)
    }
    fn work(&self, _: &Sizes) -> Result<f64, NodeError> {
        Ok(0.0)
    }
    fn estimate(&self, _: Vec<Vec<AnyArtifact>>) -> Result<Cost, NodeError> {
        Ok(Cost::default())
    }
    fn estimate_files(&self, _: &[FileHead<'_>]) -> Result<Cost, NodeError> {
        Ok(Cost::default())
    }
    fn run(&self, _: Vec<Vec<AnyArtifact>>, _: &Context) -> Result<(Vec<AnyArtifact>, Notes), NodeError> {
        Err(Self::error())
    }
}
