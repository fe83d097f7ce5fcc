//! Resolves the names in the inputs of nodes to outputs of other nodes.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use crate::graph::checker::Check;
use crate::graph::node::Wire;
use crate::kind::port::{Arity, PortSpec};
use crate::kind::registry::KindEntry;
use crate::text::diag::{Code, Diagnostic, nearest, shown};
use crate::text::document::{RawField, RawNode, Scope};
use crate::text::scan::Scanner;
use crate::text::subgraph::value_of;
use crate::text::values::{form_of, parse_value};

/// Maximum number of wires to missing nodes for which a similar name is suggested. Further such wires are reported
/// without a suggestion.
const MOST_SUGGESTIONS: usize = 20;
/// Maximum number of wires of an input.
const MOST_WIRES: usize = 1_000_000;

/// A name in a wire, with its byte range and the scope that resolves it.
pub(crate) struct Named<'t> {
    pub name: Cow<'t, str>,
    pub span: Range<usize>,
    pub scope: usize,
}

/// The node or output that a name refers to.
pub(crate) struct End<'n> {
    pub node: usize,
    /// Name of the output, if the wire names one.
    pub output: Option<&'n str>,
}

impl<'t, 'a> Check<'t, 'a> {
    /// Resolves the wires of one input of a node. Records the nodes that the wires come from in `reads`, and the
    /// axes that each wire gathers in `gathers`.
    pub fn wires(
        &mut self,
        raw: &RawNode<'t>,
        kind: &KindEntry,
        (index, port): (usize, &PortSpec),
        kinds: &[Option<Arc<KindEntry>>],
        reads: &mut Vec<(usize, Range<usize>)>,
        gathers: &mut BTreeMap<(usize, usize), Vec<usize>>,
    ) -> Vec<Wire> {
        let Some(field) = raw.fields.iter().find(|field| field.name == port.name) else {
            if port.arity == Arity::One {
                self.report(
                    Diagnostic::of(
                        Code::Missing,
                        raw.kind_span.clone(),
                        format!("`{}` needs the input `{}`", kind.camel_name(), port.name),
                    )
                    .label(format!("connect an output of type `{}`", port.artifact.name)),
                );
            }
            return Vec::new();
        };
        let names = match wire_names(field, self.scopes) {
            Ok(names) => names,
            Err(mistake) => {
                self.report(mistake);
                return Vec::new();
            }
        };
        if port.arity != Arity::Many && names.len() != 1 {
            self.report(Diagnostic::of(
                Code::Wiring,
                field.span.clone(),
                format!("`{}` takes one wire, not {}", port.name, names.len()),
            ));
        }
        let mut wires = Vec::with_capacity(names.len());
        for named in names {
            let span = &named.span;
            let Some(End { node, output }) = self.end(&named) else { continue };
            let Some(gather) = self.gathers.get(&node) else {
                reads.push((node, span.clone()));
                wires.extend(self.wire(&named.name, output, node, span, port, kinds));
                continue;
            };
            let (node, from, over) = (gather.node, gather.output.clone(), gather.over.clone());
            let name = &named.name;
            let wrong = match (output, port.arity) {
                (Some(output), _) => Some(format!("a `Gather` has no output `{}`", shown(output))),
                (None, Arity::One | Arity::Optional) => {
                    Some(format!("`{}` takes one wire, but `{name}` gathers many", port.name))
                }
                (None, Arity::Many) => None,
            };
            if let Some(wrong) = wrong {
                self.report(Diagnostic::new(span.clone(), wrong));
            }
            reads.push((node, span.clone()));
            gathers.insert((index, wires.len()), over);
            wires.extend(self.wire(name, from.as_deref(), node, span, port, kinds));
        }
        wires
    }

    /// Resolves a name in its scope to a node, or to a node and an output.
    pub fn end<'n>(&mut self, named: &'n Named<'t>) -> Option<End<'n>> {
        let Named { name, span, scope } = named;
        let prefix = self.scopes[*scope].prefix.as_str();
        let whole = |name: &'n str| -> Cow<'n, str> {
            if prefix.is_empty() { name.into() } else { format!("{prefix}{name}").into() }
        };
        let find = |name: &'n str| self.ids.get(&*whole(name)).copied();
        if let Some(node) = find(name) {
            return Some(End { node, output: None });
        }
        let parts = name.rsplit_once('.');
        if let Some((id, output)) = parts
            && let Some(node) = find(id)
        {
            return Some(End { node, output: Some(output) });
        }
        let full = whole(name);
        let is_broken = full.match_indices('.').map(|(at, _)| &full[..at]).chain([&*full]);
        if is_broken.clone().any(|name| self.broken.contains(name)) {
            return None;
        }
        // Inside an existing subgraph, the name of its node is wrong.
        let within = format!("{full}.");
        let subgraph = self.scopes.iter().skip(1).filter(|scope| within.starts_with(&scope.prefix));
        let id = match subgraph.max_by_key(|scope| scope.prefix.len()) {
            Some(scope) if scope.prefix == within => {
                let what = format!("`{}` is a subgraph", shown(name));
                let inside = self.names.iter().filter_map(|id| id.strip_prefix(&*scope.prefix));
                let nodes: Vec<&str> = inside.take(20).collect();
                self.report(
                    Diagnostic::of(Code::UnknownOutput, span.clone(), what)
                        .label(format!("write \"{name}.{}\"", nodes.last().unwrap_or(&"node")))
                        .hint(format!("its nodes are {}", nodes.join(", "))),
                );
                return None;
            }
            Some(scope) if scope.prefix.len() > prefix.len() => name,
            _ => name.split_once('.').map_or(&**name, |(id, _)| id),
        };
        let mistake =
            Diagnostic::of(Code::UnknownNode, span.clone(), format!("no node is named `{}`", shown(id)));
        // Thousands of wires may refer to one renamed node, and each suggestion compares all names.
        self.missing_nodes += 1;
        let near = (self.missing_nodes <= MOST_SUGGESTIONS)
            .then(|| nearest(id, self.names.iter().filter_map(|id| id.strip_prefix(prefix))));
        self.report(match near.flatten() {
            Some(near) => mistake.hint(format!("did you mean `{near}`?")),
            None => mistake,
        });
        None
    }

    fn wire(
        &mut self,
        name: &str,
        output: Option<&str>,
        node: usize,
        span: &Range<usize>,
        port: &PortSpec,
        kinds: &[Option<Arc<KindEntry>>],
    ) -> Option<Wire> {
        // An unknown kind was reported already.
        let outputs = &kinds[node].as_ref()?.outputs;
        let id = output.and_then(|output| name.strip_suffix(output)?.strip_suffix('.')).unwrap_or(name);
        let wanted = port.artifact.name;
        let found = match output {
            Some(output) => outputs.iter().position(|known| known.name == output),
            // The first output of the input's type, or else the first output.
            None => {
                outputs.iter().position(|known| known.artifact.name == wanted).or(outputs.first().map(|_| 0))
            }
        };
        let Some(index) = found else {
            let names = || outputs.iter().map(|known| known.name);
            let message = match output {
                Some(output) => format!("`{id}` has no output `{output}`"),
                None => format!("`{id}` has no output"),
            };
            let list: Vec<&str> = names().collect();
            let hint = if list.is_empty() {
                format!("`{}` has no outputs", kinds[node].as_ref()?.camel_name())
            } else {
                format!("its outputs are {}", list.join(", "))
            };
            self.report(
                Diagnostic::of(Code::UnknownOutput, span.clone(), message)
                    .suggest(output.unwrap_or_default(), names())
                    .hint(hint),
            );
            return None;
        };
        let given = outputs[index].artifact.name;
        if given != wanted {
            let fitting: Vec<String> = outputs
                .iter()
                .filter(|o| o.artifact.name == wanted)
                .map(|o| format!("\"{id}.{}\"", o.name))
                .collect();
            let mut diagnostic = Diagnostic::of(
                Code::WrongType,
                span.clone(),
                format!("`{}` takes values of type `{wanted}`", port.name),
            )
            .label(format!("this is of type `{given}`"));
            if !fitting.is_empty() {
                diagnostic = diagnostic.hint(format!("use {}", fitting.join(" or ")));
            } else if let Some(makers) = self.makers(given, wanted) {
                diagnostic = diagnostic.hint(format!("{makers} makes values of type `{wanted}`"));
            }
            self.report(diagnostic);
            return None;
        }
        Some(Wire { node, port: index })
    }
}

/// Maximum number of kinds to propose for the conversion of a type. If more kinds are suitable, none is proposed.
const MOST_MAKERS: usize = 2;

impl Check<'_, '_> {
    /// Names the kinds that could convert `given` to `wanted`: their first output is of type `wanted`, and they
    /// have an input of type `given` but none of type `wanted`. Each kind is written as a call with its first
    /// required input.
    fn makers(&self, given: &str, wanted: &str) -> Option<String> {
        let takes = |kind: &KindEntry, name: &str| kind.inputs.iter().any(|port| port.artifact.name == name);
        let makes = |kind: &&Arc<KindEntry>| {
            kind.outputs.first().is_some_and(|port| port.artifact.name == wanted)
                && takes(kind, given)
                && !takes(kind, wanted)
        };
        let written = |kind: &Arc<KindEntry>| {
            let port = kind.inputs.iter().find(|port| port.arity != Arity::Optional).or(kind.inputs.first());
            port.map(|port| format!("`{}({}: ..)`", kind.camel_name(), port.name))
        };
        let makers: Vec<String> = self.registry.iter().filter(makes).filter_map(written).collect();
        (1..=MOST_MAKERS).contains(&makers.len()).then(|| makers.join(" or "))
    }
}

/// The names in a wire or a list of wires. Names from a `Param` call are resolved in the scope where its value is
/// written.
pub(crate) fn wire_names<'t>(
    field: &RawField<'t>,
    scopes: &[Scope<'t>],
) -> Result<Vec<Named<'t>>, Diagnostic> {
    let mut names = Vec::new();
    let mut steps = 0;
    // Fields that remain to be read, with offsets.
    let mut open = vec![(field.clone(), 0)];
    'fields: while let Some((field, at)) = open.pop() {
        let how = || "a wire is written \"node\" or \"node.port\"";
        let mut scan = Scanner::new(field.text);
        let list = scan.eat(b'[');
        scan.at = scan.at.max(at);
        loop {
            scan.skip_space();
            if list && scan.eat(b']') {
                continue 'fields;
            }
            let start = scan.at;
            let text = scan.value().map_or("", |span| &field.text[span]);
            let span = field.span.start + start..field.span.start + scan.at.max(start + 1);
            let value = match text.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')) {
                _ if text.starts_with("Param") => {
                    let value = value_of(scopes, field.scope, text, span.clone())?;
                    if value.text.starts_with("Param")
                        || value.text.starts_with('[')
                        || value.text.starts_with('"')
                    {
                        Some(value.clone())
                    } else {
                        let what = format!("`{}` is not a wire", shown(value.text));
                        return Err(Diagnostic::of(Code::Wiring, value.span.clone(), what)
                            .label(how())
                            .related(span, "used as a wire here"));
                    }
                }
                Some(plain) if !plain.contains('\\') => {
                    names.push(Named { name: Cow::Borrowed(plain), span: span.clone(), scope: field.scope });
                    None
                }
                _ => {
                    let name = parse_value::<String>(text).map(Cow::Owned).map_err(|_| {
                        let mistake = Diagnostic::of(
                            Code::Wiring,
                            span.clone(),
                            format!("`{}` is not a wire", shown(text)),
                        );
                        match form_of(text) {
                            _ if text.ends_with(')') => mistake
                                .label("a node must be in `nodes` and have a name")
                                .hint("write `name: Kind(..)` there and \"name\" here"),
                            "a word" if !text.is_empty() => {
                                mistake.label(format!("write \"{}\"", shown(text)))
                            }
                            _ => mistake.label(how()),
                        }
                    })?;
                    names.push(Named { name, span: span.clone(), scope: field.scope });
                    None
                }
            };
            scan.skip_space();
            if list && !scan.eat(b',') && scan.peek() != b']' {
                let end = span.end;
                return Err(Diagnostic::new(end..end + 1, "expected a comma here"));
            }
            steps += 1;
            if steps > MOST_WIRES {
                return Err(Diagnostic::new(
                    field.span.clone(),
                    "this input has too many wires, or its parameters refer to each other in a cycle",
                ));
            }
            match value {
                Some(value) => {
                    if list {
                        open.push((field.clone(), scan.at));
                    }
                    open.push((value, 0));
                    continue 'fields;
                }
                None if list => {}
                None => continue 'fields,
            }
        }
    }
    Ok(names)
}
