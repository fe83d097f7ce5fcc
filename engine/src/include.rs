//! One text of several files: a graph, what it includes, and what is laid over it.
//!
//! The files are joined, each behind a line `//@@ role name`, which is a comment in RON. So whatever knows
//! a graph by its text (its place in diagnostics, its digest, a bundle) knows all of it.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::PathBuf;

use crate::diag::{Diagnostic, Source, nearest, shown};
use crate::param::InputFile;
use crate::root::SourceRoot;
use crate::syntax::{Document, RawField, RawNode, RawScene, Sort, parse_part, parse_preset, parse_value};

/// What a part of a joined text is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    /// The graph itself, which comes first.
    Graph,
    /// A file that it includes.
    Include,
    /// Values in place of others.
    Overlay,
    /// The name of a preset.
    Preset,
}

/// Where a file stands in a joined text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Piece<'t> {
    pub role: Role,
    pub name: &'t str,
    pub span: Range<usize>,
}

const MARK: &str = "\n//@@ ";

/// A graph includes no more files than this, and no more bytes.
const MOST_FILES: usize = 1000;
const MOST_BYTES: usize = 256 << 20;

impl Source {
    /// Lays the text of an overlay over the graph: `Overlay(nodes: (trace: (samples: 16)))`. Later ones win.
    pub fn overlaid(self, name: &str, text: &str) -> Self {
        self.joined("overlay", name, text)
    }

    /// Lays one of the graph's own `presets` over it.
    pub fn with_preset(self, preset: &str) -> Self {
        self.joined("preset", "--preset", preset)
    }

    fn joined(self, role: &str, name: &str, text: &str) -> Self {
        let text = format!("{}{MARK}{role} {name}\n{text}", self.text);
        Self::new(self.name, text)
    }

    /// Reads the files that the graph includes, and those that these include, each once; those that a bundle
    /// has joined already stay. What cannot be read, or may not be, is a mistake of the graph when it is
    /// parsed. Gives the paths of the files as well, found or not.
    pub fn including(mut self, root: &SourceRoot) -> (Self, Vec<PathBuf>) {
        let mut paths = Vec::new();
        let joined = self.pieces().into_iter().filter(|piece| piece.role == Role::Include);
        let mut seen: BTreeSet<String> = joined.map(|piece| piece.name.to_owned()).collect();
        let mut bytes = 0;
        loop {
            let wanted: Vec<String> =
                included(&self).into_iter().filter(|name| seen.insert(name.clone())).collect();
            if wanted.is_empty() || seen.len() > MOST_FILES {
                return (self, paths);
            }
            for name in wanted {
                let file = root.file(&InputFile(name));
                let text =
                    if root.is_outside(&file) { None } else { std::fs::read_to_string(&file.path).ok() };
                if let Some(text) = text {
                    bytes += text.len();
                    if bytes > MOST_BYTES {
                        return (self, paths);
                    }
                    self = self.joined("include", &file.name, &text);
                }
                paths.push(file.path);
            }
        }
    }

    /// The files of the text, in order.
    pub(crate) fn pieces(&self) -> Vec<Piece<'_>> {
        let mut pieces = vec![Piece { role: Role::Graph, name: &self.name, span: 0..self.text.len() }];
        let mut at = 0;
        while let Some(found) = self.text[at..].find(MARK) {
            let mark = at + found;
            let line = &self.text[mark + MARK.len()..];
            let line = &line[..line.find('\n').unwrap_or(line.len())];
            at = mark + MARK.len() + line.len();
            let role = match line.split_once(' ') {
                Some(("include", name)) => (Role::Include, name),
                Some(("overlay", name)) => (Role::Overlay, name),
                Some(("preset", name)) => (Role::Preset, name),
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

/// The names of the files that the pieces include, relative to the folder of the graph.
fn included(source: &Source) -> Vec<String> {
    let mut names = Vec::new();
    for piece in source.pieces().iter().filter(|piece| matches!(piece.role, Role::Graph | Role::Include)) {
        let document = parse_part(&source.text, piece.span.clone(), Sort::Graph, &mut Vec::new());
        names.extend(document.include.iter().flat_map(|field| files(field, piece)).map(|(name, _)| name));
    }
    names
}

/// What an `include` names, relative to the folder of the graph, each with its place.
fn files(field: &RawField<'_>, piece: &Piece<'_>) -> Vec<(String, Range<usize>)> {
    let list =
        parse_value::<Vec<String>>(field.text).or_else(|_| parse_value(field.text).map(|one| vec![one]));
    let folder = folder_of(piece);
    let place = |name: &str| {
        let quoted = format!("\"{name}\"");
        let found = field.text.find(&quoted).map(|at| field.span.start + at);
        found.map_or(field.span.clone(), |start| start..start + quoted.len())
    };
    list.unwrap_or_default().into_iter().map(|name| (plain(folder, &name), place(&name))).collect()
}

/// The folder of an included file, relative to that of the graph; empty or with a `/` at its end.
pub(crate) fn folder_of<'t>(piece: &Piece<'t>) -> &'t str {
    match piece.role {
        Role::Include => piece.name.rfind('/').map_or("", |end| &piece.name[..=end]),
        _ => "",
    }
}

/// A path from a folder, without the detours that would give one file two names.
fn plain(folder: &str, path: &str) -> String {
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

/// Reads all pieces as one document.
pub(crate) fn parse_all<'t>(source: &'t Source, diagnostics: &mut Vec<Diagnostic>) -> Document<'t> {
    let pieces = source.pieces();
    let sort = |role: Role| if role == Role::Overlay { Sort::Overlay } else { Sort::Graph };
    let mut read =
        |piece: &Piece<'_>| parse_part(&source.text, piece.span.clone(), sort(piece.role), diagnostics);
    let mut document = read(&pieces[0]);
    let mut others: Vec<(&Piece<'t>, Document<'t>)> = Vec::new();
    for piece in &pieces[1..] {
        let other = if piece.role == Role::Preset { Document::default() } else { read(piece) };
        others.push((piece, other));
    }
    for (piece, other) in std::iter::once((&pieces[0], &document)).chain(others.iter().map(|(p, d)| (*p, d)))
    {
        let Some(field) = &other.include else { continue };
        let names = files(field, piece);
        if names.is_empty() && field.text.trim() != "[]" {
            diagnostics.push(
                Diagnostic::new(field.span.clone(), "`include` takes paths of graph files")
                    .label("write [\"light.ron\"]"),
            );
        }
        for (name, place) in names {
            if !pieces.iter().any(|known| known.role == Role::Include && known.name == name) {
                diagnostics.push(
                    Diagnostic::new(place, format!("`{}` cannot be read", shown(&name)))
                        .hint("paths are relative to the folder of the file that names them"),
                );
            }
        }
    }
    let mut overlays = Vec::new();
    for (piece, other) in others {
        match piece.role {
            Role::Include => merge(&mut document, other, folder_of(piece)),
            Role::Preset => overlays.extend(preset(&document, source, piece, diagnostics)),
            Role::Graph | Role::Overlay => overlays.push(other),
        }
    }
    for overlay in overlays {
        lay_over(&mut document, overlay, diagnostics);
    }
    document
}

/// Adds what an included file holds. The graph's own scene wins, then that of the first file that has one.
fn merge<'t>(document: &mut Document<'t>, other: Document<'t>, folder: &'t str) {
    document.nodes.extend(other.nodes.into_iter().map(|node| RawNode { folder, ..node }));
    document.broken.extend(other.broken);
    document.axes.extend(other.axes);
    document.presets.extend(other.presets);
    document.scene = document.scene.take().or(other.scene);
    document.whole &= other.whole;
}

/// The chosen preset of a graph.
fn preset<'t>(
    document: &Document<'t>,
    source: &'t Source,
    piece: &Piece<'_>,
    diagnostics: &mut Vec<Diagnostic>,
) -> Option<Document<'t>> {
    let name = &source.text[piece.span.clone()];
    if let Some(field) = document.presets.iter().find(|field| field.name == name) {
        return Some(parse_preset(&source.text, field.span.clone(), diagnostics));
    }
    let known = || document.presets.iter().map(|field| field.name);
    let mistake = Diagnostic::new(piece.span.clone(), format!("the graph has no preset `{}`", shown(name)));
    diagnostics.push(match known().next() {
        None => mistake.hint("presets stand beside `nodes`: `presets: (draft: (trace: (samples: 4)))`"),
        Some(_) => {
            let list: Vec<&str> = known().collect();
            mistake.suggest(name, known()).hint(format!("it has {}", list.join(", ")))
        }
    });
    None
}

/// Puts the fields of an overlay in place of those of the document.
fn lay_over<'t>(document: &mut Document<'t>, overlay: Document<'t>, diagnostics: &mut Vec<Diagnostic>) {
    for node in overlay.nodes {
        let block = match node.id {
            "axes" => Some(&mut document.axes),
            "scene" => document.scene.as_mut().map(|scene: &mut RawScene<'t>| &mut scene.fields),
            _ => None,
        };
        let own = document.nodes.iter_mut().find(|known| known.id == node.id);
        let has = |known: &RawNode<'_>| {
            node.fields.iter().all(|field| known.fields.iter().any(|own| own.name == field.name))
        };
        let fields = match (own, block) {
            // A node may be called `scene`, too; what only the block can have is the block's.
            (Some(own), Some(block)) => {
                if has(own) {
                    &mut own.fields
                } else {
                    block
                }
            }
            (Some(own), None) => &mut own.fields,
            (None, Some(block)) => block,
            (None, None) => {
                let mistake =
                    Diagnostic::new(node.id_span.clone(), format!("no node is named `{}`", shown(node.id)));
                let near = nearest(node.id, document.nodes.iter().map(|known| known.id));
                diagnostics.push(match near {
                    Some(near) => mistake.hint(format!("did you mean `{near}`?")),
                    None => mistake,
                });
                continue;
            }
        };
        for field in node.fields {
            match fields.iter_mut().find(|known| known.name == field.name) {
                Some(known) => *known = field,
                None => fields.push(field),
            }
        }
    }
}
