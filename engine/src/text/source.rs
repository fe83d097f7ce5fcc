//! The text of a graph: one file, or several joined by lines `//@@ role name`, which are comments in RON.
//!
//! The joined text is the whole graph: diagnostics, digests and bundles use it alone.

use std::ops::Range;
use std::sync::Arc;

/// A text and its name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Path or other name for diagnostics.
    pub name: String,
    /// The whole text.
    pub text: Arc<str>,
}

/// The role of a piece of a joined text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum PieceRole {
    /// The graph file itself, which is first.
    Graph,
    /// An included file.
    Include,
    /// A file used as a subgraph.
    Subgraph,
    /// An overlay.
    Overlay,
    /// A setting `node.field=value`.
    Setting,
    /// The name of a preset of the graph.
    Preset,
}

/// One file in a joined text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Piece<'t> {
    pub role: PieceRole,
    pub name: &'t str,
    pub span: Range<usize>,
}

const MARK: &str = "\n//@@ ";

/// Prefix of the name of an overlay that is a built-in preset.
const BUILT_IN_PRESET: &str = "--preset ";

impl Source {
    /// A text with a name.
    pub fn new(name: impl Into<String>, text: impl Into<Arc<str>>) -> Self {
        Self { name: name.into(), text: text.into() }
    }

    /// Line and column, both from 1, of a byte offset within its file. Columns count characters.
    pub fn position(&self, offset: usize) -> (usize, usize) {
        let before = &self.text
            [self.piece(offset).span.start..self.text.floor_char_boundary(offset.min(self.text.len()))];
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
    }

    /// Adds an overlay, `Overlay(nodes: (trace: (samples: 16)))`, which overrides earlier ones.
    pub fn overlaid(self, name: &str, text: &str) -> Self {
        self.joined("overlay", name, text)
    }

    /// The graph with its overlays and settings but without presets.
    pub fn without_presets(&self) -> Self {
        let is_preset =
            |piece: &Piece<'_>| piece.role == PieceRole::Preset || piece.name.starts_with(BUILT_IN_PRESET);
        let (mut text, mut from) = (String::new(), 0);
        for piece in self.pieces() {
            // Including the line in front of it that states its role.
            if !is_preset(&piece) {
                text.push_str(&self.text[from..piece.span.end]);
            }
            from = piece.span.end;
        }
        Self::new(self.name.clone(), text)
    }

    /// Adds a built-in preset as an overlay.
    pub(crate) fn with_built_in_preset(self, preset: &str, text: &str) -> Self {
        self.joined("overlay", &format!("{BUILT_IN_PRESET}{preset}"), text)
    }

    /// Adds one of the graph's own `presets`.
    pub(crate) fn with_own_preset(self, preset: &str) -> Self {
        self.joined("preset", "--preset", preset)
    }

    /// Adds a setting `trace.samples=16`.
    pub(crate) fn set(self, setting: &str) -> Self {
        self.joined("set", "--set", setting)
    }

    pub(crate) fn joined(self, role: &str, name: &str, text: &str) -> Self {
        let text = format!("{}{MARK}{role} {name}\n{text}", self.text);
        Self::new(self.name, text)
    }

    /// The pieces of the text, in order.
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
                // A user's comment that only resembles a mark.
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

    /// The piece that contains a byte offset.
    pub(crate) fn piece(&self, offset: usize) -> Piece<'_> {
        let mut pieces = self.pieces();
        let index = pieces.iter().rposition(|piece| piece.span.start <= offset).unwrap_or_default();
        pieces.swap_remove(index)
    }
}

/// The folder of an included file or subgraph relative to that of the graph: empty, or ending with a `/`.
pub(crate) fn folder_of<'t>(piece: &Piece<'t>) -> &'t str {
    match piece.role {
        PieceRole::Include | PieceRole::Subgraph => {
            piece.name.rfind('/').map_or("", |end| &piece.name[..=end])
        }
        _ => "",
    }
}

/// A path relative to a folder in normal form, so that every file has one name.
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
