//! The check of a graph: kinds, parameters and files. Wires are checked in `wires`. All mistakes are collected and
//! reported together.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use crate::graph::axis::{Axis, axes_read};
use crate::graph::cameras::cameras_of;
use crate::graph::check_values::places;
use crate::graph::checker::{Check, GATHER, Template, at_each};
use crate::graph::graph::{Graph, Parts};
use crate::graph::node::Node;
use crate::graph::order::{Wiring, describe_cycle, order_of};
use crate::kind::fields::Fields;
use crate::kind::param_type::Role;
use crate::kind::registry::{KindEntry, Registry};
use crate::kind::scene::{Scene, Up};
use crate::text::diag::{Code, Diagnostic, Diagnostics, shown};
use crate::text::document::{Document, RawField, RawNode, RawScene, SCENE_FIELDS};
use crate::text::include::parse_all;
use crate::text::overlay::ambiguous;
use crate::text::source::Source;
use crate::text::syntax::twice;
use crate::value::root::{PROGRAMS_HINT, SourceRoot};

impl<'t, 'a> Check<'t, 'a> {
    /// Checks all parts of the file except the nodes. Returns the scene if it is valid.
    pub fn document(&mut self, document: &'a Document<'t>) -> Option<Scene> {
        let whole = 0..self.text.len().min(1);
        let versions = document.others.iter().filter_map(|(version, _)| version.as_ref());
        for field in document.version.iter().chain(versions).filter(|field| field.text.trim() != "1") {
            let what = format!("version {} of graph files is unknown", field.text);
            let mistake = Diagnostic::of(Code::Version, field.span.clone(), what);
            self.report(mistake.label("this version of lightharmony reads version 1"));
        }
        if document.version.is_none() && document.whole {
            self.report(
                Diagnostic::of(Code::Missing, whole.clone(), "the graph has no `version`")
                    .hint("begin it with `version: 1,`"),
            );
        }
        self.contested(document);
        let (source, registry, root) = (self.source, self.registry, self.root);
        let read = |field: &RawField<'t>| {
            Axis::read(field, |node| cameras_of(node, field, (source, registry, root), document))
        };
        let axes: Vec<_> = document.axes.iter().map(read).collect();
        let named = |(axis, field): (Result<Axis<'t>, Diagnostic>, &RawField<'t>)| {
            axis.unwrap_or_else(|mistake| {
                self.report(mistake);
                Axis::broken(field.name)
            })
        };
        let axes: Vec<_> = axes.into_iter().zip(&document.axes).map(named).collect();
        self.axes = axes.into();
        if document.whole && document.nodes.is_empty() {
            self.report(Diagnostic::of(Code::Missing, whole.clone(), "the graph has no nodes").hint(
                "add `nodes: (name: Kind(field: value, ..), ..)`; `lightharmony nodes` lists the kinds",
            ));
        }
        // The scene in use may come from an included file, which is checked once.
        let own = document.scene.as_ref().map(|scene| &scene.span);
        for scene in document.others.iter().filter_map(|(_, scene)| scene.as_ref()) {
            if Some(&scene.span) != own {
                self.scene(scene);
            }
        }
        let Some(scene) = &document.scene else {
            if document.whole {
                self.report(Diagnostic::of(Code::Missing, whole, "the graph has no `scene`").hint(
                    "add `scene: (up: \"+z\"),` with the axis of your capture that points up: +y, -y or +z",
                ));
            }
            return None;
        };
        self.scene(scene)
    }

    /// Reports fields that an overlay sets in a block, although the node of the same name has such a field as well.
    fn contested(&mut self, document: &Document<'t>) {
        for (name, field) in &document.contested {
            let node = document.nodes.iter().find(|node| node.id == *name);
            let kind = node.and_then(|node| self.registry.get(node.kind));
            let in_node = kind.is_some_and(|kind| {
                kind.params.iter().any(|param| param.name == field.name)
                    || kind.inputs.iter().any(|port| port.name == field.name)
            });
            // A use of a subgraph is not a node any more; its arguments are the values of its scope.
            let used = document.scopes.iter().find(|scope| scope.prefix.strip_suffix('.') == Some(*name));
            if in_node || used.is_some_and(|scope| scope.values.iter().any(|value| value.name == field.name))
            {
                self.report(ambiguous(name, field));
            }
        }
    }

    /// Checks a `scene` block. Returns the scene if it is valid.
    fn scene(&mut self, RawScene { span, fields }: &RawScene<'t>) -> Option<Scene> {
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
                    .hint("its fields are `up`, `metres_per_unit`, `seed` and `exhaustive`"),
                );
            }
        }
        let mut fields =
            Fields { fields, node_span: span.clone(), kind: "scene", diagnostics: self.diagnostics };
        let up: Option<Up> = fields.parameter("up", None, None);
        let metres_per_unit = fields.parameter("metres_per_unit", Some(1.0), Some((1e-9, 1e9)));
        let seed = fields.parameter("seed", Some(0_u64), None);
        let exhaustive = fields.parameter("exhaustive", Some(false), None);
        if self.diagnostics.len() > before {
            return None;
        }
        Some(Scene { up: up?, metres_per_unit: metres_per_unit?, seed: seed?, exhaustive: exhaustive? })
    }

    /// Checks the nodes. Returns the nodes without mistakes, and the wiring of all nodes.
    pub fn nodes(&mut self, raw: &'a [RawNode<'t>]) -> (Vec<Option<Template<'a, 't>>>, Wiring) {
        for (index, node) in raw.iter().enumerate() {
            if let Some(&first) = self.ids.get(&*node.id) {
                self.report(
                    Diagnostic::of(
                        Code::Duplicate,
                        node.id_span.clone(),
                        format!("two nodes are named `{}`", shown(&node.id)),
                    )
                    .label("second")
                    .related(raw[first].id_span.clone(), "first"),
                );
            } else {
                self.ids.insert(&node.id, index);
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
            let before = self.mistakes();
            templates.push(kind.as_ref().and_then(|kind| self.node(node, kind, &kinds, reads)));
            self.add_use(node, before);
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
                .hint(self.registry.hint(node.kind)),
            );
        }
        found
    }

    fn node(
        &mut self,
        raw: &'a RawNode<'t>,
        kind: &Arc<KindEntry>,
        kinds: &[Option<Arc<KindEntry>>],
        reads: &mut Vec<(usize, Range<usize>)>,
    ) -> Option<Template<'a, 't>> {
        let before = self.diagnostics.len();
        if kind.runs_programs && !self.root.permits_programs() {
            let what =
                format!("`{}` runs a program, which a graph from others may not do", kind.camel_name());
            let mistake = Diagnostic::of(Code::RunsProgram, raw.kind_span.clone(), what);
            self.report(mistake.hint(PROGRAMS_HINT));
        }
        let former = former_fields(raw, kind);
        for (_, former) in &former {
            self.report(former.clone());
        }
        for (index, field) in raw.fields.iter().enumerate() {
            if former.iter().any(|(fields, _)| fields.contains(&field.name)) {
                continue;
            }
            let names = || kind.params.iter().map(|p| p.name).chain(kind.inputs.iter().map(|p| p.name));
            if !names().any(|name| name == field.name) {
                let message = format!("`{}` has no field `{}`", kind.camel_name(), shown(field.name));
                let mistake = Diagnostic::of(Code::UnknownField, field.name_span.clone(), message)
                    .suggest(field.name, names());
                // The text of a node is the name of a kind and its fields; `Param("x")` and `Axis("x")` are values.
                let called = field.text.split_once('(').map(|(name, _)| name.trim_end());
                let is_node = field.text.ends_with(')')
                    && called.is_some_and(|name| name == GATHER || self.registry.get(name).is_some());
                self.report(if is_node {
                    mistake.hint("if this is a separate node, a `)` is missing before it")
                } else {
                    mistake.hint(format!("`lightharmony nodes {}` describes the kind", kind.name))
                });
            } else if let Some(first) = raw.fields[..index].iter().find(|other| other.name == field.name) {
                self.report(twice(field.name, field.name_span.clone(), first.name_span.clone()));
            }
        }
        let mut fields = Vec::with_capacity(raw.fields.len());
        let mut own = Vec::new();
        for field in &raw.fields {
            let Some(param) = kind.params.iter().find(|param| param.name == field.name) else {
                if former.iter().any(|(fields, _)| fields.contains(&field.name)) {
                    continue;
                }
                if let Ok(1..) = axes_read(field.text, &field.span, &self.axes).map(|axes| axes.len()) {
                    self.report(Diagnostic::new(
                        field.span.clone(),
                        "an input cannot contain `Axis` or `Track`; only parameters can",
                    ));
                }
                continue;
            };
            match self.field(field, param.role == Role::Input) {
                Ok((field, axes)) => {
                    own.extend(axes);
                    fields.push(field);
                }
                Err(mistake) => self.report(mistake),
            }
        }
        let mut gathers = BTreeMap::new();
        let mut inputs = Vec::with_capacity(kind.inputs.len());
        for (index, port) in kind.inputs.iter().enumerate() {
            inputs.push(self.wires(raw, kind, (index, port), kinds, reads, &mut gathers));
        }
        // The values of an axis with a mistake are unknown.
        if !own.iter().all(|&axis| self.axes[axis].is_whole()) {
            return None;
        }
        let (step, sink_path) = if own.is_empty() {
            self.step(raw, kind, &fields)?
        } else if self.mistakes() == before {
            let first = at_each(&fields, &self.axes, |_| 0);
            self.step(raw, kind, &first)?
        } else {
            return None;
        };
        let places = places(raw, kind, &fields);
        let node = Node {
            id: raw.id.clone().into_owned(),
            kind: kind.clone(),
            inputs,
            sink_path,
            point: Vec::new(),
            span: raw.id_span.start..raw.span.end,
            places,
            step,
        };
        (self.mistakes() == before).then_some(Template { node, raw, fields, own, gathers })
    }

    /// Adds a related place to each mistake in `diagnostics` from index `before` on. For a mistake inside a
    /// subgraph, this is the place where the subgraph is used. For a mistake in a value that is given to a
    /// subgraph, it is the place in the subgraph that reads the value.
    fn add_use(&mut self, node: &RawNode<'t>, before: usize) {
        let scope = &self.scopes[node.scope];
        let Some((used, _)) = &scope.used else { return };
        for mistake in &mut self.diagnostics[before..] {
            let own = (node.span.start..node.span.end).contains(&mistake.span.start);
            let (place, what) = if own {
                (used.clone(), format!("in `{}`", scope.prefix.trim_end_matches('.')))
            } else {
                (node.id_span.clone(), "read here".to_owned())
            };
            mistake.related.push((place, what));
        }
    }
}

impl Graph {
    /// Parses and checks a graph file. Paths are relative to the folder of `root`.
    ///
    /// # Errors
    /// All mistakes in the graph.
    pub fn parse(source: Source, registry: &Registry, root: SourceRoot) -> Result<Self, Diagnostics> {
        let joined = source.clone();
        let mut diagnostics = Vec::new();
        let document = parse_all(&joined, &root, &mut diagnostics);
        let mut check = Check::new(&joined, registry, &root, &document, &mut diagnostics);
        let scene = check.document(&document);
        let (templates, mut wiring) = check.nodes(&document.nodes);
        let mut order = order_of(&wiring);
        if let Err(cycles) = &order {
            cycles.iter().for_each(|cycle| check.report(describe_cycle(&document.nodes, &wiring, cycle)));
        }
        let plain = !check.is_multiple() && source.pieces().len() == 1 && document.scopes.len() == 1;
        let nodes = match &order {
            Ok(files_first) if check.is_multiple() && check.mistakes() == 0 => {
                let nodes: Vec<_> =
                    check.instances(&templates, files_first).into_iter().map(Arc::new).collect();
                wiring = nodes.iter().map(wiring_of).collect();
                order = order_of(&wiring);
                nodes
            }
            _ => templates.into_iter().flatten().map(|template| Arc::new(template.node)).collect(),
        };
        let files = check.files;
        match (scene, order) {
            (Some(scene), Ok(order)) if diagnostics.is_empty() => {
                let graph = Self::assemble(source, root, Parts { scene, nodes, order, plain });
                match graph.check_between() {
                    mistakes if mistakes.is_empty() => Ok(graph),
                    mistakes => Err(Diagnostics { files, ..Diagnostics::new(graph.source, mistakes) }),
                }
            }
            _ => Err(Diagnostics { files, ..Diagnostics::new(source, diagnostics) }),
        }
    }
}

/// Finds the fields of a node that were parameters in a former version of its kind. Fields that are replaced
/// together form a group, with one diagnostic that says what to write instead.
fn former_fields<'t>(raw: &RawNode<'t>, kind: &KindEntry) -> Vec<(Vec<&'t str>, Diagnostic)> {
    let texts: Vec<(&str, &str)> = raw.fields.iter().map(|field| (field.name, field.text)).collect();
    let mut found: Vec<(Vec<&str>, Diagnostic)> = Vec::new();
    for field in &raw.fields {
        let known = kind.params.iter().any(|param| param.name == field.name)
            || found.iter().any(|(fields, _)| fields.contains(&field.name));
        if known {
            continue;
        }
        let former = match (kind.former)(field.name, &texts) {
            Ok(Some(former)) => former,
            Ok(None) => continue,
            Err(error) => {
                let span = field.name_span.clone();
                found.push((vec![field.name], Diagnostic::caused_by(Code::Parameters, span, error)));
                continue;
            }
        };
        let written: Vec<String> = texts
            .iter()
            .filter(|(name, _)| former.fields.contains(name))
            .map(|(name, _)| format!("`{name}`"))
            .collect();
        let version = format!("version {} or earlier of the kind `{}`", former.last, kind.name);
        let message = format!("`{}` no longer has {}", kind.camel_name(), written.join(", "));
        let mistake = Diagnostic::of(Code::UnknownField, field.name_span.clone(), message)
            .label(former.instead)
            .hint(format!(
                "recipes and bundles that use the removed parameters need an older lightharmony, with {version}"
            ));
        found.push((former.fields.to_vec(), mistake));
    }
    found
}

fn wiring_of(node: &Arc<Node>) -> Vec<(usize, Range<usize>)> {
    node.inputs.iter().flatten().map(|wire| (wire.node, 0..0)).collect()
}
