//! Subgraphs: the nodes of a file, as often as it is used, each time with other values.
//!
//! A file states what it is given, `parameters: (object: Required, yaw_deg: 0.0)`, and reads it by
//! `Param("object")`. `left: Subgraph(graph: "chair.ron", object: "demo.object")` makes the file's nodes nodes
//! of the graph, named `left.pose` and so on. What is given means what it means where it is written: wires lead
//! to nodes around `left`, paths begin at the folder of that file. So does every mistake.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;

use crate::text::diag::{Code, Diagnostic, nearest, shown};
use crate::text::document::{Document, RawField, RawNode, Scope};
use crate::text::overlay::Overlays;
use crate::text::scan::Scanner;
use crate::text::source::plain;
use crate::text::syntax::twice;
use crate::text::values::parse_value;

/// The kind that stands for the nodes of a file.
pub(crate) const SUBGRAPH: &str = "Subgraph";
/// The field of it that names the file.
pub(crate) const FILE: &str = "graph";
/// What stands for the value of a parameter that must be given.
const REQUIRED: &str = "Required";

/// There are no more uses than this, all together hold no more nodes, and they lie in each other no deeper.
const MOST_USES: usize = 100_000;
const MOST_NODES: usize = 1_000_000;
const DEEPEST: usize = 32;
/// The longest text of a field once values stand in their places, in bytes.
const LONGEST: usize = 1 << 18;

/// Files that are used as subgraphs, by the names under which pieces of the text know them.
pub(crate) type SubgraphFiles<'t> = BTreeMap<&'t str, Document<'t>>;

/// Says of a file that is named at a place why there is no text of it.
type Lost<'l> = dyn Fn(&str, Range<usize>) -> Diagnostic + 'l;

/// Puts the nodes of its file in place of each `Subgraph`, and overlays on all nodes. `folder_at` gives the folder
/// of the file that a place of the text lies in.
pub(crate) fn expand<'t>(
    document: &mut Document<'t>,
    files: &SubgraphFiles<'t>,
    mut overlays: Overlays<'t>,
    folder_at: &dyn Fn(usize) -> &'t str,
    lost: &Lost<'_>,
    diagnostics: &mut Vec<Diagnostic>,
) {
    overlays.lay_on_blocks(document, diagnostics);
    let values = document.parameters.iter();
    for field in values.clone().filter(|field| field.text == REQUIRED) {
        let what = format!("the graph needs `{}`", shown(field.name));
        diagnostics.push(Diagnostic::of(Code::Missing, field.name_span.clone(), what).hint(format!(
            "give it by `--set parameters.{}=..`, or use this file as a `Subgraph`",
            field.name
        )));
    }
    let values = values.cloned().collect();
    document.scopes = vec![Scope { values, ..Scope::default() }];
    // Those that come first in the file are at the end.
    let mut open: Vec<RawNode<'t>> = std::mem::take(&mut document.nodes).into_iter().rev().collect();
    while let Some(mut node) = open.pop() {
        overlays.lay_on(&mut node);
        if node.kind != SUBGRAPH {
            document.nodes.push(node);
            continue;
        }
        let used = use_of(&node, &document.scopes, files, folder_at, lost);
        let (file, scope) = match used {
            Ok((file, scope, mut mistakes)) => {
                diagnostics.append(&mut mistakes);
                (file, scope)
            }
            Err(mistake) => {
                diagnostics.push(*mistake);
                document.broken.push(node.id);
                continue;
            }
        };
        let nodes = document.nodes.len() + open.len() + file.nodes.len();
        if nodes > MOST_NODES || document.scopes.len() > MOST_USES {
            let what =
                format!("subgraphs make more than {MOST_NODES} nodes of the graph, or are {MOST_USES}");
            return diagnostics.push(Diagnostic::new(node.id_span, what).label("this one is one too many"));
        }
        let number = document.scopes.len();
        let inside = |inner: &RawNode<'t>| {
            let mut inner = RawNode { id: format!("{}{}", scope.prefix, inner.id).into(), ..inner.clone() };
            inner.scope = number;
            inner.fields.iter_mut().for_each(|field| field.scope = number);
            inner
        };
        open.extend(file.nodes.iter().rev().map(inside));
        // What the file runs along, the graph does, unless it has an axis of that name itself.
        let known = |axis: &RawField<'t>| document.axes.iter().any(|own| own.name == axis.name);
        let axes: Vec<RawField<'t>> = file.axes.iter().filter(|axis| !known(axis)).cloned().collect();
        document.axes.extend(axes);
        let broken = file.broken.iter().map(|name| format!("{}{name}", scope.prefix).into());
        document.broken.extend(broken);
        document.scopes.push(scope);
    }
    overlays.strangers(document, diagnostics);
}

type Used<'f, 't> = (&'f Document<'t>, Scope<'t>, Vec<Diagnostic>);

/// What a `Subgraph` stands for, and what is wrong with the values it is given.
fn use_of<'f, 't>(
    node: &RawNode<'t>,
    scopes: &[Scope<'t>],
    files: &'f SubgraphFiles<'t>,
    folder_at: &dyn Fn(usize) -> &'t str,
    lost: &Lost<'_>,
) -> Result<Used<'f, 't>, Box<Diagnostic>> {
    let Some(field) = node.fields.iter().find(|field| field.name == FILE) else {
        let what = format!("`{SUBGRAPH}` needs `{FILE}`");
        let how = "the file whose nodes it stands for: graph: \"chair.ron\"";
        return Err(Diagnostic::of(Code::Missing, node.kind_span.clone(), what).label(how).into());
    };
    let Ok(path) = parse_value::<String>(field.text) else {
        let what = format!("`{FILE}` takes the path of a graph file, not {}", shown(field.text));
        return Err(Diagnostic::of(Code::WrongValue, field.span.clone(), what).into());
    };
    let name = plain(folder_at(field.span.start), &path);
    let Some((&file, document)) = files.get_key_value(name.as_str()) else {
        return Err(lost(&name, field.span.clone()).into());
    };
    let mut around = &scopes[node.scope];
    let depth = around.depth + 1;
    while around.file != file {
        match &around.used {
            Some((_, outer)) if depth <= DEEPEST => around = &scopes[*outer],
            Some(_) => {
                let what = format!("subgraphs lie in each other more than {DEEPEST} deep");
                return Err(Diagnostic::new(field.span.clone(), what).into());
            }
            None => return Ok(fill(node, file, document, depth)),
        }
    }
    Err(Diagnostic::of(Code::Cycle, field.span.clone(), format!("`{}` uses itself", shown(file))).into())
}

/// The values of a use: those given, and the file's own for the rest.
fn fill<'f, 't>(node: &RawNode<'t>, file: &'t str, document: &'f Document<'t>, depth: usize) -> Used<'f, 't> {
    let mut mistakes = Vec::new();
    let known = || document.parameters.iter().map(|parameter| parameter.name);
    let mut given: Vec<&RawField<'t>> = Vec::new();
    for field in node.fields.iter().filter(|field| field.name != FILE) {
        if let Some(first) = given.iter().find(|first| first.name == field.name) {
            mistakes.push(twice(field.name, field.name_span.clone(), first.name_span.clone()));
        } else if !known().any(|name| name == field.name) {
            let what = format!("`{}` has no parameter `{}`", shown(file), shown(field.name));
            let list: Vec<&str> = known().collect();
            let hint = if list.is_empty() {
                "it states none; `parameters: (yaw_deg: 0.0)` stands beside its `nodes`".to_owned()
            } else {
                format!("it has {}", list.join(", "))
            };
            let mistake = Diagnostic::of(Code::UnknownField, field.name_span.clone(), what);
            mistakes.push(mistake.suggest(field.name, known()).hint(hint));
        }
        given.push(field);
    }
    let mut values = Vec::with_capacity(document.parameters.len());
    for own in &document.parameters {
        match given.iter().find(|field| field.name == own.name) {
            Some(field) => values.push((*field).clone()),
            None if own.text == REQUIRED => mistakes.push(
                Diagnostic::of(
                    Code::Missing,
                    node.kind_span.clone(),
                    format!("`{}` needs `{}`", shown(file), own.name),
                )
                .related(own.name_span.clone(), "required here"),
            ),
            None => values.push(own.clone()),
        }
    }
    let prefix = format!("{}.", node.id);
    let used = Some((node.id_span.clone(), node.scope));
    (document, Scope { prefix, file, values, used, depth }, mistakes)
}

/// What a text names by `Param("name")`; `None` for anything else.
pub(crate) fn parameter_read<'t>(text: &'t str) -> Option<Cow<'t, str>> {
    let inside = text.strip_prefix("Param")?.trim_start().strip_prefix('(')?.strip_suffix(')')?;
    let name = inside.trim().trim_end_matches(',').trim_end();
    match name.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')) {
        Some(plain) if !plain.contains(['\\', '"']) => Some(Cow::Borrowed(plain)),
        _ => parse_value::<String>(name).ok().map(Cow::Owned),
    }
}

/// What is given for the parameter that `text`, which lies at `place` of a field, names.
pub(crate) fn value_of<'s, 't>(
    scopes: &'s [Scope<'t>],
    scope: usize,
    text: &str,
    place: Range<usize>,
) -> Result<&'s RawField<'t>, Diagnostic> {
    let Some(name) = parameter_read(text) else {
        let what = format!("`{}` is not how a parameter is read", shown(text));
        return Err(Diagnostic::new(place, what).hint("write `Param(\"yaw_deg\")`"));
    };
    let Scope { values, file, .. } = &scopes[scope];
    values.iter().find(|value| value.name == name).ok_or_else(|| {
        let file = if file.is_empty() { "the graph" } else { file };
        let mistake = Diagnostic::of(
            Code::UnknownField,
            place,
            format!("{} has no parameter `{}`", shown(file), shown(&name)),
        );
        match nearest(&name, values.iter().map(|value| value.name)) {
            Some(near) => mistake.hint(format!("did you mean `{near}`?")),
            None => mistake.hint("parameters stand beside `nodes`: `parameters: (yaw_deg: 0.0)`"),
        }
    })
}

/// The text of a field with values in place of the parameters that it reads, and where it stands: where the value
/// does, if the field is nothing else. `folder_at` is there for paths, which are then seen from the graph.
pub(crate) fn in_place<'t>(
    field: &RawField<'t>,
    scopes: &[Scope<'t>],
    folder_at: Option<&dyn Fn(usize) -> &'t str>,
) -> Result<(Cow<'t, str>, Range<usize>), Diagnostic> {
    in_place_within(field, scopes, folder_at, 0)
}

fn in_place_within<'t>(
    field: &RawField<'t>,
    scopes: &[Scope<'t>],
    folder_at: Option<&dyn Fn(usize) -> &'t str>,
    depth: usize,
) -> Result<(Cow<'t, str>, Range<usize>), Diagnostic> {
    if depth > 2 * DEEPEST {
        return Err(Diagnostic::new(
            field.span.clone(),
            "the values of parameters read each other in a circle",
        ));
    }
    let folder = folder_at.map_or("", |folder_at| folder_at(field.span.start));
    let calls = calls(field.text, &["Param"]);
    if calls.is_empty() {
        return Ok((moved(folder, field.text), field.span.clone()));
    }
    let mut out = String::new();
    let mut end = 0;
    for span in calls {
        let place = field.span.start + span.start..field.span.start + span.end;
        let value = value_of(scopes, field.scope, &field.text[span.clone()], place)?;
        let (text, place) = in_place_within(value, scopes, folder_at, depth + 1)?;
        if span == (0..field.text.len()) {
            return Ok((text, place));
        }
        out.push_str(&moved(folder, &field.text[end..span.start]));
        out.push_str(&text);
        end = span.end;
        if out.len() > LONGEST {
            return Err(Diagnostic::new(
                field.span.clone(),
                "this gets too long once parameters are in place",
            ));
        }
    }
    out.push_str(&moved(folder, &field.text[end..]));
    Ok((Cow::Owned(out), field.span.clone()))
}

/// Where calls of these names stand in a text; not in quotes, and not in each other.
pub(crate) fn calls(text: &str, names: &[&str]) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    if !names.iter().any(|name| text.contains(name)) {
        return found;
    }
    let mut scan = Scanner::new(text);
    while !scan.is_at_end() {
        scan.skip_space();
        let start = scan.at;
        if scan.peek() == b'"' {
            scan.value();
        } else if let Some(word) = scan.word() {
            scan.skip_space();
            if names.contains(&word) && scan.peek() == b'(' {
                scan.value();
                found.push(start..scan.at);
            }
        } else {
            scan.step();
        }
    }
    found
}

/// Puts the folder in front of every relative path in quotes.
fn moved<'t>(folder: &str, text: &'t str) -> Cow<'t, str> {
    if folder.is_empty() {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + folder.len());
    let mut end = 0;
    for (path, span) in strings(text) {
        if !std::path::Path::new(&path).is_absolute() {
            out.push_str(&text[end..span.start]);
            out.push_str(&format!("{:?}", format!("{folder}{path}")));
            end = span.end;
        }
    }
    out.push_str(&text[end..]);
    Cow::Owned(out)
}

/// Every text in quotes, with its place.
pub(crate) fn strings(text: &str) -> Vec<(String, Range<usize>)> {
    let mut scan = Scanner::new(text);
    let mut found = Vec::new();
    while !scan.is_at_end() {
        let start = scan.at;
        if scan.peek() != b'"' {
            scan.step();
            continue;
        }
        scan.value();
        if let Ok(string) = parse_value::<String>(&text[start..scan.at]) {
            found.push((string, start..scan.at));
        }
    }
    found
}
