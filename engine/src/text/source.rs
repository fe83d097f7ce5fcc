//! The text of a graph: one file, or several joined behind lines `//@@ role name`, which are comments in RON.
//!
//! So whatever knows a graph by its text (its place in diagnostics, its digest, a bundle) knows all of it.

use std::ops::Range;
use std::sync::Arc;

/// A text with the name it is known by.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Path or other name, as diagnostics print it.
    pub name: String,
    /// The whole text.
    pub text: Arc<str>,
}

/// What a part of a joined text is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum PieceRole {
    /// The graph itself, which comes first.
    Graph,
    /// A file that it includes.
    Include,
    /// A file that it uses as a subgraph.
    Subgraph,
    /// Values in place of others.
    Overlay,
    /// One value in place of another: `node.field=value`.
    Setting,
    /// The name of a preset.
    Preset,
}

/// Where a file stands in a joined text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Piece<'t> {
    pub role: PieceRole,
    pub name: &'t str,
    pub span: Range<usize>,
}

const MARK: &str = "\n//@@ ";

/// What the name of an overlay begins with that is a preset of the program's.
const BUILT_IN_PRESET: &str = "--preset ";

impl Source {
    /// A text of the given name.
    pub fn new(name: impl Into<String>, text: impl Into<Arc<str>>) -> Self {
        Self { name: name.into(), text: text.into() }
    }

    /// Line and column, both from 1, of a byte offset in the file it lies in; columns count characters.
    pub fn position(&self, offset: usize) -> (usize, usize) {
        let before = &self.text
            [self.piece(offset).span.start..self.text.floor_char_boundary(offset.min(self.text.len()))];
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
    }

    /// Lays the text of an overlay over the graph: `Overlay(nodes: (trace: (samples: 16)))`. Later ones win.
    pub fn overlaid(self, name: &str, text: &str) -> Self {
        self.joined("overlay", name, text)
    }

    /// The graph with all that is laid over it but presets.
    pub fn without_presets(&self) -> Self {
        let is_preset =
            |piece: &Piece<'_>| piece.role == PieceRole::Preset || piece.name.starts_with(BUILT_IN_PRESET);
        let (mut text, mut from) = (String::new(), 0);
        for piece in self.pieces() {
            // With the line that says what it is, which stands before it.
            if !is_preset(&piece) {
                text.push_str(&self.text[from..piece.span.end]);
            }
            from = piece.span.end;
        }
        Self::new(self.name.clone(), text)
    }

    /// Lays a preset of the program's over the graph, as an overlay.
    pub(crate) fn with_built_in_preset(self, preset: &str, text: &str) -> Self {
        self.joined("overlay", &format!("{BUILT_IN_PRESET}{preset}"), text)
    }

    /// Lays one of the graph's own `presets` over it.
    pub(crate) fn with_own_preset(self, preset: &str) -> Self {
        self.joined("preset", "--preset", preset)
    }

    /// Lays one value over the graph: `trace.samples=16`.
    pub(crate) fn set(self, setting: &str) -> Self {
        self.joined("set", "--set", setting)
    }

    pub(crate) fn joined(self, role: &str, name: &str, text: &str) -> Self {
        let text = format!("{}{MARK}{role} {name}\n{text}", self.text);
        Self::new(self.name, text)
    }

    /// The files of the text, in order.
    pub(crate) fn pieces(&self) -> Vec<Piece<'_>> {
        let mut pieces = vec![Piece { role: PieceRole::Graph, name: &self.name, span: 0..self.text.len() }];
        let mut at = 0;
        while let Some(found) = self.text[at..].find(MARK) {
            let mark = at + found;
            let line = &self.text[mark + MARK.len()..];
            let line = &line[..line.find('\n').unwrap_or(line.len())];
            at = mark + MARK.len() + line.len();
            let role = match line.split_once(' ') {
                Some(("include", name)) => (PieceRole::Include, name),
                Some(("subgraph", name)) => (PieceRole::Subgraph, name),
                Some(("set", name)) => (PieceRole::Setting, name),
                Some(("overlay", name)) => (PieceRole::Overlay, name),
                Some(("preset", name)) => (PieceRole::Preset, name),
                // A comment that only looks alike.
                _ => continue,
            };
            if let Some(last) = pieces.last_mut() {
                last.span.end = mark;
            }
            let start = (at + 1).min(self.text.len());
            pieces.push(Piece { role: role.0, name: role.1, span: start..self.text.len() });
        }
        pieces
    }

    /// The file that a place of the text is in.
    pub(crate) fn piece(&self, offset: usize) -> Piece<'_> {
        let mut pieces = self.pieces();
        let index = pieces.iter().rposition(|piece| piece.span.start <= offset).unwrap_or_default();
        pieces.swap_remove(index)
    }
}

/// The folder of an included file or subgraph, relative to that of the graph; empty or with a `/` at its end.
pub(crate) fn folder_of<'t>(piece: &Piece<'t>) -> &'t str {
    match piece.role {
        PieceRole::Include | PieceRole::Subgraph => {
            piece.name.rfind('/').map_or("", |end| &piece.name[..=end])
        }
        _ => "",
    }
}

/// A path from a folder, without the detours that would give one file two names.
pub(crate) fn plain(folder: &str, path: &str) -> String {
    if path.starts_with('/') {
        return path.to_owned();
    }
    let mut parts: Vec<&str> = Vec::new();
    for part in folder.split('/').chain(path.split('/')) {
        match part {
            "" | "." => {}
            ".." if parts.last().is_some_and(|last| *last != "..") => drop(parts.pop()),
            _ => parts.push(part),
        }
    }
    parts.join("/")
}
