//! From RON text to nodes and fields, each with its place in the text.
//!
//! A scan finds the structure, `ron` reads the values. The engine so needs no knowledge of kinds here, sees
//! duplicates, and can report all mistakes together.

use std::borrow::Cow;
use std::ops::Range;

use ron::extensions::Extensions;

use crate::diag::{Code, Diagnostic, shown};
use crate::param::ParamType;
use crate::scan::Scanner;
use crate::subgraph::Scope;

/// `name: text`, as it stands in the file.
#[derive(Debug, Clone)]
pub(crate) struct RawField<'t> {
    pub name: &'t str,
    pub name_span: Range<usize>,
    pub text: &'t str,
    pub span: Range<usize>,
    /// Where the names in the text are looked for, by its place in [`Document::scopes`].
    pub scope: usize,
}

impl<'t> RawField<'t> {
    /// A value that stands in no file.
    pub fn plain(name: &'t str, text: &'t str) -> Self {
        Self { name, name_span: 0..0, text, span: 0..0, scope: 0 }
    }
}

/// `id: Kind(fields)`.
#[derive(Debug, Clone)]
pub(crate) struct RawNode<'t> {
    /// Its name in the whole graph: in a subgraph behind the names of those around it.
    pub id: Cow<'t, str>,
    pub id_span: Range<usize>,
    pub kind: &'t str,
    pub kind_span: Range<usize>,
    /// The kind and the fields.
    pub span: Range<usize>,
    pub fields: Vec<RawField<'t>>,
    /// The subgraph it is a node of, by its place in [`Document::scopes`].
    pub scope: usize,
}

/// The `scene` block.
#[derive(Debug, Clone)]
pub(crate) struct RawScene<'t> {
    pub span: Range<usize>,
    pub fields: Vec<RawField<'t>>,
}

/// A whole graph file, unchecked.
#[derive(Debug, Default, Clone)]
pub(crate) struct Document<'t> {
    pub version: Option<RawField<'t>>,
    pub scene: Option<RawScene<'t>>,
    /// What stands in `axes`.
    pub axes: Vec<RawField<'t>>,
    /// What its fields read by `Param("name")`, with the values where nothing else is given.
    pub parameters: Vec<RawField<'t>>,
    /// The files whose nodes are part of the graph.
    pub include: Option<RawField<'t>>,
    /// Named overlays, unread.
    pub presets: Vec<RawField<'t>>,
    pub nodes: Vec<RawNode<'t>>,
    /// Where names are looked for: the graph itself, then each use of a subgraph.
    pub scopes: Vec<Scope<'t>>,
    /// Names of nodes whose text could not be read, so that wires to them are no second mistake.
    pub broken: Vec<Cow<'t, str>>,
    /// False where something may be missing only because it could not be read.
    pub whole: bool,
}

const TOP: [&str; 7] = ["version", "include", "parameters", "scene", "axes", "presets", "nodes"];

/// What a text is to be read as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sort {
    /// `Graph(..)`.
    Graph,
    /// `Overlay(..)`, whose nodes need not say their kind.
    Overlay,
}

/// Finds the structure of one file, which is the named part of the text. What cannot be read is reported and
/// left out.
pub(crate) fn parse_part<'t>(
    text: &'t str,
    part: Range<usize>,
    sort: Sort,
    diagnostics: &mut Vec<Diagnostic>,
) -> Document<'t> {
    Parser::read(text, part, sort, diagnostics, Parser::graph)
}

/// Reads `(trace: (samples: 4), ..)`, which is the named part of the text.
pub(crate) fn parse_preset<'t>(
    text: &'t str,
    part: Range<usize>,
    diagnostics: &mut Vec<Diagnostic>,
) -> Document<'t> {
    Parser::read(text, part, Sort::Overlay, diagnostics, |parser| {
        let start = parser.scan.at;
        parser.nodes(start..start + 1);
    })
}

/// Reads `trace.samples=4`, which is the named part of the text.
pub(crate) fn parse_setting<'t>(
    text: &'t str,
    part: Range<usize>,
    diagnostics: &mut Vec<Diagnostic>,
) -> Document<'t> {
    Parser::read(text, part, Sort::Overlay, diagnostics, Parser::setting)
}

struct Parser<'t> {
    scan: Scanner<'t>,
    document: Document<'t>,
    sort: Sort,
    /// A node was found outside of `nodes`.
    stray: bool,
}

impl<'t> Parser<'t> {
    fn read(
        text: &'t str,
        part: Range<usize>,
        sort: Sort,
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
        // `#![enable(..)]` names extensions of RON; the one we need is always on.
        while self.scan.eat(b'#') {
            self.scan.eat(b'!');
            self.scan.value();
            self.scan.skip_space();
        }
        let start = self.scan.at;
        let name = self.scan.word();
        self.scan.skip_space();
        let wanted = if self.sort == Sort::Graph { "Graph" } else { "Overlay" };
        if name != Some(wanted) || self.scan.peek() != b'(' {
            let file = if self.sort == Sort::Graph { "a graph file" } else { "an overlay" };
            let what = format!("{file} begins with `{wanted}(`");
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
                // Laid over, all blocks are alike.
                "scene" | "axes" | "parameters" if parser.sort == Sort::Overlay => {
                    parser.add_node(name, span);
                }
                "scene" => parser.scene(span),
                "axes" => parser.axes(span),
                "parameters" => {
                    let how = "`parameters` is written `parameters: (yaw_deg: 0.0, object: Required)`";
                    parser.document.parameters = parser.block(span, how).unwrap_or_default();
                }
                "include" if parser.sort == Sort::Graph => parser.document.include = parser.value(name, span),
                "presets" if parser.sort == Sort::Graph => {
                    let how = "`presets` is written `presets: (draft: (trace: (samples: 4)))`";
                    parser.document.presets = parser.block(span, how).unwrap_or_default();
                }
                "nodes" => parser.nodes(span),
                // A parenthesis too many ends `nodes` early, and every node after it would be a mistake.
                other if parser.scan.peek().is_ascii_uppercase() => {
                    if !std::mem::replace(&mut parser.stray, true) {
                        parser.scan.report(
                            Diagnostic::new(
                                span.clone(),
                                format!("`{}` stands outside of `nodes`", shown(other)),
                            )
                            .hint("a `)` too many stands before it, or `nodes: (` is missing"),
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
                Diagnostic::new(rest, "nothing may follow the graph")
                    .hint("if more nodes were to follow, a `)` too many stands before them"),
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
            self.scan.report(Diagnostic::of(Code::Setting, rest, "nothing may follow the value"));
        }
        let (kind_span, span) = (id_span.clone(), start..self.scan.at);
        let node = RawNode { id: id.into(), id_span, kind: "", kind_span, span, fields, scope: 0 };
        self.document.nodes.push(node);
    }

    /// Walks over `(name: .., name: ..)`; `each` reads one value. The current place is the parenthesis.
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
                        .hint("names are plain words: letters, digits and `_`, the first no digit"),
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

    /// In an overlay, a name goes on to those inside of a subgraph: `left.pose`.
    fn nested(&mut self, name: &'t str, start: usize) -> &'t str {
        while self.sort == Sort::Overlay && self.scan.eat(b'.') {
            self.scan.word();
        }
        self.scan.text.get(start..self.scan.at).unwrap_or(name)
    }

    /// Goes on with what looks like the next field: a name and a colon, or what follows a comma.
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
            // What was reported already needs no second report from whoever reads the value.
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

    /// `(name: value, ..)`, each name once; `how` is said where it is none.
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

    fn node(&mut self, id: &'t str, id_span: Range<usize>) -> Option<RawNode<'t>> {
        let start = self.scan.at;
        let bare = self.sort == Sort::Overlay && self.scan.peek() == b'(';
        let Some(mut kind) = (if bare { Some("") } else { self.scan.word() }) else {
            let what = format!("`{}` is not a node", shown(id));
            self.scan.report(Diagnostic::new(id_span, what).label("expected `name: Kind(field: value, ..)`"));
            self.scan.value();
            return None;
        };
        // The kebab-case name of a kind is no RON, but clear.
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
                    Diagnostic::of(
                        Code::Missing,
                        self.node_span.clone(),
                        format!("`{}` needs `{name}`", self.kind),
                    )
                    .label(format!("expected {}", with_article(&T::describe()))),
                );
            }
            return default;
        };
        let between = |(low, high): (f64, f64)| format!("must lie between {low} and {high}");
        let value = match parse_value::<T>(field.text) {
            Ok(value) => value,
            Err(error) => {
                let (span, range) = (field.span.clone(), range.map(between));
                self.diagnostics.push(value_mistake::<T>(name, field.text, &error, span, range));
                return None;
            }
        };
        if let Err(error) = value.key_text() {
            let message = format!("`{name}`: {error}");
            self.diagnostics.push(Diagnostic::of(Code::WrongValue, field.span.clone(), message));
            return None;
        }
        match range {
            Some((low, high)) if !value.within(low, high) => {
                let message = format!("`{name}` is out of range: {}", shown(field.text));
                self.diagnostics.push(
                    Diagnostic::of(Code::OutOfRange, field.span.clone(), message).label(between((low, high))),
                );
                None
            }
            _ => Some(value),
        }
    }
}

fn options() -> ron::Options {
    ron::Options::default().with_default_extension(Extensions::IMPLICIT_SOME)
}

/// One value of a known type.
pub(crate) fn parse_value<'t, T: serde::Deserialize<'t>>(text: &'t str) -> Result<T, ron::Error> {
    options().from_str(text).map_err(|error| error.code)
}

/// What a person would call a value of this text.
pub(crate) fn sort_of(text: &str) -> &'static str {
    match text.bytes().next().unwrap_or_default() {
        b'"' => "text",
        b'\'' => "a letter",
        b'[' => "a list",
        b'(' => "a group in ( )",
        b'{' => "a group in { }",
        b'+' | b'-' | b'.' | b'0'..=b'9' => "a number",
        _ if matches!(text, "true" | "false") => "true or false",
        _ => "a word",
    }
}

/// `a number`, `an integer`; what is no plain noun stays as it is.
fn with_article(described: &str) -> String {
    let article = match described.bytes().next() {
        Some(b'a' | b'e' | b'i' | b'o' | b'u') => "an ",
        Some(b'a'..=b'z') if !described.starts_with("text") && !described.contains(" | ") => "a ",
        _ => "",
    };
    format!("{article}{described}")
}

/// What is wrong inside of a group or list of numbers that is right from outside: their count, or one of them.
fn wrong_items(described: &str, text: &str) -> Option<String> {
    let (numbers, sort) = (described.contains("number"), sort_of(text));
    let wanted: Option<usize> =
        described.split_once(" numbers in ( )").and_then(|(count, _)| count.parse().ok());
    if !numbers || sort != if wanted.is_some() { "a group in ( )" } else { "a list" } {
        return None;
    }
    let mut scan = Scanner::new(&text[..text.len() - 1]);
    scan.at = 1;
    let mut items = Vec::new();
    loop {
        scan.skip_space();
        if scan.is_at_end() {
            break;
        }
        items.push(&scan.text[scan.value()?]);
        scan.skip_space();
        if !scan.eat(b',') && !scan.is_at_end() {
            return None;
        }
    }
    if let Some(item) = items.iter().find(|item| parse_value::<f64>(item).is_err()) {
        return Some(format!("and `{}` is none", shown(item)));
    }
    let wanted = wanted.filter(|wanted| *wanted != items.len())?;
    Some(match items.len() {
        0 => "not none".to_owned(),
        found if found < wanted => format!("not only {found}"),
        found => format!("not {found}"),
    })
}

/// What is wrong with the text of a parameter. `range` is what is said where it has one.
fn value_mistake<T: ParamType>(
    name: &str,
    text: &str,
    error: &ron::Error,
    span: Range<usize>,
    range: Option<String>,
) -> Diagnostic {
    let described = T::describe();
    let described = described.strip_suffix(" (optional)").unwrap_or(&described);
    let wanted = with_article(described);
    let mistake = |message: String| Diagnostic::of(Code::WrongValue, span.clone(), message);
    match error {
        ron::Error::NoSuchEnumVariant { found, expected, .. } => {
            mistake(format!("`{name}` has no choice `{}`", shown(found)))
                .label(format!("one of {wanted}"))
                .suggest(found, expected.iter().copied())
        }
        ron::Error::NoSuchStructField { found, expected, .. } => {
            mistake(format!("`{name}` has no field `{}`", shown(found)))
                .suggest(found, expected.iter().copied())
                .hint(format!("it has {}", expected.join(", ")))
        }
        ron::Error::MissingStructField { field, .. } => {
            mistake(format!("`{name}` needs `{field}`")).label(format!("expected {wanted}"))
        }
        ron::Error::ExceededRecursionLimit => {
            mistake(format!("`{name}` has too many brackets in each other"))
        }
        ron::Error::Message(why) => mistake(format!("`{name}`: {why}")).label(format!("expected {wanted}")),
        ron::Error::IntegerOutOfBounds => mistake(format!("`{name}` is out of range: {}", shown(text)))
            .label(range.unwrap_or_else(|| format!("expected {wanted}"))),
        _ if let Some(what) = wrong_items(described, text) => {
            mistake(format!("`{name}` takes {wanted}, {what}"))
        }
        _ => {
            let sort = sort_of(text);
            let is_number = sort == "a number";
            let found = if is_number { shown(text) } else { sort.into() };
            let mistake = mistake(format!("`{name}` takes {wanted}, not {found}"));
            let inner = text.trim_matches('"');
            let whole = text.parse().ok().filter(|n: &f64| n.fract() == 0.0 && (0.0..1e15).contains(n));
            match (sort, whole) {
                ("a number", Some(whole)) => mistake.label(format!("write {whole}")),
                ("text", _) if inner.parse::<f64>().is_ok() || described.split(" | ").any(|c| c == inner) => {
                    mistake.label(format!("write {inner} without quotes"))
                }
                ("a word", _) if described.starts_with("text") || described.starts_with("path") => {
                    mistake.label(format!("write \"{}\"", shown(text)))
                }
                _ => mistake,
            }
        }
    }
}
