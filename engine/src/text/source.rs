//! The text of a graph: a list of pieces, one for each file, overlay and setting.
//!
//! The pieces are joined into one text, so that a single byte offset identifies a place in any of them.
//! Diagnostics, digests and bundles use this text. Each piece after the first is preceded by a line `//@@ role
//! name`, which is a comment in RON. When a bundle is read, the list of pieces is restored from these lines.

use std::ops::Range;
use std::sync::Arc;

/// A text and its name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Path or other name for diagnostics.
    pub name: String,
    /// The whole text.
    pub text: Arc<str>,
    pieces: Vec<Piece>,
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

/// A file, an overlay or a setting in a joined text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Piece {
    pub role: PieceRole,
    pub name: String,
    pub span: Range<usize>,
}

impl PieceRole {
    /// The roles that a piece after the first may have, each with its name in the mark of the piece.
    const NAMED: [(&'static str, Self); 5] = [
        ("include", Self::Include),
        ("subgraph", Self::Subgraph),
        ("overlay", Self::Overlay),
        ("set", Self::Setting),
        ("preset", Self::Preset),
    ];

    fn name(self) -> &'static str {
        Self::NAMED.iter().find(|(_, role)| *role == self).map_or("graph", |(name, _)| name)
    }
}

/// Start of a mark, which is the line before a piece. The role and the name of the piece follow.
const MARK: &str = "\n//@@ ";
/// First line of a text whose marks separate pieces. In any other text, marks are ordinary comments.
const PACKED: &str = "//@@ packed\n";

/// Parses the role and the name that follow [`MARK`] in a line.
fn parse_mark(line: &str) -> Option<(PieceRole, &str)> {
    let (role, name) = line.split_once(' ')?;
    PieceRole::NAMED.iter().find(|(known, _)| *known == role).map(|(_, role)| (*role, name))
}

/// Prefix of the name of an overlay that comes from a built-in preset.
const BUILT_IN_PRESET: &str = "--preset ";

impl Source {
    /// A text with a name. It consists of several pieces if it is the graph of a bundle, and of one piece
    /// otherwise.
    pub fn new(name: impl Into<String>, text: impl Into<Arc<str>>) -> Self {
        let (name, text) = (name.into(), text.into());
        if text.starts_with(PACKED) {
            return Self::packed(name, text);
        }
        let pieces = vec![Piece { role: PieceRole::Graph, name: name.clone(), span: 0..text.len() }];
        Self { name, text, pieces }
    }

    /// The graph of a bundle, which may consist of several pieces.
    pub fn packed(name: impl Into<String>, text: impl Into<Arc<str>>) -> Self {
        let (name, text) = (name.into(), text.into());
        let mut pieces = vec![Piece { role: PieceRole::Graph, name: name.clone(), span: 0..text.len() }];
        let mut at = 0;
        while let Some(found) = text[at..].find(MARK) {
            let mark = at + found;
            let line = text[mark + MARK.len()..].split('\n').next().unwrap_or_default();
            at = mark + MARK.len() + line.len();
            let Some((role, piece)) = parse_mark(line) else { continue };
            if let Some(last) = pieces.last_mut() {
                last.span.end = mark;
            }
            let start = (at + 1).min(text.len());
            pieces.push(Piece { role, name: piece.to_owned(), span: start..text.len() });
        }
        Self { name, text, pieces }
    }

    /// The text for a bundle, after `edits` are applied. An edit is a range and its new text; the ranges are in
    /// descending order.
    pub(crate) fn pack(&self, edits: &[(Range<usize>, String)]) -> String {
        let mut whole = String::new();
        if self.pieces.len() > 1 && !self.text.starts_with(PACKED) {
            whole.push_str(PACKED);
        }
        for (number, piece) in self.pieces.iter().enumerate() {
            // With the line break in front, as a mark has one.
            let mut text = format!("\n{}", &self.text[piece.span.clone()]);
            let inside = edits.iter().filter(|(span, _)| piece.span.contains(&span.start));
            for (span, with) in inside {
                text.replace_range(span.start - piece.span.start + 1..span.end - piece.span.start + 1, with);
            }
            for (role, _) in PieceRole::NAMED {
                // A comment that would be taken for a mark.
                text = text.replace(&format!("{MARK}{role} "), &format!("\n// @@ {role} "));
            }
            if number > 0 {
                whole.push_str(&format!("{MARK}{} {}", piece.role.name(), piece.name));
                whole.push_str(&text);
            } else {
                whole.push_str(&text[1..]);
            }
        }
        whole
    }

    /// Line and column, both from 1, of a byte offset within its file. Columns count characters.
    pub fn position(&self, offset: usize) -> (usize, usize) {
        let before = &self.text
            [self.piece(offset).span.start..self.text.floor_char_boundary(offset.min(self.text.len()))];
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
    }

    /// Adds an overlay such as `Overlay(nodes: (trace: (samples: 16)))`. It overrides earlier overlays.
    pub fn overlaid(self, name: &str, text: &str) -> Self {
        self.joined(PieceRole::Overlay, name, text)
    }

    /// The graph with its overlays and settings but without presets.
    pub fn without_presets(&self) -> Self {
        let is_preset = |piece: &Piece| {
            piece.role == PieceRole::Preset
                || piece.role == PieceRole::Overlay && piece.name.starts_with(BUILT_IN_PRESET)
        };
        let (first, rest) = self.pieces.split_at(1);
        let mut source = Self {
            name: self.name.clone(),
            text: self.text[..first[0].span.end].into(),
            pieces: first.to_vec(),
        };
        for piece in rest.iter().filter(|piece| !is_preset(piece)) {
            source = source.joined(piece.role, &piece.name, &self.text[piece.span.clone()]);
        }
        source
    }

    /// Adds a built-in preset as an overlay.
    pub(crate) fn with_built_in_preset(self, preset: &str, text: &str) -> Self {
        self.joined(PieceRole::Overlay, &format!("{BUILT_IN_PRESET}{preset}"), text)
    }

    /// Selects one of the `presets` that the graph defines.
    pub(crate) fn with_own_preset(self, preset: &str) -> Self {
        self.joined(PieceRole::Preset, "--preset", preset)
    }

    /// Adds a setting `trace.samples=16`.
    pub(crate) fn set(self, setting: &str) -> Self {
        self.joined(PieceRole::Setting, "--set", setting)
    }

    /// Appends a piece.
    pub(crate) fn joined(self, role: PieceRole, name: &str, text: &str) -> Self {
        // A line break would end the mark.
        let name = name.replace(['\n', '\r'], " ");
        let mut pieces = self.pieces;
        let whole = format!("{}{MARK}{} {name}\n{text}", self.text, role.name());
        pieces.push(Piece { role, name, span: whole.len() - text.len()..whole.len() });
        Self { name: self.name, text: whole.into(), pieces }
    }

    /// The pieces of the text, in order.
    pub(crate) fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    /// The piece that contains a byte offset.
    pub(crate) fn piece(&self, offset: usize) -> &Piece {
        let index = self.pieces.iter().rposition(|piece| piece.span.start <= offset).unwrap_or_default();
        &self.pieces[index]
    }
}

/// The folder of an included file or subgraph, relative to the folder of the graph. It is empty or ends with `/`.
pub(crate) fn folder_of(piece: &Piece) -> &str {
    match piece.role {
        PieceRole::Include | PieceRole::Subgraph => {
            piece.name.rfind('/').map_or("", |end| &piece.name[..=end])
        }
        _ => "",
    }
}

/// Joins a folder and a relative path, and removes `.` and `..` where possible, so that a file always has the same
/// name.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn roles(source: &Source) -> Vec<(PieceRole, &str, &str)> {
        let piece = |piece: &'_ Piece| (piece.role, piece.span.clone());
        let spans: Vec<_> = source.pieces().iter().map(piece).collect();
        let names = source.pieces().iter().map(|piece| piece.name.as_str());
        names.zip(spans).map(|(name, (role, span))| (role, name, &source.text[span])).collect()
    }

    // This test fails if `new` splits every text, or if `pack` leaves comments as they are.
    #[test]
    fn a_comment_that_looks_like_a_mark_stays_a_comment() {
        let own = "Graph(\n//@@ set a.x=1\n)";
        let graph = || Source::new("g.ron", own);
        assert_eq!(roles(&graph()), [(PieceRole::Graph, "g.ron", own)]);
        assert_eq!(
            graph().pack(&[]),
            "Graph(\n// @@ set a.x=1\n)",
            "read from a bundle it would be a setting"
        );
        let source = graph().set("a.x=2").overlaid("o.ron", "//@@ overlay no\nOverlay()");
        let packed = source.pack(&[(0..5, "Longer".to_owned())]);
        let again = Source::new("g.ron", packed.as_str());
        let first = "//@@ packed\nLonger(\n// @@ set a.x=1\n)";
        let wanted = [
            (PieceRole::Graph, "g.ron", first),
            (PieceRole::Setting, "--set", "a.x=2"),
            (PieceRole::Overlay, "o.ron", "// @@ overlay no\nOverlay()"),
        ];
        assert_eq!(roles(&again), wanted);
        assert_eq!(again.pack(&[]), packed, "packing twice changes nothing");
        assert_eq!(again.without_presets(), again);
        assert_eq!(
            roles(&Source::packed("g.ron", own)).len(),
            2,
            "bundles of earlier versions have no first line"
        );
    }
}
