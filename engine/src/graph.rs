//! The checked graph, ready to run.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use crate::check::Check;
use crate::compiled::{LazyStep, Parts};
use crate::context::{Point, Scene};
use crate::diag::{Diagnostics, Source};
use crate::include::parse_all;
use crate::kind::{KindEntry, Registry, Step};
use crate::order::{describe_cycle, order_of};
use crate::param::{InputFile, Role};
use crate::root::SourceRoot;
use crate::syntax::{Fields, RawField};

/// One end of a wire: an output of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Wire {
    /// Index into [`Graph::nodes`].
    pub node: usize,
    /// Index into the outputs of its kind.
    pub port: usize,
}

/// A node whose every field is right.
#[derive(Clone)]
pub struct Node {
    /// Name in the file; with axes the name of the instance: `trace/yaw=15.0`.
    pub id: String,
    /// What it does.
    pub kind: Arc<KindEntry>,
    /// For each input port of the kind, its wires in order.
    pub inputs: Vec<Vec<Wire>>,
    /// The path a sink writes to, with its placeholders.
    pub sink_path: Option<String>,
    /// The value of each axis that it or its inputs read, in the order of the axes: `("yaw", "15.0")`.
    pub point: Point,
    /// Where it stands in the text.
    pub span: Range<usize>,
    pub(crate) fields: Vec<(&'static str, Range<usize>)>,
    pub(crate) step: LazyStep,
}

impl Node {
    /// Where a field stands in the text, or the whole node.
    pub(crate) fn place(&self, field: Option<&str>) -> Range<usize> {
        let named = field.and_then(|name| self.fields.iter().find(|(known, _)| *known == name));
        named.map_or(self.span.clone(), |(_, span)| span.clone())
    }

    /// Every parameter with its value in canonical text.
    pub(crate) fn values(&self) -> Vec<(&'static str, String)> {
        let mut values = Vec::with_capacity(self.kind.params.len());
        // A value that is not canonical was refused when the graph was checked.
        self.step.visit(&mut |name, value| values.extend(value.text().ok().map(|text| (name, text))));
        values
    }

    /// What the node does with another value of one parameter; `None` where its kind refuses that.
    fn with(&self, parameter: &str, text: &str) -> Option<Arc<dyn Step>> {
        let mut values = self.values();
        values.iter_mut().find(|(name, _)| *name == parameter)?.1 = text.to_owned();
        let field = |(name, text)| RawField { name, name_span: 0..0, text, span: 0..0 };
        let fields: Vec<RawField<'_>> =
            values.iter().map(|(name, text)| field((*name, text.as_str()))).collect();
        let mut diagnostics = Vec::new();
        let kind = self.kind.name;
        let step = (self.kind.read)(&mut Fields {
            fields: &fields,
            node_span: 0..0,
            kind,
            diagnostics: &mut diagnostics,
        })?;
        step.check().is_ok().then_some(step)
    }

    /// The files that its parameters name.
    fn named_files(&self, root: &SourceRoot) -> Vec<PathBuf> {
        let mut files = Vec::new();
        let is_file = |name| self.kind.params.iter().any(|p| p.name == name && p.role == Role::Input);
        self.step.visit(&mut |name, value| {
            if is_file(name) {
                files.extend(
                    value.paths().into_iter().map(|path| root.file(&InputFile(path.to_owned())).path),
                );
            }
        });
        files
    }
}

fn wiring_of(node: &Node) -> Vec<(usize, Range<usize>)> {
    node.inputs.iter().flatten().map(|wire| (wire.node, 0..0)).collect()
}

/// A graph file that can run.
#[derive(Clone)]
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
    reads: Lists,
    consumers: Lists,
}

/// Many lists of indices, one after another in memory.
#[derive(Default, Clone)]
pub(crate) struct Lists {
    ends: Vec<usize>,
    items: Vec<usize>,
}

impl Lists {
    fn push(&mut self, list: impl IntoIterator<Item = usize>) {
        self.items.extend(list);
        self.ends.push(self.items.len());
    }

    fn get(&self, index: usize) -> &[usize] {
        let start = index.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.items[start..self.ends[index]]
    }

    /// For each of `count` items the lists that hold it, in order.
    fn reversed(&self, count: usize) -> Self {
        let mut ends = vec![0; count];
        self.items.iter().for_each(|&item| ends[item] += 1);
        let mut next = vec![0; count];
        let mut total = 0;
        for (end, next) in ends.iter_mut().zip(&mut next) {
            *next = total;
            total += *end;
            *end = total;
        }
        let mut items = vec![0; total];
        for list in 0..self.ends.len() {
            for &item in self.get(list) {
                items[next[item]] = list;
                next[item] += 1;
            }
        }
        Self { ends, items }
    }
}

impl FromIterator<Vec<usize>> for Lists {
    fn from_iter<I: IntoIterator<Item = Vec<usize>>>(lists: I) -> Self {
        let mut all = Self::default();
        lists.into_iter().for_each(|list| all.push(list));
        all
    }
}

impl Graph {
    /// Reads and checks a graph file, whose paths are relative to `folder`.
    pub fn parse(source: Source, registry: &Registry, root: SourceRoot) -> Result<Self, Diagnostics> {
        let joined = source.clone();
        let mut diagnostics = Vec::new();
        let document = parse_all(&joined, &mut diagnostics);
        let mut check = Check::new(&joined.text, registry, &root, &document, &mut diagnostics);
        let scene = check.document(&document);
        let (templates, mut wiring) = check.nodes(&document.nodes);
        let mut order = order_of(&wiring);
        if let Err(cycles) = &order {
            cycles.iter().for_each(|cycle| check.report(describe_cycle(&document.nodes, &wiring, cycle)));
        }
        let nodes = match &order {
            Ok(files_first) if check.is_multiple() && check.mistakes() == 0 => {
                let nodes = check.instances(&templates, files_first);
                wiring = nodes.iter().map(wiring_of).collect();
                order = order_of(&wiring);
                nodes
            }
            _ => templates.into_iter().flatten().map(|template| template.node).collect(),
        };
        let files = check.files;
        match (scene, order) {
            (Some(scene), Ok(order)) if diagnostics.is_empty() => {
                Ok(Self::assemble(source, root, Parts { scene, nodes, order }))
            }
            _ => Err(Diagnostics { files, ..Diagnostics::new(source, diagnostics) }),
        }
    }

    /// A graph that was checked before.
    pub(crate) fn assemble(source: Source, root: SourceRoot, parts: Parts) -> Self {
        let Parts { scene, nodes, order } = parts;
        let above = |node: &Node| {
            let mut above: Vec<usize> = node.inputs.iter().flatten().map(|wire| wire.node).collect();
            above.sort_unstable();
            above.dedup();
            above
        };
        let reads: Lists = nodes.iter().map(above).collect();
        let consumers = reads.reversed(nodes.len());
        Self { source, scene, nodes, root, order, reads, consumers }
    }

    /// Every node, inputs before what reads them.
    pub fn order(&self) -> &[usize] {
        &self.order
    }

    /// The nodes whose outputs `node` reads, each once, by index.
    pub fn reads(&self, node: usize) -> &[usize] {
        self.reads.get(node)
    }

    /// The nodes that read an output of `node`, each once, in the order of the file.
    pub fn consumers(&self, node: usize) -> &[usize] {
        self.consumers.get(node)
    }

    /// For each input port of a node, the names of the outputs its wires come from.
    pub(crate) fn wired(&self, node: usize) -> Vec<(&'static str, Vec<&'static str>)> {
        let node = &self.nodes[node];
        let name = |wire: &Wire| self.nodes[wire.node].kind.outputs[wire.port].name;
        let ports = node.kind.inputs.iter().zip(&node.inputs);
        ports.map(|(port, wires)| (port.name, wires.iter().map(name).collect())).collect()
    }

    /// For each input port of a node, the points of the nodes that its wires come from.
    pub(crate) fn points(&self, node: usize) -> Vec<(&'static str, Vec<Point>)> {
        let node = &self.nodes[node];
        let point = |wire: &Wire| self.nodes[wire.node].point.clone();
        let ports = node.kind.inputs.iter().zip(&node.inputs);
        ports.map(|(port, wires)| (port.name, wires.iter().map(point).collect())).collect()
    }

    /// The files that nodes read, as far as that can be told without reading them through.
    pub fn files(&self) -> Vec<PathBuf> {
        let mut files = Vec::new();
        for node in self.nodes.iter().filter(|node| node.kind.reads_files) {
            // A file that cannot be read is the failure of its node, and its repair is a change.
            match node.step.sources(&self.root) {
                Ok(sources) => files.extend(sources.into_iter().map(|source| source.path)),
                Err(_) => files.extend(node.named_files(&self.root)),
            }
        }
        files
    }

    /// Whether the other graph says the same, wherever it stands in its file.
    pub fn same(&self, other: &Graph) -> bool {
        let alike = |(a, b): (&Node, &Node)| {
            (&a.id, a.kind.name, &a.inputs, &a.sink_path) == (&b.id, b.kind.name, &b.inputs, &b.sink_path)
                && a.values() == b.values()
        };
        self.scene == other.scene
            && self.root.folder() == other.root.folder()
            && self.nodes.len() == other.nodes.len()
            && self.nodes.iter().zip(&other.nodes).all(alike)
    }

    /// The value of a parameter that is a whole number.
    pub fn number(&self, node: usize, parameter: &str) -> Option<u64> {
        let values = self.nodes[node].values();
        values.iter().find(|(name, _)| *name == parameter)?.1.parse().ok()
    }

    /// The same graph with a parameter at most `level` in every node that has it, and the nodes where that
    /// makes a difference; `None` where there is none.
    pub fn capped(&self, parameter: &str, level: u64) -> Option<(Self, Vec<usize>)> {
        let over = |&node: &usize| self.number(node, parameter).is_some_and(|number| number > level);
        let capped: Vec<usize> = (0..self.nodes.len()).filter(over).collect();
        let mut graph = self.clone();
        for &index in &capped {
            graph.nodes[index].step = self.nodes[index].with(parameter, &level.to_string())?.into();
        }
        (!capped.is_empty()).then_some((graph, capped))
    }

    /// The nodes of a name: one, or every instance of a node that axes multiply.
    pub fn find_all(&self, id: &str) -> Vec<usize> {
        let is = |node: &Node| {
            node.id
                .strip_prefix(id)
                .is_some_and(|rest| rest.is_empty() || (rest.starts_with('/') && !node.point.is_empty()))
        };
        (0..self.nodes.len()).filter(|&index| is(&self.nodes[index])).collect()
    }

    /// Index of a node by name.
    pub fn find(&self, id: &str) -> Option<usize> {
        self.nodes.iter().position(|node| node.id == id)
    }

    /// The nodes a run wants by default: the sinks, or those that nothing reads where there is no sink.
    pub fn targets(&self) -> Vec<usize> {
        let all = 0..self.nodes.len();
        let sinks: Vec<usize> = all.clone().filter(|&n| self.nodes[n].sink_path.is_some()).collect();
        if sinks.is_empty() { all.filter(|&n| self.consumers(n).is_empty()).collect() } else { sinks }
    }

    /// Marks the given nodes and everything above them.
    pub fn above(&self, targets: &[usize]) -> Vec<bool> {
        let mut wanted = vec![false; self.nodes.len()];
        for &target in targets {
            wanted[target] = true;
        }
        for &node in self.order.iter().rev() {
            if wanted[node] {
                for &above in self.reads(node) {
                    wanted[above] = true;
                }
            }
        }
        wanted
    }
}
