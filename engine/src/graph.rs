//! The checked graph, ready to run.

use std::ops::Range;
use std::sync::Arc;

use crate::check::Check;
use crate::context::{Scene, SourceRoot};
use crate::diag::{Diagnostics, Source};
use crate::kind::{KindEntry, Registry, Step};
use crate::order::{describe_cycle, distinct, order_of};
use crate::syntax::parse;

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
    pub(crate) fields: Vec<(&'static str, Range<usize>)>,
    pub(crate) step: Arc<dyn Step>,
}

impl Node {
    /// Where a field stands in the text, or the whole node.
    pub(crate) fn place(&self, field: Option<&str>) -> Range<usize> {
        let named = field.and_then(|name| self.fields.iter().find(|(known, _)| *known == name));
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
        let mut check = Check::new(&text, registry, &root, &document, &mut diagnostics);
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
