//! Diagnostics: the mistakes in a graph file, with their positions and advice. All mistakes of a file are reported
//! together.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::PathBuf;

use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};
use serde::Serialize;

use crate::text::source::{Piece, Source};
use crate::value::error::NodeError;

/// Category of a mistake. Its name in JSON is stable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Code {
    /// The text is not valid RON, or does not have the structure of a graph file.
    Syntax,
    /// A file format version that this version of lightharmony does not read.
    Version,
    /// Something required is missing.
    Missing,
    /// A name is given twice.
    Duplicate,
    /// Unknown name of a kind.
    UnknownKind,
    /// Unknown name of a field.
    UnknownField,
    /// Unknown name of a node.
    UnknownNode,
    /// The node has no output with this name.
    UnknownOutput,
    /// An output is connected to an input of another type.
    WrongType,
    /// The value has the wrong type.
    WrongValue,
    /// The number is out of range.
    OutOfRange,
    /// Parameters that cannot be combined.
    Parameters,
    /// A node that runs a program, in a graph from others.
    RunsProgram,
    /// Wires that cannot be combined.
    Wiring,
    /// Nodes that depend on each other in a cycle.
    Cycle,
    /// A source path that does not exist or is not a file.
    MissingFile,
    /// An output path that cannot be written.
    OutputPath,
    /// An argument of `--set` that does not have the form of a setting.
    Setting,
    /// The node failed during a run.
    Failed,
}

/// A mistake in a text.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnostic {
    /// Category, for programs.
    pub code: Code,
    /// Byte range to underline in the text.
    pub span: Range<usize>,
    /// Description of the mistake.
    pub message: String,
    /// Text next to the underline.
    pub label: String,
    /// Byte ranges of related places, each with the text to show next to it.
    pub related: Vec<(Range<usize>, String)>,
    /// Advice on how to correct the mistake.
    pub hints: Vec<String>,
}

impl Diagnostic {
    /// A syntax mistake at `span`.
    pub fn new(span: Range<usize>, message: impl Into<String>) -> Self {
        Self::of(Code::Syntax, span, message)
    }

    /// A mistake of any category.
    pub fn of(code: Code, span: Range<usize>, message: impl Into<String>) -> Self {
        let message = bounded(message.into());
        Self { code, span, message, label: String::new(), related: Vec::new(), hints: Vec::new() }
    }

    /// A mistake with the message and the advice of an error.
    pub fn caused_by(code: Code, span: Range<usize>, error: NodeError) -> Self {
        Self { hints: error.hint.iter().cloned().collect(), ..Self::of(code, span, error.message()) }
    }

    /// Sets the text next to the underline.
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = bounded(label.into());
        self
    }

    /// Adds a related byte range and the text to show next to it.
    pub fn related(mut self, span: Range<usize>, label: impl Into<String>) -> Self {
        self.related.push((span, label.into()));
        self
    }

    /// Adds advice.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hints.push(bounded(hint.into()));
        self
    }

    /// Adds "did you mean" if a name in `known` is similar to `found`.
    pub fn suggest<'k>(self, found: &str, known: impl IntoIterator<Item = &'k str>) -> Self {
        match nearest(found, known) {
            Some(near) => self.hint(format!("did you mean `{near}`?")),
            None => self,
        }
    }
}

/// Maximum number of diagnostics shown.
const MOST_SHOWN: usize = 100;

/// The mistakes in one text, sorted by byte range.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnostics {
    /// The text with the mistakes.
    pub source: Source,
    /// The mistakes; there is at least one.
    pub list: Vec<Diagnostic>,
    /// The files that the text names. If one of them causes a mistake, a change to it may resolve the mistake.
    pub files: Vec<PathBuf>,
}

impl Diagnostics {
    /// Sorts mistakes by byte range and removes duplicates, which occur if a subgraph is used several times.
    pub fn new(source: Source, mut list: Vec<Diagnostic>) -> Self {
        list.sort_by_key(|diagnostic| (diagnostic.span.start, diagnostic.span.end));
        let mut seen = BTreeSet::new();
        list.retain(|one| seen.insert((one.span.start, one.span.end, one.message.clone())));
        Self { source, list, files: Vec::new() }
    }

    /// The mistakes as data, for programs that display them in their own way.
    pub fn mistakes(&self) -> Vec<Mistake> {
        let mistake = |one: &Diagnostic| {
            let (line, column) = self.source.position(one.span.start);
            let text = self.source.text.get(one.span.clone()).unwrap_or_default();
            let length = text.lines().next().unwrap_or_default().chars().count();
            let file = self.source.piece(one.span.start).name.clone();
            let (message, label) = (one.message.clone(), one.label.clone());
            let (span, code, hints) = ([one.span.start, one.span.end], one.code, one.hints.clone());
            Mistake { file, line, column, length, span, code, message, label, hints }
        };
        self.list.iter().map(mistake).collect()
    }

    /// The mistakes as formatted text, with excerpts of the file.
    pub fn render(&self, colour: bool) -> String {
        let renderer = if colour { Renderer::styled() } else { Renderer::plain() };
        let shown = self.list.iter().take(MOST_SHOWN);
        let mut rendered: Vec<String> = shown.map(|one| self.render_one(&renderer, one)).collect();
        if let Some(more) = self.list.len().checked_sub(MOST_SHOWN).filter(|more| *more > 0) {
            rendered.push(format!("and {more} more"));
        }
        rendered.join("\n\n")
    }

    fn render_one(&self, renderer: &Renderer, one: &Diagnostic) -> String {
        let piece_of = |offset: usize| self.source.piece(offset);
        let own = piece_of(one.span.start);
        let place = |span: &Range<usize>| place(&self.source.text, &piece_of(span.start).span, span);
        let mut primary = AnnotationKind::Primary.span(place(&one.span));
        if !one.label.is_empty() {
            primary = primary.label(one.label.as_str());
        }
        let near = |span: &Range<usize>| {
            // A line of megabytes would be shown in full.
            let (low, high) = (span.start.min(one.span.start), span.start.max(one.span.start));
            let between = self.source.text.get(low..high).unwrap_or_default();
            between.len() < 1000 || between.contains('\n')
        };
        let snippet =
            |piece: &Piece| Snippet::source(&self.source.text[piece.span.clone()]).path(piece.name.clone());
        let annotation_of = |(span, label): &'_ (Range<usize>, String)| {
            AnnotationKind::Context.span(place(span)).label(label.clone())
        };
        let here = |span: &Range<usize>| piece_of(span.start) == own;
        let related = one.related.iter().filter(|(span, _)| here(span) && near(span)).map(annotation_of);
        let mut group = Level::ERROR
            .primary_title(one.message.as_str())
            .element(snippet(own).annotation(primary).annotations(related));
        for other in one.related.iter().filter(|(span, _)| !here(span)) {
            group = group.element(snippet(piece_of(other.0.start)).annotation(annotation_of(other)));
        }
        for hint in &one.hints {
            group = group.element(Level::HELP.message(hint.as_str()));
        }
        renderer.render(&[group])
    }
}

/// Converts `span` to offsets relative to `piece`, and shortens it to its first line.
fn place(text: &str, piece: &Range<usize>, span: &Range<usize>) -> Range<usize> {
    let start = text.floor_char_boundary(span.start.clamp(piece.start, piece.end));
    let end = text.ceil_char_boundary(span.end.clamp(start, piece.end));
    let line_end = text[start..end].find('\n').map_or(end, |length| start + length);
    start - piece.start..line_end - piece.start
}

impl std::fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.render(false))
    }
}

impl std::error::Error for Diagnostics {}

/// A text for use in a message, shortened if it is long.
pub(crate) fn shown(text: &str) -> std::borrow::Cow<'_, str> {
    match text.char_indices().nth(60) {
        None => text.into(),
        Some((end, _)) => format!("{}..", &text[..end]).into(),
    }
}

/// Shortens a message that contains a very long name.
fn bounded(mut text: String) -> String {
    const MOST: usize = 2000;
    if text.len() > MOST {
        text.truncate(text.floor_char_boundary(MOST));
        text.push_str("..");
    }
    text
}

/// The name in `known` that is most similar to `found`. The number of edits between the two may be at most a third
/// of the number of letters in `found`, but at least 1 edit and at most 3 edits are permitted. An edit inserts,
/// deletes or replaces a letter, or swaps two adjacent letters. If no name is similar, but exactly one name
/// contains `found` as a word, returns that name (such as `yaw_deg` for `yaw`).
pub fn nearest<'k>(found: &str, known: impl IntoIterator<Item = &'k str>) -> Option<&'k str> {
    // Only the first letters of long names are compared, since the time grows with the square of the length.
    let folded = |text: &str| -> String { text.to_lowercase().chars().take(64).collect() };
    let known: Vec<&str> = known.into_iter().collect();
    let (limit, name) = ((found.chars().count() / 3).clamp(1, 3), folded(found));
    let distance = |&candidate: &&'k str| (strsim::osa_distance(&name, &folded(candidate)), candidate);
    let near = known.iter().map(distance).filter(|(distance, _)| *distance <= limit);
    let near = near.min_by_key(|(distance, _)| *distance).map(|(_, candidate)| candidate);
    let mut longer =
        known.into_iter().filter(|candidate| candidate.split(['_', '-']).any(|word| word == found));
    near.or_else(|| longer.next().filter(|_| longer.next().is_none()))
}

/// A mistake in a graph, for programs that display it in their own way.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Mistake {
    /// Name of the file.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// Length of the underline in characters.
    pub length: usize,
    /// Byte range of the underline: the first byte, and the byte after the last.
    pub span: [usize; 2],
    /// Category of the mistake.
    pub code: Code,
    /// Description of the mistake.
    pub message: String,
    /// Text next to the underline.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub label: String,
    /// Advice on how to correct the mistake.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub hints: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_found_and_strangers_are_not() {
        let known = ["width_px", "height_px", "samples"];
        assert_eq!(nearest("widht_px", known), Some("width_px"));
        assert_eq!(nearest("sample", known), Some("samples"));
        assert_eq!(nearest("gamma", known), None);
        assert_eq!(nearest("ab", ["ba"]), Some("ba"), "a swap is one edit");
    }

    #[test]
    fn positions_count_lines_and_characters_from_one() {
        let source = Source::new("a.ron", "ü1\n  x");
        assert_eq!(source.position(0), (1, 1));
        assert_eq!(source.position(3), (1, 3));
        assert_eq!(source.position(6), (2, 3));
    }

    #[test]
    fn a_rendered_mistake_names_file_line_and_advice() {
        let source = Source::new("a.ron", "Graph(\n  nod: 1,\n)");
        let one = Diagnostic::new(9..12, "no field `nod`").label("here").suggest("nod", ["nodes", "scene"]);
        let text = Diagnostics::new(source, vec![one]).render(false);
        assert!(text.contains("a.ron:2:3") && text.contains("^^^ here"), "{text}");
        assert!(text.contains("did you mean `nodes`?") || text.contains("no field"), "{text}");
    }
}
