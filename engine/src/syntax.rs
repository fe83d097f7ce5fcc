//! From RON text to nodes and fields, each with its place in the text.
//!
//! ron parses; every value is kept as the raw slice it stands in, whose address gives its span. The
//! engine so needs no knowledge of kinds here, sees duplicates, and can report all mistakes together.

use std::fmt;
use std::ops::Range;

use ron::extensions::Extensions;
use ron::value::RawValue;
use serde::Deserializer;
use serde::de::{MapAccess, Visitor};

use crate::diag::Diagnostic;
use crate::param::ParamType;

/// `name: text`, as it stands in the file.
#[derive(Debug, Clone)]
pub(crate) struct RawField<'t> {
    pub name: &'t str,
    pub name_span: Range<usize>,
    pub text: &'t str,
    pub span: Range<usize>,
}

/// `id: Kind(fields)`.
#[derive(Debug)]
pub(crate) struct RawNode<'t> {
    pub id: &'t str,
    pub id_span: Range<usize>,
    pub kind: &'t str,
    pub kind_span: Range<usize>,
    pub span: Range<usize>,
    pub fields: Vec<RawField<'t>>,
}

/// A whole graph file, unchecked.
#[derive(Debug, Default)]
pub(crate) struct Document<'t> {
    pub version: Option<RawField<'t>>,
    pub scene: Option<(Range<usize>, Vec<RawField<'t>>)>,
    pub nodes: Vec<RawNode<'t>>,
    /// Names of nodes whose text could not be read, so that wires to them are no second mistake.
    pub broken: Vec<&'t str>,
}

fn options() -> ron::Options {
    ron::Options::default().with_default_extension(Extensions::IMPLICIT_SOME)
}

/// Parses the structure. Text that is no RON at all gives one diagnostic, else every misplaced field
/// gives one of its own.
pub(crate) fn parse<'t>(text: &'t str, diagnostics: &mut Vec<Diagnostic>) -> Document<'t> {
    let mut document = Document::default();
    let Some(top) = pairs(text, text, diagnostics) else { return document };
    for field in top {
        match field.name {
            "version" => document.version = Some(field),
            "scene" => {
                document.scene =
                    pairs(text, field.text, diagnostics).map(|fields| (field.span.clone(), fields));
            }
            "nodes" => {
                for node in pairs(text, field.text, diagnostics).unwrap_or_default() {
                    let id = node.name;
                    match parse_node(text, node, diagnostics) {
                        Some(node) => document.nodes.push(node),
                        None => document.broken.push(id),
                    }
                }
            }
            other => {
                let known = ["version", "scene", "nodes"];
                diagnostics.push(
                    Diagnostic::new(field.name_span, format!("a graph has no field `{other}`"))
                        .suggest(other, known)
                        .hint("a graph has the fields `version`, `scene` and `nodes`"),
                );
            }
        }
    }
    document
}

fn parse_node<'t>(
    text: &'t str,
    node: RawField<'t>,
    diagnostics: &mut Vec<Diagnostic>,
) -> Option<RawNode<'t>> {
    let kind_length =
        node.text.find(|c: char| !c.is_alphanumeric() && c != '_' && c != '-').unwrap_or(node.text.len());
    let kind = &node.text[..kind_length];
    if kind.is_empty() || !kind.starts_with(|c: char| c.is_alphabetic()) {
        diagnostics.push(
            Diagnostic::new(node.span, format!("`{}` is not a node", node.name))
                .label("expected `Kind(field: value, ..)`"),
        );
        return None;
    }
    let fields = if node.text[kind_length..].trim().is_empty() {
        Vec::new()
    } else {
        pairs(text, &node.text[kind_length..], diagnostics)?
    };
    Some(RawNode {
        id: node.name,
        id_span: node.name_span,
        kind,
        kind_span: node.span.start..node.span.start + kind_length,
        span: node.span,
        fields,
    })
}

/// The ordered (name, value) pairs of a RON struct that is a slice of `text`.
fn pairs<'t>(text: &'t str, slice: &'t str, diagnostics: &mut Vec<Diagnostic>) -> Option<Vec<RawField<'t>>> {
    let result = ron::de::Deserializer::from_str_with_options(slice, &options())
        .map_err(|e| (e.code, e.span))
        .and_then(|mut from| {
            let pairs = from.deserialize_any(Pairs).and_then(|pairs| from.end().map(|()| pairs));
            pairs.map_err(|e| {
                let spanned = from.span_error(e);
                (spanned.code, spanned.span)
            })
        });
    match result {
        Ok(pairs) => Some(
            pairs
                .into_iter()
                .map(|(name, value)| {
                    let value = trim(value);
                    RawField { name, name_span: span_of(text, name), text: value, span: span_of(text, value) }
                })
                .collect(),
        ),
        Err((code, span)) => {
            let start = span_of(text, slice).start + offset(slice, span.start.line, span.start.col);
            let end = span_of(text, slice).start + offset(slice, span.end.line, span.end.col);
            diagnostics.push(syntax_error(&code, start..end.max(start)));
            None
        }
    }
}

fn syntax_error(code: &ron::Error, span: Range<usize>) -> Diagnostic {
    let plain = Diagnostic::new(span, reword(code));
    match code {
        ron::Error::ExpectedComma => plain.hint("fields and nodes are separated by commas"),
        ron::Error::ExpectedStructLikeEnd | ron::Error::Eof => plain.hint("a `(` has no matching `)`"),
        ron::Error::ExpectedIdentifier => {
            plain.hint("names of nodes and fields are plain words: letters, digits and `_`")
        }
        _ => plain,
    }
}

fn reword(code: &ron::Error) -> String {
    match code {
        ron::Error::ExpectedComma => "expected a comma here".to_owned(),
        ron::Error::Eof => "the text ends in the middle of a value".to_owned(),
        ron::Error::Message(message) => message.clone(),
        other => other.to_string(),
    }
}

// The slices come from ron and are parts of `text`, so the difference of addresses is the offset.
fn span_of(text: &str, slice: &str) -> Range<usize> {
    let start = (slice.as_ptr() as usize).saturating_sub(text.as_ptr() as usize).min(text.len());
    start..(start + slice.len()).min(text.len())
}

/// Byte offset of a place that ron gives as line and column, both from 1, columns in characters.
fn offset(text: &str, line: usize, column: usize) -> usize {
    let mut start = 0;
    for _ in 1..line {
        match text[start..].find('\n') {
            Some(length) => start += length + 1,
            None => break,
        }
    }
    let rest = &text[start..];
    start + rest.char_indices().nth(column.saturating_sub(1)).map_or(rest.len(), |(at, _)| at)
}

/// Without white space and comments at both ends.
fn trim(mut text: &str) -> &str {
    loop {
        text = text.trim();
        if let Some(rest) = text.strip_prefix("//") {
            text = rest.split_once('\n').map_or("", |(_, rest)| rest);
        } else if text.starts_with("/*") {
            text = skip_block_comment(text);
        } else {
            break;
        }
    }
    text
}

fn skip_block_comment(text: &str) -> &str {
    let mut depth = 0_usize;
    let mut at = 0;
    while let Some(found) = text[at..].find(['/', '*']) {
        at += found;
        match text.get(at..at + 2) {
            Some("/*") => (depth, at) = (depth + 1, at + 2),
            Some("*/") => {
                (depth, at) = (depth.saturating_sub(1), at + 2);
                if depth == 0 {
                    return &text[at..];
                }
            }
            _ => at += 1,
        }
    }
    ""
}

struct Pairs;

impl<'de> Visitor<'de> for Pairs {
    type Value = Vec<(&'de str, &'de str)>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of `name: value` in parentheses")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut pairs = Vec::new();
        while let Some(name) = map.next_key::<&'de str>()? {
            let value: &'de RawValue = map.next_value()?;
            pairs.push((name, value.get_ron()));
        }
        Ok(pairs)
    }

    fn visit_unit<E: serde::de::Error>(self) -> Result<Self::Value, E> {
        Ok(Vec::new())
    }
}

/// The fields of one node while its parameters are read. Collects every mistake.
pub struct Fields<'t, 'a> {
    pub(crate) fields: &'a [RawField<'t>],
    pub(crate) node_span: Range<usize>,
    pub(crate) kind: &'a str,
    pub(crate) diagnostics: &'a mut Vec<Diagnostic>,
}

impl Fields<'_, '_> {
    /// Reads one parameter: its value, its default, or `None` after reporting what is wrong.
    pub fn parameter<T: ParamType>(
        &mut self,
        name: &'static str,
        default: Option<T>,
        range: Option<(f64, f64)>,
    ) -> Option<T> {
        let Some(field) = self.fields.iter().find(|field| field.name == name) else {
            if default.is_none() {
                self.diagnostics.push(
                    Diagnostic::new(self.node_span.clone(), format!("`{}` needs `{name}`", self.kind))
                        .label(format!("`{name}` is missing: {}", T::describe())),
                );
            }
            return default;
        };
        let value = match parse_value::<T>(field.text) {
            Ok(value) => value,
            Err((message, span)) => {
                let span = field.span.start + span.start..field.span.start + span.end;
                self.diagnostics.push(
                    Diagnostic::new(span, format!("`{name}`: {message}"))
                        .label(format!("expected {}", T::describe())),
                );
                return None;
            }
        };
        if let Err(error) = value.key_text() {
            let message = format!("`{name}`: {error}");
            self.diagnostics.push(Diagnostic::new(field.span.clone(), message).label("must be finite"));
            return None;
        }
        match range {
            Some((low, high)) if !value.within(low, high) => {
                self.diagnostics.push(
                    Diagnostic::new(
                        field.span.clone(),
                        format!("`{name}` is out of range: {}", field.text.trim()),
                    )
                    .label(format!("must lie between {low} and {high}")),
                );
                None
            }
            _ => Some(value),
        }
    }
}

/// One value of a known type; the span of an error counts from the start of `text`.
pub(crate) fn parse_value<'t, T: serde::Deserialize<'t>>(text: &'t str) -> Result<T, (String, Range<usize>)> {
    options().from_str(text).map_err(|error| {
        let start = offset(text, error.span.start.line, error.span.start.col).min(text.len());
        let end = offset(text, error.span.end.line, error.span.end.col).min(text.len());
        let span = if start < end { start..end } else { 0..text.len() };
        (value_error(&error.code, text), span)
    })
}

fn value_error(code: &ron::Error, text: &str) -> String {
    match code {
        ron::Error::NoSuchEnumVariant { found, expected, .. } => {
            let near = crate::diag::nearest(found, expected.iter().copied());
            match near {
                Some(near) => format!("no such choice `{found}`, did you mean `{near}`?"),
                None => format!("no such choice `{found}`"),
            }
        }
        ron::Error::NoSuchStructField { found, expected, .. } => {
            format!("no such field `{found}`, there are {}", expected.join(", "))
        }
        ron::Error::MissingStructField { field, .. } => format!("needs `{field}`"),
        // ron stops at the dot of `512.0` where a whole number belongs.
        ron::Error::TrailingCharacters | ron::Error::ExpectedComma => {
            format!("`{text}` has the wrong form")
        }
        other => other.to_string(),
    }
}
