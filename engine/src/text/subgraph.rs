//! Subgraphs: the nodes of a file, inserted once per use, each time with other parameter values.
//!
//! A file declares its parameters, `parameters: (object: Required, yaw_deg: 0.0)`, and reads them with
//! `Param("object")`. `left: Subgraph(graph: "chair.ron", object: "demo.object")` inserts the nodes of the file as
//! `left.pose` and so on. A given value is resolved where it is written: wires refer to nodes next to `left`, paths
//! are relative to the folder of the file that contains `left`, and mistakes are reported there.

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

/// The kind that is replaced by the nodes of a file.
pub(crate) const SUBGRAPH: &str = "Subgraph";
/// The field of `Subgraph` that names the file.
pub(crate) const FILE: &str = "graph";
/// The word written for a parameter that has no default and must be given.
const REQUIRED: &str = "Required";

/// Maximum number of uses of subgraphs.
const MOST_USES: usize = 100_000;
/// Maximum number of nodes after all uses are expanded.
const MOST_NODES: usize = 1_000_000;
/// Maximum depth of nested uses.
const DEEPEST: usize = 32;
/// Maximum length of a field after parameters are inserted, in bytes.
const LONGEST: usize = 1 << 18;

/// Parsed documents of the subgraph files, keyed by the name under which the graph refers to each.
pub(crate) type SubgraphFiles<'t> = BTreeMap<&'t str, Document<'t>>;

/// Function that makes the diagnostic for a file that was not read. The arguments are the name of the file, and the
/// byte range of that name.
type Lost<'l> = dyn Fn(&str, Range<usize>) -> Diagnostic + 'l;

/// Replaces each `Subgraph` node with the nodes of its file, and applies overlays to all nodes. `folder_at` maps an
/// offset in the source text to the folder of the file that the text at that offset came from.
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
        let what = format!("the graph needs a value for the parameter `{}`", shown(field.name));
        diagnostics.push(Diagnostic::of(Code::Missing, field.name_span.clone(), what).hint(format!(
            "set it with `--set parameters.{}=..`, or use this file as a `Subgraph`",
            field.name
        )));
    }
    let values = values.cloned().collect();
    document.scopes = vec![Scope { values, ..Scope::default() }];
    // In reverse order, since nodes are taken from the end.
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
            let what = format!(
                "subgraphs expand to more than {MOST_NODES} nodes, or are used more than {MOST_USES} times"
            );
            return diagnostics.push(Diagnostic::new(node.id_span, what).label("exceeded here"));
        }
        let number = document.scopes.len();
        let inside = |inner: &RawNode<'t>| {
            let mut inner = RawNode { id: format!("{}{}", scope.prefix, inner.id).into(), ..inner.clone() };
            inner.scope = number;
            inner.fields.iter_mut().for_each(|field| field.scope = number);
            inner
        };
        open.extend(file.nodes.iter().rev().map(inside));
        // Axes of the file become axes of the graph, unless the graph has an axis of the same name.
        let known = |axis: &RawField<'t>| document.axes.iter().any(|own| own.name == axis.name);
        let own = |axis: &RawField<'t>| RawField { scope: number, ..axis.clone() };
        let axes: Vec<RawField<'t>> = file.axes.iter().filter(|axis| !known(axis)).map(own).collect();
        document.axes.extend(axes);
        let broken = file.broken.iter().map(|name| format!("{}{name}", scope.prefix).into());
        document.broken.extend(broken);
        document.scopes.push(scope);
    }
    overlays.report_unused(document, diagnostics);
}

type Used<'f, 't> = (&'f Document<'t>, Scope<'t>, Vec<Diagnostic>);

/// Returns the document and scope of a `Subgraph` node, and the mistakes in the values that the node gives to the
/// parameters.
fn use_of<'f, 't>(
    node: &RawNode<'t>,
    scopes: &[Scope<'t>],
    files: &'f SubgraphFiles<'t>,
    folder_at: &dyn Fn(usize) -> &'t str,
    lost: &Lost<'_>,
) -> Result<Used<'f, 't>, Box<Diagnostic>> {
    let Some(field) = node.fields.iter().find(|field| field.name == FILE) else {
        let what = format!("`{SUBGRAPH}` needs `{FILE}`");
        let how = "write the path of the graph file, such as `graph: \"chair.ron\"`";
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
                let what = format!("subgraphs are nested more than {DEEPEST} levels deep");
                return Err(Diagnostic::new(field.span.clone(), what).into());
            }
            None => return Ok(fill(node, file, document, depth)),
        }
    }
    Err(Diagnostic::of(Code::Cycle, field.span.clone(), format!("`{}` uses itself", shown(file))).into())
}

/// The parameter values of a use: the values given in `node`, and defaults for the others.
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
                "this subgraph has no parameters; declare them next to `nodes`: `parameters: (yaw_deg: 0.0)`"
                    .to_owned()
            } else {
                format!("its parameters are {}", list.join(", "))
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

/// The name in `Param("name")`; `None` for any other text.
pub(crate) fn parameter_read<'t>(text: &'t str) -> Option<Cow<'t, str>> {
    let inside = text.strip_prefix("Param")?.trim_start().strip_prefix('(')?.strip_suffix(')')?;
    let name = inside.trim().trim_end_matches(',').trim_end();
    match name.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')) {
        Some(plain) if !plain.contains(['\\', '"']) => Some(Cow::Borrowed(plain)),
        _ => parse_value::<String>(name).ok().map(Cow::Owned),
    }
}

/// The value of the parameter that the call `text` reads. `place` is the byte range of the call.
pub(crate) fn value_of<'s, 't>(
    scopes: &'s [Scope<'t>],
    scope: usize,
    text: &str,
    place: Range<usize>,
) -> Result<&'s RawField<'t>, Diagnostic> {
    let Some(name) = parameter_read(text) else {
        let what = format!("`{}` is not a valid use of a parameter", shown(text));
        return Err(Diagnostic::new(place, what).hint("write `Param(\"yaw_deg\")`"));
    };
    let Scope { values, file, .. } = &scopes[scope];
    values.iter().find(|value| value.name == name).ok_or_else(|| {
        let file = if file.is_empty() { "the graph".to_owned() } else { format!("`{}`", shown(file)) };
        let mistake =
            Diagnostic::of(Code::UnknownField, place, format!("{file} has no parameter `{}`", shown(&name)));
        match nearest(&name, values.iter().map(|value| value.name)) {
            Some(near) => mistake.hint(format!("did you mean `{near}`?")),
            None => mistake.hint("parameters are declared next to `nodes`: `parameters: (yaw_deg: 0.0)`"),
        }
    })
}

/// Returns the text of a field with each `Param` call replaced by its value, and the byte range of the field. If
/// the field is a single `Param` call, the byte range of the value is returned instead. If `folder_at` is given,
/// paths are made relative to the folder of the graph.
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
        return Err(Diagnostic::new(field.span.clone(), "parameters refer to each other in a cycle"));
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
                "the text of the field is too long after the values of parameters are inserted",
            ));
        }
    }
    out.push_str(&moved(folder, &field.text[end..]));
    Ok((Cow::Owned(out), field.span.clone()))
}

/// The byte ranges of all calls of the given names in a text. Calls in strings and inside other calls are left out.
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

/// Prepends the folder to every relative path in quotes.
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

/// All strings in a text, with their byte ranges.
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
