//! The knobs of a graph, and the presets that set many knobs at once.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use crate::graph::graph::Graph;
use crate::graph::node::Node;
use crate::graph::wires::wire_names;
use crate::kind::knob::Knob;
use crate::kind::registry::Registry;
use crate::text::document::{Document, RawField};
use crate::text::include::parse_all;
use crate::text::overlay::{PRESETS, overlay_text};
use crate::text::source::Source;
use crate::value::root::SourceRoot;

/// A knob of a node.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GraphKnob {
    /// Name of the node in the file. All instances of the node along axes share it.
    pub node: String,
    /// Name of the parameter.
    pub parameter: &'static str,
    /// The declaration of the knob.
    pub knob: Knob,
    /// The value in the graph, in canonical RON. For a node with instances along axes, the value of the first
    /// instance.
    pub value: String,
    /// Names of the targets that depend on the knob.
    pub reaches: Vec<String>,
    /// True if the knob has different values in different instances of the node.
    pub varies: bool,
}

/// The name that the node `id` has in the graph file. If the node is an instance, its axis values are removed from
/// `id`.
fn name_in_file(id: &str, instance: bool) -> &str {
    if instance { id.split('/').next().unwrap_or(id) } else { id }
}

impl Graph {
    /// The knobs of the nodes upstream of the given targets, in the order of the file. An empty list stands for
    /// [`Graph::targets`].
    pub fn knobs(&self, only: &[usize]) -> Vec<GraphKnob> {
        let targets = if only.is_empty() { self.targets() } else { only.to_vec() };
        let above: Vec<(usize, Vec<bool>)> = targets.iter().map(|&to| (to, self.shown_by(to))).collect();
        let mut knobs: Vec<GraphKnob> = Vec::new();
        for (index, node) in self.nodes.iter().enumerate() {
            let name = name_in_file(&node.id, !node.point.is_empty());
            let below = above.iter().filter(|(_, wanted)| wanted[index]);
            let reaches: Vec<String> = below.map(|(to, _)| self.nodes[*to].id.clone()).collect();
            if reaches.is_empty() || !node.kind.params.iter().any(|spec| spec.knob.is_some()) {
                continue;
            }
            let values = node.values();
            for spec in &node.kind.params {
                let known = knobs.iter_mut().find(|known| known.node == name && known.parameter == spec.name);
                let value = values.iter().find(|(parameter, _)| *parameter == spec.name);
                let value = value.map(|(_, text)| text.clone()).unwrap_or_default();
                match (spec.knob, known) {
                    (Some(_), Some(known)) => known.reaches.extend(reaches.iter().cloned()),
                    (Some(knob), None) => {
                        // All instances count, including those that no target needs, since a setting applies to
                        // all.
                        let others = if node.point.is_empty() { Vec::new() } else { self.find_all(name) };
                        let differs = |other: &usize| {
                            let mut values = self.nodes[*other].values().into_iter();
                            values.any(|(parameter, text)| parameter == spec.name && text != value)
                        };
                        let varies = others.iter().any(differs);
                        let (node, parameter, reaches) = (name.to_owned(), spec.name, reaches.clone());
                        knobs.push(GraphKnob { node, parameter, knob, value, reaches, varies });
                    }
                    (None, _) => {}
                }
            }
        }
        for knob in &mut knobs {
            knob.reaches.sort();
            knob.reaches.dedup();
        }
        knobs
    }

    /// For each node, true if its result is visible in the result of `target`. This holds for the target and for
    /// the nodes upstream of it, except those that are reached only through [`Preview::looks`] inputs.
    ///
    /// [`Preview::looks`]: crate::Preview::looks
    fn shown_by(&self, target: usize) -> Vec<bool> {
        let (mut shown, mut open) = (vec![false; self.nodes.len()], vec![target]);
        while let Some(at) = open.pop() {
            if !std::mem::replace(&mut shown[at], true) {
                let node = &self.nodes[at];
                let ports = node.kind.inputs.iter().zip(&node.inputs);
                let ports = ports.filter(|(port, _)| !node.kind.preview.looks.contains(&port.name));
                open.extend(ports.flat_map(|(_, wires)| wires.iter().map(|wire| wire.node)));
            }
        }
        shown
    }

    /// Compares the parameters of the nodes upstream of the given targets with `other`, another version of this
    /// graph (for example, this graph with a preset). For each parameter that differs: the node, the parameter, and
    /// its canonical values in this graph and in `other`. The comparison leaves out the knobs that [`Graph::knobs`]
    /// lists, and all instances along axes.
    pub fn fields_otherwise(
        &self,
        other: &Self,
        targets: &[usize],
    ) -> Vec<(String, &'static str, [String; 2])> {
        let wanted = self.above(targets);
        let shown: Vec<Vec<bool>> = targets.iter().map(|&to| self.shown_by(to)).collect();
        let others: BTreeMap<&str, &Node> = other.nodes.iter().map(|node| (&*node.id, &**node)).collect();
        let mut fields = Vec::new();
        for (index, node) in self.nodes.iter().enumerate() {
            let Some(other) = others.get(&*node.id).filter(|_| wanted[index] && node.point.is_empty()) else {
                continue;
            };
            for ((parameter, here), (_, there)) in node.values().into_iter().zip(other.values()) {
                let knob = node.kind.params.iter().any(|spec| spec.name == parameter && spec.knob.is_some());
                let knob = knob && shown.iter().any(|shown| shown[index]);
                if here != there && !knob {
                    fields.push((node.id.clone(), parameter, [here, there]));
                }
            }
        }
        fields
    }
}

/// True if a field varies along an axis. Presets do not change such fields.
fn varies(field: &RawField<'_>) -> bool {
    ["Axis(", "Track("].iter().any(|call| field.text.contains(call))
}

/// For each node, true if it affects results only through [`Preview::looks`] inputs.
///
/// [`Preview::looks`]: crate::Preview::looks
fn looked_at(document: &Document<'_>, registry: &Registry) -> Vec<bool> {
    let nodes = &document.nodes;
    let ids: BTreeMap<&str, usize> = nodes.iter().enumerate().map(|(at, node)| (&*node.id, at)).collect();
    // The readers of each node, and whether the input is one of `looks`.
    let mut readers = vec![Vec::new(); nodes.len()];
    for (reader, node) in nodes.iter().enumerate() {
        let Some(kind) = registry.get(node.kind) else { continue };
        for port in &kind.inputs {
            let Some(field) = node.fields.iter().find(|field| field.name == port.name) else { continue };
            // Mistakes in wires are reported by the check. A gather counts as a reader.
            for named in wire_names(field, &document.scopes).unwrap_or_default() {
                let whole = format!("{}{}", document.scopes[named.scope].prefix, named.name);
                let found = ids.get(&*whole).or_else(|| ids.get(whole.rsplit_once('.')?.0));
                if let Some(&at) = found {
                    readers[at].push((reader, kind.preview.looks.contains(&port.name)));
                }
            }
        }
    }
    // Nodes without readers are shown, and so are the nodes that they read through other inputs than `looks`.
    let (mut shown, mut above) = (vec![false; nodes.len()], vec![Vec::new(); nodes.len()]);
    for (at, readers) in readers.iter().enumerate() {
        readers.iter().filter(|(_, looks)| !looks).for_each(|(reader, _)| above[*reader].push(at));
    }
    let mut open: Vec<usize> = (0..nodes.len()).filter(|&at| readers[at].is_empty()).collect();
    while let Some(at) = open.pop() {
        if !std::mem::replace(&mut shown[at], true) {
            open.extend(&above[at]);
        }
    }
    shown.into_iter().map(|shown| !shown).collect()
}

impl Source {
    /// The names of the presets of the graph and its included files, without duplicates. Mistakes in the text are
    /// ignored here, since the check reports them.
    pub fn own_presets(&self, root: &SourceRoot) -> Vec<String> {
        let document = parse_all(self, root, &mut Vec::new());
        let mut names: Vec<String> = document.presets.iter().map(|preset| preset.name.to_owned()).collect();
        let mut seen = BTreeSet::new();
        names.retain(|name| seen.insert(name.clone()));
        names
    }

    /// Applies a preset: one that the graph defines, or one of [`PRESETS`]. A preset of [`PRESETS`] sets the knobs
    /// of all nodes to the step of their ladders that belongs to the preset.
    pub fn with_preset(self, preset: &str, registry: &Registry) -> Self {
        // Mistakes in the text are reported by the check.
        let document = parse_all(&self, &SourceRoot::new(""), &mut Vec::new());
        let level = PRESETS.iter().position(|name| *name == preset);
        let (Some(level), false) = (level, document.presets.iter().any(|own| own.name == preset)) else {
            return self.with_own_preset(preset);
        };
        let (mut fields, looks) = (Vec::new(), looked_at(&document, registry));
        for (node, _) in document.nodes.iter().zip(looks).filter(|(_, looked_at)| !looked_at) {
            let specs = registry.get(node.kind).map_or(&[][..], |kind| kind.params.as_slice());
            for spec in specs {
                let own = node.fields.iter().find(|field| field.name == spec.name);
                let value = spec.knob.map_or("", |knob| knob.ladder[level]);
                if !value.is_empty() && !own.is_some_and(varies) {
                    fields.push((&*node.id, spec.name, value));
                }
            }
        }
        let text = overlay_text(fields);
        self.with_built_in_preset(preset, &text)
    }
}
