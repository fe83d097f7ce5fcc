//! Checking a graph file: kinds known, wires typed, parameters in range, all mistakes at once.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use crate::axis::{Axis, at_point, axes_read};
use crate::context::{Scene, Up};
use crate::diag::{Code, Diagnostic, nearest, shown};
use crate::expand::{GATHER, Gather, Template};
use crate::graph::{Node, Wire};
use crate::kind::{KindEntry, Registry, Step};
use crate::order::Wiring;
use crate::param::{InputFile, Role};
use crate::port::{Arity, PortSpec};
use crate::root::SourceRoot;
use crate::scan::Scanner;
use crate::syntax::{Document, Fields, RawField, RawNode, RawScene, parse_value, sort_of, twice};

/// What the `scene` block may hold.
pub(crate) const SCENE_FIELDS: [&str; 3] = ["up", "metres_per_unit", "seed"];

/// The check of one file.
pub(crate) struct Check<'t, 'a> {
    text: &'t str,
    registry: &'a Registry,
    root: &'a SourceRoot,
    diagnostics: &'a mut Vec<Diagnostic>,
    ids: HashMap<&'t str, usize>,
    names: Vec<&'t str>,
    broken: HashSet<&'t str>,
    /// The files that nodes name.
    pub files: Vec<PathBuf>,
    /// What the graph runs along.
    pub axes: Arc<[Axis<'t>]>,
    gathers: HashMap<usize, Gather>,
    /// Wires to nodes that do not exist, so far.
    strangers: usize,
}

/// How many wires to nodes that do not exist get a suggestion.
const MOST_SUGGESTIONS: usize = 20;

impl<'t, 'a> Check<'t, 'a> {
    /// Mistakes go to `diagnostics`.
    pub fn new(
        text: &'t str,
        registry: &'a Registry,
        root: &'a SourceRoot,
        document: &Document<'t>,
        diagnostics: &'a mut Vec<Diagnostic>,
    ) -> Self {
        let names = document.nodes.iter().map(|node| node.id).collect();
        let broken = document.broken.iter().copied().collect();
        let ids = HashMap::with_capacity(document.nodes.len());
        Self {
            text,
            registry,
            root,
            diagnostics,
            ids,
            names,
            broken,
            files: Vec::new(),
            axes: Arc::new([]),
            gathers: HashMap::new(),
            strangers: 0,
        }
    }

    pub fn report(&mut self, diagnostic: Diagnostic) {
        self.diagnostics.push(diagnostic);
    }

    /// How many mistakes were found.
    pub fn mistakes(&self) -> usize {
        self.diagnostics.len()
    }

    /// Whether a node of the file may be several, or none.
    pub fn is_multiple(&self) -> bool {
        !self.axes.is_empty() || !self.gathers.is_empty()
    }

    /// What stands beside the nodes.
    pub fn document(&mut self, document: &Document<'t>) -> Option<Scene> {
        let whole = 0..self.text.len().min(1);
        match &document.version {
            Some(field) if field.text.trim() != "1" => self.report(
                Diagnostic::of(
                    Code::Version,
                    field.span.clone(),
                    format!("version {} of graph files is unknown", field.text),
                )
                .label("this program reads version 1"),
            ),
            None if document.whole => {
                self.report(
                    Diagnostic::of(Code::Missing, whole.clone(), "the graph does not state its version")
                        .hint("begin it with `version: 1,`"),
                );
            }
            _ => {}
        }
        let axes: Vec<_> = document.axes.iter().map(Axis::read).collect();
        self.axes =
            axes.into_iter().filter_map(|axis| axis.map_err(|mistake| self.report(mistake)).ok()).collect();
        if document.whole && document.nodes.is_empty() {
            self.report(Diagnostic::of(Code::Missing, whole.clone(), "the graph has no nodes").hint(
                "add `nodes: (name: Kind(field: value, ..), ..)`; `lightharmony nodes` lists the kinds",
            ));
        }
        let Some(RawScene { span, fields, .. }) = &document.scene else {
            if document.whole {
                self.report(Diagnostic::of(Code::Missing, whole, "the graph has no `scene`").hint(
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
                    Diagnostic::of(
                        Code::UnknownField,
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

    /// The nodes that are right, and which reads which, of all of them.
    pub fn nodes<'r>(&mut self, raw: &'r [RawNode<'t>]) -> (Vec<Option<Template<'r, 't>>>, Wiring) {
        for (index, node) in raw.iter().enumerate() {
            if let Some(&first) = self.ids.get(node.id) {
                self.report(
                    Diagnostic::of(
                        Code::Duplicate,
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
        for (index, node) in raw.iter().enumerate().filter(|(_, node)| node.kind == GATHER) {
            if let Some(gather) = self.gather(node, raw) {
                self.gathers.insert(index, gather);
            }
        }
        let kinds: Vec<Option<Arc<KindEntry>>> = raw.iter().map(|node| self.kind(node)).collect();
        let mut templates = Vec::with_capacity(raw.len());
        let mut wiring = vec![Vec::new(); raw.len()];
        for ((node, kind), reads) in raw.iter().zip(&kinds).zip(&mut wiring) {
            templates.push(kind.as_ref().and_then(|kind| self.node(node, kind, &kinds, reads)));
        }
        self.sink_paths(&templates);
        (templates, wiring)
    }

    fn kind(&mut self, node: &RawNode<'t>) -> Option<Arc<KindEntry>> {
        let found = self.registry.get(node.kind).cloned();
        if found.is_none() && node.kind != GATHER {
            let names: Vec<String> = self.registry.iter().map(|kind| kind.camel_name()).collect();
            self.report(
                Diagnostic::of(
                    Code::UnknownKind,
                    node.kind_span.clone(),
                    format!("no kind of node is named `{}`", shown(node.kind)),
                )
                .suggest(node.kind, names.iter().map(String::as_str))
                .hint("`lightharmony nodes` lists them"),
            );
        }
        found
    }

    fn node<'r>(
        &mut self,
        raw: &'r RawNode<'t>,
        kind: &Arc<KindEntry>,
        kinds: &[Option<Arc<KindEntry>>],
        reads: &mut Vec<(usize, Range<usize>)>,
    ) -> Option<Template<'r, 't>> {
        let before = self.diagnostics.len();
        for (index, field) in raw.fields.iter().enumerate() {
            let names = || kind.params.iter().map(|p| p.name).chain(kind.inputs.iter().map(|p| p.name));
            if !names().any(|name| name == field.name) {
                let message = format!("`{}` has no field `{}`", kind.camel_name(), shown(field.name));
                let mistake = Diagnostic::of(Code::UnknownField, field.name_span.clone(), message)
                    .suggest(field.name, names());
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
        let mut own = Vec::new();
        for field in &raw.fields {
            match axes_read(field, &self.axes) {
                Ok(axes) if axes.is_empty() || kind.params.iter().any(|p| p.name == field.name) => {
                    own.extend(axes);
                }
                Ok(_) => self.report(Diagnostic::new(field.span.clone(), "a wire cannot run along an axis")),
                Err(mistake) => self.report(mistake),
            }
        }
        let mut gathers = BTreeMap::new();
        let mut inputs = Vec::with_capacity(kind.inputs.len());
        for (index, port) in kind.inputs.iter().enumerate() {
            inputs.push(self.wires(raw, kind, (index, port), kinds, reads, &mut gathers));
        }
        let (step, sink_path) = if own.is_empty() {
            self.step(raw, kind, &raw.fields)?
        } else if self.mistakes() == before {
            let texts: Vec<_> =
                raw.fields.iter().map(|field| at_point(field.text, &self.axes, |_| 0)).collect();
            let fields = raw.fields.iter().zip(&texts);
            let fields: Vec<_> = fields.map(|(field, text)| RawField { text, ..field.clone() }).collect();
            self.step(raw, kind, &fields)?
        } else {
            return None;
        };
        let place = |name: &'static str| {
            let field = raw.fields.iter().find(|field| field.name == name)?;
            Some((name, field.span.clone()))
        };
        let fields = kind.params.iter().map(|p| p.name).chain(kind.inputs.iter().map(|p| p.name));
        let fields = fields.filter_map(place).collect();
        let node = Node {
            id: raw.id.to_owned(),
            kind: kind.clone(),
            inputs,
            sink_path,
            point: Vec::new(),
            span: raw.id_span.start..raw.span.end,
            fields,
            step: step.into(),
        };
        (self.mistakes() == before).then_some(Template { node, raw, own, gathers })
    }

    /// Reads the parameters of a node, the values of axes in place: what it does and where it writes.
    pub fn step(
        &mut self,
        raw: &RawNode<'t>,
        kind: &Arc<KindEntry>,
        fields: &[RawField<'_>],
    ) -> Option<(Arc<dyn Step>, Option<String>)> {
        let moved = moved_paths(raw.folder, kind, fields);
        let moved: Option<Vec<RawField<'_>>> = moved.as_ref().map(|texts| {
            fields.iter().zip(texts).map(|(field, text)| RawField { text, ..field.clone() }).collect()
        });
        let step = (kind.read)(&mut Fields {
            fields: moved.as_deref().unwrap_or(fields),
            node_span: raw.kind_span.clone(),
            kind: raw.kind,
            diagnostics: self.diagnostics,
        })?;
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
            let field = fields.iter().find(|field| field.name == name);
            field.map_or(raw.kind_span.clone(), |field| field.span.clone())
        };
        for (name, path) in sources {
            let file = self.root.file(&InputFile(path.clone()));
            if self.root.is_outside(&file) {
                self.report(
                    Diagnostic::new(place(name), format!("`{path}` may not be read"))
                        .label("outside of the bundle")
                        .hint("a graph of a bundle or a picture reads inside the bundle and the folders of `--inputs`"),
                );
            } else if !file.path.exists() {
                self.report(
                    Diagnostic::of(Code::MissingFile, place(name), format!("`{path}` does not exist"))
                        .label(format!("looked for {}", file.path.display()))
                        .hint("paths are relative to the folder of the graph file"),
                );
            } else if !kind.folders && file.path.is_dir() {
                let what = format!("`{path}` is a folder; `{}` reads a file", kind.camel_name());
                self.report(Diagnostic::of(Code::MissingFile, place(name), what));
            }
            self.files.push(file.path);
        }
        if let Err(error) = step.check() {
            let mut diagnostic = Diagnostic::of(
                Code::Parameters,
                error.field.map_or(raw.kind_span.clone(), place),
                error.message(),
            );
            diagnostic.hints.extend(error.hint);
            self.report(diagnostic);
        }
        Some((step, sink_path))
    }

    fn wires(
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
            self.report(Diagnostic::of(
                Code::Wiring,
                field.span.clone(),
                format!("`{}` takes one wire, not {}", port.name, names.len()),
            ));
        }
        let mut wires = Vec::with_capacity(names.len());
        for (name, span) in names {
            let (id, output) = split(&name);
            let Some(node) = self.read(id, &span) else { continue };
            let Some(gather) = self.gathers.get(&node) else {
                reads.push((node, span.clone()));
                wires.extend(self.wire(id, output, node, span, port, kinds));
                continue;
            };
            let (node, from, over) = (gather.node, gather.output.clone(), gather.over.clone());
            let wrong = match (output, port.arity) {
                (Some(output), _) => {
                    Some(format!("`{id}` is a gather and has no output `{}`", shown(output)))
                }
                (None, Arity::One | Arity::Optional) => {
                    Some(format!("`{}` takes one wire, and `{id}` gathers many", port.name))
                }
                (None, Arity::Many) => None,
            };
            if let Some(wrong) = wrong {
                self.report(Diagnostic::new(span.clone(), wrong));
            }
            reads.push((node, span.clone()));
            gathers.insert((index, wires.len()), over);
            wires.extend(self.wire(id, from.as_deref(), node, span, port, kinds));
        }
        wires
    }

    /// The node that a wire comes from.
    pub fn read(&mut self, id: &str, span: &Range<usize>) -> Option<usize> {
        if let Some(&node) = self.ids.get(id) {
            return Some(node);
        }
        if !self.broken.contains(id) {
            let mistake =
                Diagnostic::of(Code::UnknownNode, span.clone(), format!("no node is named `{}`", shown(id)));
            // One node that was renamed may be read by thousands, and each look through all names costs.
            self.strangers += 1;
            let near = (self.strangers <= MOST_SUGGESTIONS).then(|| nearest(id, self.names.iter().copied()));
            self.report(match near.flatten() {
                Some(near) => mistake.hint(format!("did you mean `{near}`?")),
                None => mistake,
            });
        }
        None
    }

    fn wire(
        &mut self,
        id: &str,
        output: Option<&str>,
        node: usize,
        span: Range<usize>,
        port: &PortSpec,
        kinds: &[Option<Arc<KindEntry>>],
    ) -> Option<Wire> {
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
                Diagnostic::of(Code::UnknownOutput, span, message)
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
            let mut diagnostic = Diagnostic::of(
                Code::WrongType,
                span,
                format!("`{}` takes values of type `{wanted}`", port.name),
            )
            .label(format!("this is of type `{given}`"));
            if !fitting.is_empty() {
                diagnostic = diagnostic.hint(format!("{} would fit", fitting.join(" or ")));
            }
            self.report(diagnostic);
            return None;
        }
        Some(Wire { node, port: index })
    }

    fn sink_paths(&mut self, templates: &[Option<Template<'_, 't>>]) {
        let mut seen: BTreeMap<String, &Node> = BTreeMap::new();
        for Template { node, .. } in templates.iter().flatten() {
            let Some(path) = &node.sink_path else { continue };
            if let Err(why) = check_sink_path(path, &self.axes) {
                self.report(Diagnostic::of(
                    Code::OutputPath,
                    node.place(Some("path")),
                    format!("cannot write to `{path}`: {why}"),
                ));
                continue;
            }
            let plain =
                path.split('/').filter(|part| !matches!(*part, "" | ".")).collect::<Vec<_>>().join("/");
            if let Some(first) = seen.get(&plain) {
                self.report(
                    Diagnostic::of(
                        Code::OutputPath,
                        node.place(Some("path")),
                        format!("two sinks write to `{path}`"),
                    )
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
fn check_sink_path(path: &str, axes: &[Axis<'_>]) -> Result<(), &'static str> {
    use std::path::Component;
    if path.is_empty() || path.ends_with('/') {
        return Err("it names no file");
    }
    let mut plain = path.replace("{view}", "");
    for axis in axes {
        plain = plain.replace(&format!("{{{}}}", axis.name), "");
    }
    if plain.contains(['{', '}']) {
        return Err("the only placeholders are `{view}`, the name of the view, and the names of axes");
    }
    // They would mean something else on another system.
    if path.contains(['\\', ':']) || path.chars().any(char::is_control) {
        return Err("write `/` between folders, and no `\\` or `:`");
    }
    for part in std::path::Path::new(path).components() {
        match part {
            Component::Normal(_) | Component::CurDir => {}
            Component::ParentDir => return Err("`..` could lead out of the output folder"),
            Component::RootDir | Component::Prefix(_) => {
                return Err("it must be relative to the output folder");
            }
        }
    }
    Ok(())
}

/// The node and, where it is named, the output of a wire.
pub(crate) fn split(name: &str) -> (&str, Option<&str>) {
    name.split_once('.').map_or((name, None), |(id, port)| (id, Some(port)))
}

/// The texts of the fields, paths of files to read seen from the folder of the graph; `None` for a node that
/// stands in a file of that folder.
fn moved_paths(folder: &str, kind: &KindEntry, fields: &[RawField<'_>]) -> Option<Vec<String>> {
    let is_path = |field: &RawField<'_>| {
        kind.params.iter().any(|param| param.name == field.name && param.role == Role::Input)
    };
    let text =
        |field: &RawField<'_>| if is_path(field) { moved(folder, field.text) } else { field.text.to_owned() };
    (!folder.is_empty()).then(|| fields.iter().map(text).collect())
}

/// Puts the folder in front of every relative path in quotes.
fn moved(folder: &str, text: &str) -> String {
    let mut scan = Scanner::new(text);
    let mut out = String::with_capacity(text.len() + folder.len());
    let mut end = 0;
    while !scan.is_at_end() {
        let start = scan.at;
        if scan.peek() != b'"' {
            scan.step();
            continue;
        }
        scan.value();
        if let Ok(path) = parse_value::<String>(&text[start..scan.at])
            && !std::path::Path::new(&path).is_absolute()
        {
            out.push_str(&text[end..start]);
            out.push_str(&format!("{:?}", format!("{folder}{path}")));
            end = scan.at;
        }
    }
    out.push_str(&text[end..]);
    out
}

type Named<'t> = (Cow<'t, str>, Range<usize>);

/// The node names in a wire or a list of wires, each with its span.
pub(crate) fn wire_names<'t>(field: &RawField<'t>) -> Result<Vec<Named<'t>>, Diagnostic> {
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
            Some(plain) if !plain.contains('\\') => Cow::Borrowed(plain),
            _ => parse_value::<String>(text).map(Cow::Owned).map_err(|_| {
                let mistake =
                    Diagnostic::of(Code::Wiring, span.clone(), format!("`{}` is not a wire", shown(text)));
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
