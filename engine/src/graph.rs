//! The checked graph: kinds known, wires typed, parameters in range, no cycles, all mistakes at once.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use petgraph::algo::{kosaraju_scc, toposort};
use petgraph::graph::{DiGraph, NodeIndex};

use crate::context::{Scene, SourceRoot, Up};
use crate::diag::{Diagnostic, Diagnostics, Source, nearest, shown};
use crate::kind::{KindEntry, Registry, Step};
use crate::param::{InputFile, Role};
use crate::port::{Arity, PortSpec};
use crate::scan::Scanner;
use crate::syntax::{Document, Fields, RawField, RawNode, RawScene, parse, parse_value, sort_of, twice};

/// One end of a wire: an output of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Wire {
    /// Index into [`Graph::nodes`].
    pub node: usize,
    /// Index into the outputs of its kind.
    pub port: usize,
}

/// A node whose every field is right.
pub struct Node {
    /// Name in the file.
    pub id: String,
    /// What it does.
    pub kind: Arc<KindEntry>,
    /// For each input port of the kind, its wires in order.
    pub inputs: Vec<Vec<Wire>>,
    /// The path a sink writes to, with its placeholders.
    pub sink_path: Option<String>,
    /// Where it stands in the text.
    pub span: Range<usize>,
    pub(crate) fields: Vec<(String, Range<usize>)>,
    pub(crate) step: Arc<dyn Step>,
}

impl Node {
    /// Where a field stands in the text, or the whole node.
    pub(crate) fn place(&self, field: Option<&str>) -> Range<usize> {
        let named = field.and_then(|name| self.fields.iter().find(|(known, _)| known == name));
        named.map_or(self.span.clone(), |(_, span)| span.clone())
    }
}

/// A graph file that can run.
pub struct Graph {
    /// The text it came from.
    pub source: Source,
    /// What every node shares.
    pub scene: Scene,
    /// Nodes in the order of the file.
    pub nodes: Vec<Node>,
    /// Resolves the paths in it.
    pub root: SourceRoot,
    order: Vec<usize>,
    reads: Vec<Vec<usize>>,
    consumers: Vec<Vec<usize>>,
}

impl Graph {
    /// Reads and checks a graph file, whose paths are relative to `folder`.
    pub fn parse(source: Source, registry: &Registry, root: SourceRoot) -> Result<Self, Diagnostics> {
        let text = source.text.clone();
        let mut diagnostics = Vec::new();
        let document = parse(&text, &mut diagnostics);
        let mut check = Check {
            text: &text,
            registry,
            root: &root,
            diagnostics: &mut diagnostics,
            ids: BTreeMap::new(),
            broken: &document.broken,
            strangers: 0,
        };
        let scene = check.document(&document);
        let (nodes, wiring) = check.nodes(&document.nodes);
        let order = order_of(&wiring);
        if let Err(cycles) = &order {
            diagnostics.extend(cycles.iter().map(|cycle| describe_cycle(&document.nodes, &wiring, cycle)));
        }
        match (scene, order) {
            (Some(scene), Ok((order, consumers))) if diagnostics.is_empty() => {
                let reads = wiring.into_iter().map(distinct).collect();
                Ok(Self { source, scene, nodes, root, order, reads, consumers })
            }
            _ => Err(Diagnostics::new(source, diagnostics)),
        }
    }

    /// Every node, inputs before what reads them.
    pub fn order(&self) -> &[usize] {
        &self.order
    }

    /// The nodes whose outputs `node` reads, each once, by index.
    pub fn reads(&self, node: usize) -> &[usize] {
        &self.reads[node]
    }

    /// The nodes that read an output of `node`, each once, in the order of the file.
    pub fn consumers(&self, node: usize) -> &[usize] {
        &self.consumers[node]
    }

    /// For each input port of a node, the names of the outputs its wires come from.
    pub(crate) fn wired(&self, node: usize) -> Vec<(&'static str, Vec<&'static str>)> {
        let node = &self.nodes[node];
        let name = |wire: &Wire| self.nodes[wire.node].kind.outputs[wire.port].name;
        let ports = node.kind.inputs.iter().zip(&node.inputs);
        ports.map(|(port, wires)| (port.name, wires.iter().map(name).collect())).collect()
    }

    /// Index of a node by name.
    pub fn find(&self, id: &str) -> Option<usize> {
        self.nodes.iter().position(|node| node.id == id)
    }

    /// The nodes a run wants by default: the sinks, or those that nothing reads where there is no sink.
    pub fn targets(&self) -> Vec<usize> {
        let all = 0..self.nodes.len();
        let sinks: Vec<usize> = all.clone().filter(|&n| self.nodes[n].sink_path.is_some()).collect();
        if sinks.is_empty() { all.filter(|&n| self.consumers[n].is_empty()).collect() } else { sinks }
    }

    /// Marks the given nodes and everything above them.
    pub fn above(&self, targets: &[usize]) -> Vec<bool> {
        let mut wanted = vec![false; self.nodes.len()];
        for &target in targets {
            wanted[target] = true;
        }
        for &node in self.order.iter().rev() {
            if wanted[node] {
                for &above in &self.reads[node] {
                    wanted[above] = true;
                }
            }
        }
        wanted
    }
}

struct Check<'t, 'a> {
    text: &'t str,
    registry: &'a Registry,
    root: &'a SourceRoot,
    diagnostics: &'a mut Vec<Diagnostic>,
    ids: BTreeMap<&'t str, usize>,
    broken: &'a [&'t str],
    /// Wires to nodes that do not exist, so far.
    strangers: usize,
}

/// How many wires to nodes that do not exist get a suggestion.
const MOST_SUGGESTIONS: usize = 20;

/// What the `scene` block may hold.
pub(crate) const SCENE_FIELDS: [&str; 3] = ["up", "metres_per_unit", "seed"];

/// For each node the nodes it reads, with the span of the wire.
type Wiring = Vec<Vec<(usize, Range<usize>)>>;

impl<'t> Check<'t, '_> {
    fn report(&mut self, diagnostic: Diagnostic) {
        self.diagnostics.push(diagnostic);
    }

    fn document(&mut self, document: &Document<'t>) -> Option<Scene> {
        let whole = 0..self.text.len().min(1);
        match &document.version {
            Some(field) if field.text.trim() != "1" => self.report(
                Diagnostic::new(
                    field.span.clone(),
                    format!("version {} of graph files is unknown", field.text),
                )
                .label("this program reads version 1"),
            ),
            None if document.whole => {
                self.report(
                    Diagnostic::new(whole.clone(), "the graph does not state its version")
                        .hint("begin it with `version: 1,`"),
                );
            }
            _ => {}
        }
        let Some(RawScene { span, fields, .. }) = &document.scene else {
            if document.whole {
                self.report(Diagnostic::new(whole, "the graph has no `scene`").hint(
                    "add `scene: (up: \"+z\"),` with the axis of your capture that points up: +y, -y or +z",
                ));
            }
            return None;
        };
        let before = self.diagnostics.len();
        for field in fields {
            let known = SCENE_FIELDS;
            if !known.contains(&field.name) {
                self.report(
                    Diagnostic::new(
                        field.name_span.clone(),
                        format!("`scene` has no field `{}`", field.name),
                    )
                    .suggest(field.name, known)
                    .hint("it has `up`, `metres_per_unit` and `seed`"),
                );
            }
        }
        let mut fields =
            Fields { fields, node_span: span.clone(), kind: "scene", diagnostics: self.diagnostics };
        let up: Option<Up> = fields.parameter("up", None, None);
        let metres_per_unit = fields.parameter("metres_per_unit", Some(1.0), Some((1e-9, 1e9)));
        let seed = fields.parameter("seed", Some(0_u64), None);
        if self.diagnostics.len() > before {
            return None;
        }
        Some(Scene { up: up?, metres_per_unit: metres_per_unit?, seed: seed? })
    }

    fn nodes(&mut self, raw: &[RawNode<'t>]) -> (Vec<Node>, Wiring) {
        for (index, node) in raw.iter().enumerate() {
            if let Some(&first) = self.ids.get(node.id) {
                self.report(
                    Diagnostic::new(
                        node.id_span.clone(),
                        format!("two nodes are named `{}`", shown(node.id)),
                    )
                    .label("second")
                    .related(raw[first].id_span.clone(), "first"),
                );
            } else {
                self.ids.insert(node.id, index);
            }
        }
        let kinds: Vec<Option<Arc<KindEntry>>> = raw.iter().map(|node| self.kind(node)).collect();
        let mut nodes = Vec::with_capacity(raw.len());
        let mut wiring = vec![Vec::new(); raw.len()];
        for ((node, kind), reads) in raw.iter().zip(&kinds).zip(&mut wiring) {
            if let Some(kind) = kind {
                nodes.extend(self.node(node, kind, &kinds, reads));
            }
        }
        self.sink_paths(&nodes);
        (nodes, wiring)
    }

    fn kind(&mut self, node: &RawNode<'t>) -> Option<Arc<KindEntry>> {
        let found = self.registry.get(node.kind).cloned();
        if found.is_none() {
            let names: Vec<String> = self.registry.iter().map(|kind| kind.camel_name()).collect();
            self.report(
                Diagnostic::new(
                    node.kind_span.clone(),
                    format!("no kind of node is named `{}`", shown(node.kind)),
                )
                .suggest(node.kind, names.iter().map(String::as_str))
                .hint("`lightharmony nodes` lists them"),
            );
        }
        found
    }

    fn node(
        &mut self,
        raw: &RawNode<'t>,
        kind: &Arc<KindEntry>,
        kinds: &[Option<Arc<KindEntry>>],
        reads: &mut Vec<(usize, Range<usize>)>,
    ) -> Option<Node> {
        let before = self.diagnostics.len();
        let camel = kind.camel_name();
        for (index, field) in raw.fields.iter().enumerate() {
            let names = || kind.params.iter().map(|p| p.name).chain(kind.inputs.iter().map(|p| p.name));
            if !names().any(|name| name == field.name) {
                let message = format!("`{camel}` has no field `{}`", shown(field.name));
                let mistake = Diagnostic::new(field.name_span.clone(), message).suggest(field.name, names());
                let node =
                    field.text.starts_with(|c: char| c.is_ascii_uppercase()) && field.text.ends_with(')');
                self.report(if node {
                    mistake.hint("if it is a node of its own, a `)` is missing before it")
                } else {
                    mistake.hint(format!("`lightharmony nodes {}` describes it", kind.name))
                });
            } else if let Some(first) = raw.fields[..index].iter().find(|other| other.name == field.name) {
                self.report(twice(field.name, field.name_span.clone(), first.name_span.clone()));
            }
        }
        let inputs: Vec<Vec<Wire>> =
            kind.inputs.iter().map(|port| self.wires(raw, kind, port, kinds, reads)).collect();
        let mut fields = Fields {
            fields: &raw.fields,
            node_span: raw.kind_span.clone(),
            kind: &camel,
            diagnostics: self.diagnostics,
        };
        let step = (kind.read)(&mut fields)?;
        let mut sink_path = None;
        let mut sources = Vec::new();
        for param in kind.params.iter().filter(|param| param.role != Role::Value) {
            step.visit(&mut |name, value| {
                if name != param.name {
                    return;
                }
                for path in value.paths() {
                    match param.role {
                        Role::Output => sink_path = Some(path.to_owned()),
                        _ => sources.push((param.name, path.to_owned())),
                    }
                }
            });
        }
        let place = |name: &str| {
            raw.fields
                .iter()
                .find(|field| field.name == name)
                .map_or(raw.kind_span.clone(), |field| field.span.clone())
        };
        for (name, path) in sources {
            let file = self.root.file(&InputFile(path.clone()));
            if !file.path.exists() {
                self.report(
                    Diagnostic::new(place(name), format!("`{path}` does not exist"))
                        .label(format!("looked for {}", file.path.display()))
                        .hint("paths are relative to the folder of the graph file"),
                );
            }
        }
        if let Err(error) = step.check() {
            let mut diagnostic =
                Diagnostic::new(error.field.map_or(raw.kind_span.clone(), place), error.message());
            diagnostic.hints.extend(error.hint);
            self.report(diagnostic);
        }
        let fields = raw.fields.iter().map(|field| (field.name.to_owned(), field.span.clone())).collect();
        (self.diagnostics.len() == before).then(|| Node {
            id: raw.id.to_owned(),
            kind: kind.clone(),
            inputs,
            sink_path,
            span: raw.id_span.start..raw.span.end,
            fields,
            step,
        })
    }

    fn wires(
        &mut self,
        raw: &RawNode<'t>,
        kind: &KindEntry,
        port: &PortSpec,
        kinds: &[Option<Arc<KindEntry>>],
        reads: &mut Vec<(usize, Range<usize>)>,
    ) -> Vec<Wire> {
        let Some(field) = raw.fields.iter().find(|field| field.name == port.name) else {
            if port.arity == Arity::One {
                self.report(
                    Diagnostic::new(
                        raw.kind_span.clone(),
                        format!("`{}` needs the input `{}`", kind.camel_name(), port.name),
                    )
                    .label(format!("wire it to an output of type `{}`", port.artifact.name)),
                );
            }
            return Vec::new();
        };
        let names = match wire_names(field) {
            Ok(names) => names,
            Err(mistake) => {
                self.report(mistake);
                return Vec::new();
            }
        };
        if port.arity != Arity::Many && names.len() != 1 {
            self.report(Diagnostic::new(
                field.span.clone(),
                format!("`{}` takes one wire, not {}", port.name, names.len()),
            ));
        }
        let mut wires = Vec::with_capacity(names.len());
        for (name, span) in names {
            if let Some(&node) = self.ids.get(name.split('.').next().unwrap_or_default()) {
                reads.push((node, span.clone()));
            }
            wires.extend(self.wire(&name, span, port, kinds));
        }
        wires
    }

    fn wire(
        &mut self,
        name: &str,
        span: Range<usize>,
        port: &PortSpec,
        kinds: &[Option<Arc<KindEntry>>],
    ) -> Option<Wire> {
        let (id, output) = name.split_once('.').map_or((name, None), |(id, output)| (id, Some(output)));
        let Some(&node) = self.ids.get(id) else {
            if self.broken.contains(&id) {
                return None;
            }
            let mistake = Diagnostic::new(span, format!("no node is named `{}`", shown(id)));
            // One node that was renamed may be read by thousands, and each look through all names costs.
            self.strangers += 1;
            let near = (self.strangers <= MOST_SUGGESTIONS).then(|| nearest(id, self.ids.keys().copied()));
            self.report(match near.flatten() {
                Some(near) => mistake.hint(format!("did you mean `{near}`?")),
                None => mistake,
            });
            return None;
        };
        // A node of unknown kind was reported already.
        let outputs = &kinds[node].as_ref()?.outputs;
        let wanted = port.artifact.name;
        let found = match output {
            Some(output) => outputs.iter().position(|known| known.name == output),
            // The first output, or the first of the type that the input takes.
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
            self.report(
                Diagnostic::new(span, message)
                    .suggest(output.unwrap_or_default(), names())
                    .hint(format!("its outputs are {}", list.join(", "))),
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
            let mut diagnostic =
                Diagnostic::new(span, format!("`{}` takes values of type `{wanted}`", port.name))
                    .label(format!("this is of type `{given}`"));
            if !fitting.is_empty() {
                diagnostic = diagnostic.hint(format!("{} would fit", fitting.join(" or ")));
            }
            self.report(diagnostic);
            return None;
        }
        Some(Wire { node, port: index })
    }

    fn sink_paths(&mut self, nodes: &[Node]) {
        let mut seen: BTreeMap<String, &Node> = BTreeMap::new();
        for node in nodes {
            let Some(path) = &node.sink_path else { continue };
            if let Err(why) = check_sink_path(path) {
                self.report(Diagnostic::new(
                    node.place(Some("path")),
                    format!("cannot write to `{path}`: {why}"),
                ));
                continue;
            }
            let plain =
                path.split('/').filter(|part| !matches!(*part, "" | ".")).collect::<Vec<_>>().join("/");
            if let Some(first) = seen.get(&plain) {
                self.report(
                    Diagnostic::new(node.place(Some("path")), format!("two sinks write to `{path}`"))
                        .label(format!("`{}`", node.id))
                        .related(first.place(Some("path")), format!("`{}`", first.id)),
                );
            } else {
                seen.insert(plain, node);
            }
        }
    }
}

/// Sinks write under the output folder and nowhere else.
fn check_sink_path(path: &str) -> Result<(), &'static str> {
    use std::path::Component;
    if path.is_empty() || path.ends_with('/') {
        return Err("it names no file");
    }
    // They would mean something else on another system.
    if path.contains(['\\', ':']) || path.chars().any(char::is_control) {
        return Err("write `/` between folders, and no `\\` or `:`");
    }
    for part in std::path::Path::new(path).components() {
        match part {
            Component::Normal(_) | Component::CurDir => {}
            Component::ParentDir => return Err("it leads out of the output folder"),
            Component::RootDir | Component::Prefix(_) => {
                return Err("it must be relative to the output folder");
            }
        }
    }
    Ok(())
}

type Named = (String, Range<usize>);

/// The node names in a wire or a list of wires, each with its span.
fn wire_names(field: &RawField<'_>) -> Result<Vec<Named>, Diagnostic> {
    let how = || "a wire is written \"node\" or \"node.port\"";
    let mut scan = Scanner::new(field.text);
    let list = scan.eat(b'[');
    let mut names = Vec::new();
    loop {
        scan.skip_space();
        if list && scan.eat(b']') {
            return Ok(names);
        }
        let start = scan.at;
        let text = scan.value().map_or("", |span| &field.text[span]);
        let span = field.span.start + start..field.span.start + scan.at.max(start + 1);
        let name = match text.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')) {
            Some(plain) if !plain.contains('\\') => plain.to_owned(),
            _ => parse_value::<String>(text).map_err(|_| {
                let mistake = Diagnostic::new(span.clone(), format!("`{}` is not a wire", shown(text)));
                match sort_of(text) {
                    "a word" if !text.is_empty() => mistake.label(format!("write \"{}\"", shown(text))),
                    _ => mistake.label(how()),
                }
            })?,
        };
        names.push((name, span));
        scan.skip_space();
        if !list {
            return Ok(names);
        }
        if !scan.eat(b',') && scan.peek() != b']' {
            let end = names.last().map_or(field.span.end, |(_, span)| span.end);
            return Err(Diagnostic::new(end..end + 1, "expected a comma here"));
        }
    }
}

fn distinct(reads: Vec<(usize, Range<usize>)>) -> Vec<usize> {
    let mut nodes: Vec<usize> = reads.into_iter().map(|(node, _)| node).collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

type Order = (Vec<usize>, Vec<Vec<usize>>);

/// A topological order and the consumers of each node, or the cycles. Nothing here recurses, so a chain
/// may be as long as memory allows.
fn order_of(wiring: &Wiring) -> Result<Order, Vec<Vec<usize>>> {
    let wires: usize = wiring.iter().map(Vec::len).sum();
    let mut graph: DiGraph<(), ()> = DiGraph::with_capacity(wiring.len(), wires);
    let mut consumers = vec![Vec::new(); wiring.len()];
    for _ in wiring {
        graph.add_node(());
    }
    for (index, reads) in wiring.iter().enumerate() {
        for (above, _) in reads {
            graph.add_edge(NodeIndex::new(*above), NodeIndex::new(index), ());
            if consumers[*above].last() != Some(&index) {
                consumers[*above].push(index);
            }
        }
    }
    match toposort(&graph, None) {
        Ok(order) => Ok((order.into_iter().map(NodeIndex::index).collect(), consumers)),
        Err(_) => Err(kosaraju_scc(&graph)
            .into_iter()
            .map(|group| group.into_iter().map(NodeIndex::index).collect::<Vec<_>>())
            .filter(|group| group.len() > 1 || consumers[group[0]].contains(&group[0]))
            .collect()),
    }
}

/// Walks one cycle within a strongly connected group and shows each wire of it.
fn describe_cycle(raw: &[RawNode<'_>], wiring: &Wiring, group: &[usize]) -> Diagnostic {
    let members: std::collections::BTreeSet<usize> = group.iter().copied().collect();
    let inside = |node: usize| wiring[node].iter().find(|(above, _)| members.contains(above));
    let mut at = group.iter().copied().min().unwrap_or_default();
    let mut seen = BTreeMap::new();
    let mut walked = Vec::new();
    while let (None, Some((above, _))) = (seen.insert(at, walked.len()), inside(at)) {
        walked.push(at);
        at = *above;
    }
    let start = walked.iter().position(|&node| node == at).unwrap_or_default();
    let mut cycle = walked.split_off(start);
    cycle.reverse();
    // The one that stands first in the file leads.
    let first = (0..cycle.len()).min_by_key(|&place| cycle[place]).unwrap_or_default();
    cycle.rotate_left(first);
    let shown = 12;
    let mut names: Vec<&str> = cycle.iter().take(shown).map(|&node| raw[node].id).collect();
    if cycle.len() > shown {
        names.push("..");
    }
    names.push(raw[cycle[0]].id);
    let place = |node: usize| inside(node).map_or(raw[node].id_span.clone(), |(_, span)| span.clone());
    let mut diagnostic = Diagnostic::new(place(cycle[0]), format!("a cycle: {}", names.join(" -> ")))
        .label(format!("`{}` reads what is made from it", raw[cycle[0]].id));
    for &node in cycle.iter().skip(1).take(shown) {
        diagnostic = diagnostic.related(place(node), format!("by way of `{}`", raw[node].id));
    }
    diagnostic
}
