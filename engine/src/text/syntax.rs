//! The parser of RON text into nodes and fields with their byte ranges.
//!
//! The scanner finds the structure, and `ron` parses the values later. The parser therefore does not need the
//! kinds. It detects duplicates, and reports all mistakes together.

use std::ops::Range;

use crate::text::diag::{Code, Diagnostic, shown};
use crate::text::document::{Document, RawField, RawNode, RawScene};
use crate::text::scan::Scanner;

const TOP: [&str; 7] = ["version", "include", "parameters", "scene", "axes", "presets", "nodes"];

/// The expected content of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FileKind {
    /// `Graph(..)`.
    Graph,
    /// `Overlay(..)`, whose nodes may omit their kind.
    Overlay,
}

/// Parses one file, which is the given range of the text. Fields with mistakes are reported and omitted.
pub(crate) fn parse_part<'t>(
    text: &'t str,
    part: Range<usize>,
    sort: FileKind,
    diagnostics: &mut Vec<Diagnostic>,
) -> Document<'t> {
    Parser::read(text, part, sort, diagnostics, Parser::graph)
}

/// Parses `(trace: (samples: 4), ..)` in the given range of the text.
pub(crate) fn parse_preset<'t>(
    text: &'t str,
    part: Range<usize>,
    diagnostics: &mut Vec<Diagnostic>,
) -> Document<'t> {
    Parser::read(text, part, FileKind::Overlay, diagnostics, |parser| {
        let start = parser.scan.at;
        parser.nodes(start..start + 1);
    })
}

/// Parses `trace.samples=4` in the given range of the text.
pub(crate) fn parse_setting<'t>(
    text: &'t str,
    part: Range<usize>,
    diagnostics: &mut Vec<Diagnostic>,
) -> Document<'t> {
    Parser::read(text, part, FileKind::Overlay, diagnostics, Parser::setting)
}

/// Parses `name: Kind(..)` in the given range of the text; `None` if it is anything else.
pub(crate) fn parse_node(text: &str, part: Range<usize>) -> Option<RawNode<'_>> {
    let (end, mut mistakes) = (part.end, Vec::new());
    let mut document = Parser::read(text, part, FileKind::Graph, &mut mistakes, |parser| {
        let start = parser.scan.at;
        let Some(name) = parser.scan.word() else { return };
        let span = start..parser.scan.at;
        parser.scan.skip_space();
        if parser.scan.eat(b':') {
            parser.scan.skip_space();
            parser.add_node(name, span);
        }
    });
    // Any other ending might continue after the range.
    let node = document.nodes.pop().filter(|node| node.span.end == end && text[..end].ends_with(')'))?;
    (mistakes.is_empty() && document.broken.is_empty()).then_some(node)
}

struct Parser<'t> {
    scan: Scanner<'t>,
    document: Document<'t>,
    sort: FileKind,
    /// True if a node was found outside `nodes`.
    stray: bool,
}

impl<'t> Parser<'t> {
    fn read(
        text: &'t str,
        part: Range<usize>,
        sort: FileKind,
        diagnostics: &mut Vec<Diagnostic>,
        read: impl FnOnce(&mut Self),
    ) -> Document<'t> {
        let mut scan = Scanner::new(&text[..part.end]);
        scan.at = part.start;
        let mut parser = Parser { scan, document: Document::default(), sort, stray: false };
        read(&mut parser);
        parser.document.whole = parser.scan.diagnostics.is_empty();
        diagnostics.append(&mut parser.scan.diagnostics);
        parser.document
    }

    fn graph(&mut self) {
        self.scan.skip_space();
        // `#![enable(..)]` enables RON extensions; the one that is needed is always enabled.
        while self.scan.eat(b'#') {
            self.scan.eat(b'!');
            self.scan.value();
            self.scan.skip_space();
        }
        let start = self.scan.at;
        let name = self.scan.word();
        self.scan.skip_space();
        let wanted = if self.sort == FileKind::Graph { "Graph" } else { "Overlay" };
        if name != Some(wanted) || self.scan.peek() != b'(' {
            let file = if self.sort == FileKind::Graph { "a graph file" } else { "an overlay" };
            let what = format!("{file} must begin with `{wanted}(`");
            return self.scan.report(Diagnostic::new(start..self.scan.at.max(start), what));
        }
        let mut seen: Vec<(&str, Range<usize>)> = Vec::new();
        self.fields(|parser, name, span| {
            if let Some((_, first)) = seen.iter().find(|(known, _)| *known == name) {
                parser.scan.report(twice(name, span, first.clone()));
                parser.scan.value();
                return;
            }
            seen.push((name, span.clone()));
            match name {
                "version" => parser.document.version = parser.value(name, span),
                // In an overlay, all blocks have the same form.
                "scene" | "axes" | "parameters" if parser.sort == FileKind::Overlay => {
                    parser.add_block(name, span);
                }
                "scene" => parser.scene(span),
                "axes" => parser.axes(span),
                "parameters" => {
                    let how = "`parameters` is written `parameters: (yaw_deg: 0.0, object: Required)`";
                    parser.document.parameters = parser.block(span, how).unwrap_or_default();
                }
                "include" if parser.sort == FileKind::Graph => {
                    parser.document.include = parser.value(name, span);
                }
                "presets" if parser.sort == FileKind::Graph => {
                    let how = "`presets` is written `presets: (draft: (trace: (samples: 4)))`";
                    parser.document.presets = parser.block(span, how).unwrap_or_default();
                }
                "nodes" => parser.nodes(span),
                // A surplus `)` ends `nodes` early; without this, every following node would be reported.
                other if parser.scan.peek().is_ascii_uppercase() => {
                    if !std::mem::replace(&mut parser.stray, true) {
                        parser.scan.report(
                            Diagnostic::new(span.clone(), format!("`{}` is outside `nodes`", shown(other)))
                                .hint("there is a surplus `)` before it, or `nodes: (` is missing"),
                        );
                    }
                    parser.add_node(other, span);
                }
                other => {
                    parser.scan.report(
                        Diagnostic::of(
                            Code::UnknownField,
                            span,
                            format!("a graph has no field `{}`", shown(other)),
                        )
                        .suggest(other, TOP)
                        .hint(format!(
                            "a graph has the fields {}",
                            TOP.map(|name| format!("`{name}`")).join(", ")
                        )),
                    );
                    parser.scan.value();
                }
            }
        });
        self.scan.skip_space();
        if !self.scan.is_at_end() && !self.stray {
            let rest = self.scan.at..self.scan.text.trim_end().len().max(self.scan.at);
            self.scan.report(
                Diagnostic::new(rest, "unexpected text after the graph")
                    .hint("if these are nodes, there is a surplus `)` before them"),
            );
        }
    }

    fn setting(&mut self) {
        let start = self.scan.at;
        let rest = &self.scan.text[start..];
        let Some((place, (id, name))) =
            rest.split_once('=').and_then(|(place, _)| Some((place, place.rsplit_once('.')?)))
        else {
            return self
                .scan
                .report(Diagnostic::new(start..start, "a setting is written `node.field=value`"));
        };
        let (id_span, equals) = (start..start + id.len(), start + place.len());
        self.scan.at = equals + 1;
        let fields = self.value(name, id_span.end + 1..equals).into_iter().collect();
        if !self.scan.is_at_end() {
            let rest = self.scan.at..self.scan.text.len();
            self.scan.report(Diagnostic::of(Code::Setting, rest, "unexpected text after the value"));
        }
        let (kind_span, span) = (id_span.clone(), start..self.scan.at);
        let node = RawNode { id: id.into(), id_span, kind: "", kind_span, span, fields, scope: 0 };
        self.document.nodes.push(node);
    }

    /// Parses `(name: .., name: ..)` at the current position. `each` is called to parse each value.
    fn fields(&mut self, each: impl FnMut(&mut Self, &'t str, Range<usize>)) {
        let open = self.scan.at;
        self.scan.at += 1;
        self.fields_inside(open, each);
    }

    fn fields_inside(&mut self, open: usize, mut each: impl FnMut(&mut Self, &'t str, Range<usize>)) {
        loop {
            self.scan.skip_space();
            if self.scan.eat(b')') {
                return;
            }
            if self.scan.is_at_end() {
                return self.scan.unclosed(open, b'(');
            }
            let start = self.scan.at;
            let Some(name) = self.scan.word() else {
                self.scan.report(
                    Diagnostic::new(self.scan.here(), "expected `name: value`")
                        .hint("names consist of letters, digits and `_`, and do not begin with a digit"),
                );
                self.after_mistake();
                continue;
            };
            let name = self.nested(name, start);
            let span = start..self.scan.at;
            self.scan.skip_space();
            if !self.scan.eat(b':') {
                self.document.broken.push(name.into());
                self.scan.report(
                    Diagnostic::new(span, format!("`{}` has no value", shown(name)))
                        .label("expected `name: value`"),
                );
                self.after_mistake();
                continue;
            }
            self.scan.skip_space();
            each(self, name, span);
            let end = self.scan.at;
            self.scan.skip_space();
            if !self.scan.eat(b',') && self.scan.peek() != b')' && !self.scan.is_at_end() {
                let last = self.scan.text[..end].trim_end().len();
                self.scan.report(
                    Diagnostic::new(last..last + 1, "expected a comma here")
                        .hint("fields and nodes are separated by commas"),
                );
                self.after_mistake();
            }
        }
    }

    /// Reads the rest of a dotted name: in an overlay, a name may refer to a node in a subgraph (`left.pose`).
    fn nested(&mut self, name: &'t str, start: usize) -> &'t str {
        while self.sort == FileKind::Overlay && self.scan.eat(b'.') {
            self.scan.word();
        }
        self.scan.text.get(start..self.scan.at).unwrap_or(name)
    }

    /// Skips to the probable start of the next field. This is an identifier with a colon, or any text after a
    /// comma.
    fn after_mistake(&mut self) {
        loop {
            self.scan.skip_space();
            let place = self.scan.at;
            if self.scan.word().is_some() {
                self.scan.skip_space();
                if self.scan.peek() == b':' {
                    return self.scan.at = place;
                }
                self.scan.at = place;
            }
            match self.scan.peek() {
                b')' => return,
                b',' => return self.scan.at += 1,
                _ if self.scan.is_at_end() => return,
                _ => self.scan.step_over(),
            }
        }
    }

    fn value(&mut self, name: &'t str, name_span: Range<usize>) -> Option<RawField<'t>> {
        let before = self.scan.diagnostics.len();
        match self.scan.value() {
            // A mistake that was reported already is not reported again by the reader of the value.
            Some(_) if self.scan.diagnostics.len() > before => None,
            Some(span) => {
                Some(RawField { name, name_span, text: &self.scan.text[span.clone()], span, scope: 0 })
            }
            None => {
                let what = format!("`{}` has no value", shown(name));
                self.scan.report(Diagnostic::new(name_span, what).label("expected `name: value`"));
                None
            }
        }
    }

    fn scene(&mut self, name_span: Range<usize>) {
        let start = self.scan.at;
        if let Some(fields) = self.block(name_span, "`scene` is written `scene: (up: \"+z\")`") {
            let span = start..self.scan.at;
            self.document.scene = Some(RawScene { span, fields });
        }
    }

    fn axes(&mut self, name_span: Range<usize>) {
        let how = "`axes` is written `axes: (frame: Range(0, 12), yaw: List([0.0, 15.0]))`";
        self.document.axes = self.block(name_span, how).unwrap_or_default();
    }

    /// Parses `(name: value, ..)` with distinct names. `how` is the hint that is given if the text has another
    /// form.
    fn block(&mut self, name_span: Range<usize>, how: &str) -> Option<Vec<RawField<'t>>> {
        if self.scan.peek() != b'(' {
            self.scan.report(Diagnostic::new(name_span, how));
            self.scan.value();
            return None;
        }
        let mut fields: Vec<RawField<'t>> = Vec::new();
        self.fields(|parser, name, span| {
            if let Some(first) = fields.iter().find(|field| field.name == name) {
                parser.scan.report(twice(name, span.clone(), first.name_span.clone()));
            }
            fields.extend(parser.value(name, span));
        });
        Some(fields)
    }

    fn nodes(&mut self, name_span: Range<usize>) {
        if self.scan.peek() != b'(' {
            let open = name_span.start;
            self.scan.report(Diagnostic::new(name_span, "`nodes` is written `nodes: (name: Kind(..), ..)`"));
            let start = self.scan.at;
            self.scan.value();
            self.scan.skip_space();
            if self.scan.peek() == b':' {
                // Only the parenthesis is missing.
                self.scan.at = start;
                self.fields_inside(open, Self::add_node);
            }
            return;
        }
        self.fields(Self::add_node);
    }

    fn add_node(&mut self, id: &'t str, id_span: Range<usize>) {
        let before = self.scan.diagnostics.len();
        match self.node(id, id_span) {
            Some(node) if self.scan.diagnostics.len() == before => self.document.nodes.push(node),
            _ => self.document.broken.push(id.into()),
        }
    }

    fn add_block(&mut self, name: &'t str, span: Range<usize>) {
        let before = self.scan.diagnostics.len();
        let block = self.node(name, span).filter(|_| self.scan.diagnostics.len() == before);
        self.document.blocks.extend(block);
    }

    fn node(&mut self, id: &'t str, id_span: Range<usize>) -> Option<RawNode<'t>> {
        let start = self.scan.at;
        let bare = self.sort == FileKind::Overlay && self.scan.peek() == b'(';
        let Some(mut kind) = (if bare { Some("") } else { self.scan.word() }) else {
            let what = format!("`{}` is not a node", shown(id));
            self.scan.report(Diagnostic::new(id_span, what).label("expected `name: Kind(field: value, ..)`"));
            self.scan.value();
            return None;
        };
        // The kebab-case name of a kind is not valid RON, but its meaning is clear.
        while self.scan.eat(b'-') {
            self.scan.word();
            kind = &self.scan.text[start..self.scan.at];
        }
        let kind_span = start..self.scan.at;
        self.scan.skip_space();
        let mut fields = Vec::new();
        if self.scan.peek() == b'(' {
            self.fields(|parser, name, span| fields.extend(parser.value(name, span)));
        } else {
            self.scan.at = kind_span.end;
        }
        let span = start..self.scan.at;
        Some(RawNode { id: id.into(), id_span, kind, kind_span, span, fields, scope: 0 })
    }
}

pub(crate) fn twice(name: &str, second: Range<usize>, first: Range<usize>) -> Diagnostic {
    Diagnostic::of(Code::Duplicate, second, format!("`{}` is given twice", shown(name)))
        .label("second")
        .related(first, "first")
}
