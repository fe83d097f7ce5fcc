//! The checked graph.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use crate::graph::axis_names::after_value;
use crate::graph::node::{Node, Wire};
use crate::kind::contract::ViewCount;
use crate::kind::port::Wired;
use crate::kind::scene::{Point, Scene};
use crate::text::diag::{Code, Diagnostic, Diagnostics};
use crate::text::source::Source;
use crate::value::error::NodeError;
use crate::value::root::SourceRoot;

/// A checked graph that can run.
#[derive(Clone)]
pub struct Graph {
    /// The text of the graph.
    pub source: Source,
    /// The `scene` block, which all nodes share.
    pub scene: Scene,
    /// Nodes in the order of the file.
    pub nodes: Vec<Arc<Node>>,
    /// Resolves paths in the graph.
    pub root: SourceRoot,
    /// True if the graph is a single file without axes, gathers and subgraphs.
    pub(crate) plain: bool,
    /// Byte offset of each node in the text.
    starts: Vec<usize>,
    links: Arc<Links>,
}

/// Dependencies between nodes.
struct Links {
    order: Vec<usize>,
    reads: Lists,
    consumers: Lists,
}

/// Lists of indices, stored in one allocation.
#[derive(Default)]
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

    /// The inverse relation: a list for each of `count` items. It contains the indices of the lists that contain
    /// the item, in ascending order.
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
    /// Creates a graph from checked parts.
    pub(crate) fn assemble(source: Source, root: SourceRoot, parts: Parts) -> Self {
        let Parts { scene, nodes, order, plain } = parts;
        let above = |node: &Arc<Node>| {
            let mut above: Vec<usize> = node.inputs.iter().flatten().map(|wire| wire.node).collect();
            above.sort_unstable();
            above.dedup();
            above
        };
        let reads: Lists = nodes.iter().map(above).collect();
        let consumers = reads.reversed(nodes.len());
        let starts = nodes.iter().map(|node| node.span.start).collect();
        Self { source, scene, nodes, root, plain, starts, links: Arc::new(Links { order, reads, consumers }) }
    }

    /// Byte offset of a node in the text.
    pub(crate) fn start(&self, node: usize) -> usize {
        self.starts[node]
    }

    /// Number of nodes whose text begins before the byte offset `place`. The graph must be [`plain`](Self::plain).
    pub(crate) fn begun_before(&self, place: usize) -> usize {
        self.starts.partition_point(|start| *start < place)
    }

    /// Replaces the byte offset of each node with an index of at least `first` with `moved(offset)`.
    pub(crate) fn move_starts(&mut self, first: usize, moved: &impl Fn(usize) -> usize) {
        self.starts[first..].iter_mut().for_each(|start| *start = moved(*start));
    }

    /// Byte range of a field of a node in the text of the graph. The range of the whole node if `field` is `None`
    /// or the node does not set the field.
    pub fn place(&self, node: usize, field: Option<&str>) -> Range<usize> {
        let (start, node) = (self.starts[node], &self.nodes[node]);
        let place = node.place(field);
        // Overlays are outside the node, but a graph with overlays is never edited in place.
        let moved = |at: usize| at.wrapping_sub(node.span.start).wrapping_add(start);
        moved(place.start)..moved(place.end)
    }

    /// Checks the source files of all nodes, reading headers only. A run detects the same mistakes, but only when
    /// it reaches the node.
    ///
    /// # Errors
    /// Every file that is missing or has an unknown format.
    pub fn check_sources(&self) -> Result<(), Diagnostics> {
        let mut mistakes = Vec::new();
        for (index, node) in self.nodes.iter().enumerate() {
            let error = match node.step.sources(&self.root) {
                Err(error) => error,
                Ok(sources) => match sources.iter().find(|source| !source.path.is_file()) {
                    Some(source) => NodeError::new(format!("`{}` is not a file", source.path.display())),
                    None => continue,
                },
            };
            let field = error.field.or(node.kind.source_param());
            let place = self.place(index, field);
            mistakes.push(Diagnostic::caused_by(Code::MissingFile, place, error));
        }
        if mistakes.is_empty() { Ok(()) } else { Err(Diagnostics::new(self.source.clone(), mistakes)) }
    }

    /// All nodes in topological order: each node comes after the nodes that it reads.
    pub fn order(&self) -> &[usize] {
        &self.links.order
    }

    /// Indices of the nodes that `node` reads, without duplicates.
    pub fn reads(&self, node: usize) -> &[usize] {
        self.links.reads.get(node)
    }

    /// Indices of the nodes that read `node`, without duplicates, in the order of the file.
    pub fn consumers(&self, node: usize) -> &[usize] {
        self.links.consumers.get(node)
    }

    /// For each input port of a node, the names of the outputs that its wires come from.
    pub(crate) fn wired(&self, node: usize) -> Wired {
        let node = &self.nodes[node];
        let name = |wire: &Wire| self.nodes[wire.node].kind.outputs[wire.port].name;
        let ports = node.kind.inputs.iter().zip(&node.inputs);
        Wired(ports.map(|(port, wires)| (port.name, wires.iter().map(name).collect())).collect())
    }

    /// Checks that concern several nodes. Rejects invalid combinations of wires, and sinks that would write several
    /// views to one path. Such a sink is found only if its number of views is known before the run.
    pub(crate) fn check_between(&self) -> Vec<Diagnostic> {
        let mut mistakes = Vec::new();
        for (index, node) in self.nodes.iter().enumerate() {
            if let Err(error) = node.step.check_wires(&self.wired(index)) {
                let place = self.place(index, error.field);
                mistakes.push(Diagnostic::caused_by(Code::Wiring, place, error));
            }
            for (port, wire) in node
                .inputs
                .iter()
                .enumerate()
                .flat_map(|(port, wires)| wires.iter().map(move |wire| (port, wire)))
            {
                let above = &self.nodes[wire.node];
                if let Err(error) = above.step.check_output(above.kind.outputs[wire.port].name) {
                    let place = self.place(index, Some(node.kind.inputs[port].name));
                    mistakes.push(Diagnostic::caused_by(Code::Wiring, place, error));
                }
            }
        }
        let one_file =
            |node: &Arc<Node>| node.sink_path.as_ref().is_some_and(|path| !path.contains("{view}"));
        let sinks: Vec<usize> = (0..self.nodes.len()).filter(|&n| one_file(&self.nodes[n])).collect();
        let above = self.above(&sinks);
        let mut views = vec![None; self.nodes.len()];
        for &index in self.links.order.iter().filter(|&&index| above[index]) {
            let node = &self.nodes[index];
            let of_input = |name: &&str| {
                let port = node.kind.inputs.iter().position(|port| port.name == *name)?;
                node.inputs[port].first().and_then(|wire| views[wire.node])
            };
            views[index] = match node.step.views(&self.root) {
                Ok(ViewCount::Unknown | ViewCount::Uncounted { .. }) => None,
                Ok(ViewCount::Known(count)) => Some(count),
                Ok(ViewCount::As(inputs)) => inputs.iter().find_map(of_input),
                Err(error) => {
                    let place = self.place(index, error.field);
                    mistakes.push(Diagnostic::caused_by(Code::Wiring, place, error));
                    None
                }
            };
        }
        for index in sinks {
            let node = &self.nodes[index];
            if let (Some(views @ 2..), Some(path)) = (views[index], &node.sink_path) {
                let what = format!("`{path}` names one file, but there are {views} views");
                let hint = format!("put `{{view}}` into the path: \"{}\"", with_view(path));
                mistakes
                    .push(Diagnostic::of(Code::OutputPath, self.place(index, Some("path")), what).hint(hint));
            }
        }
        mistakes
    }

    /// For each input port of a node, the axis values of the nodes that its wires come from.
    pub(crate) fn points(&self, node: usize) -> Vec<(&'static str, Vec<Point>)> {
        let node = &self.nodes[node];
        let point = |wire: &Wire| self.nodes[wire.node].point.clone();
        let ports = node.kind.inputs.iter().zip(&node.inputs);
        ports.map(|(port, wires)| (port.name, wires.iter().map(point).collect())).collect()
    }

    /// The source files of all nodes, found by reading headers only.
    pub fn files(&self) -> Vec<PathBuf> {
        let mut files = Vec::new();
        for node in self.nodes.iter().filter(|node| node.kind.reads_files) {
            // A file that cannot be read may be repaired, which is a change. So the named files are returned.
            match node.step.sources(&self.root) {
                Ok(sources) => files.extend(sources.into_iter().map(|source| source.path)),
                Err(_) => files.extend(node.named_files(&self.root)),
            }
        }
        files
    }

    /// The files named by parameters. Files that these files refer to are not included.
    pub(crate) fn named_files(&self) -> impl Iterator<Item = PathBuf> {
        let readers = self.nodes.iter().filter(|node| node.kind.reads_files);
        readers.flat_map(|node| node.named_files(&self.root))
    }

    /// True if another graph has the same meaning. The layout of the text does not matter.
    pub fn same(&self, other: &Graph) -> bool {
        let alike = |(a, b): (&Arc<Node>, &Arc<Node>)| {
            Arc::ptr_eq(a, b)
                || (&a.id, a.kind.name, &a.inputs, &a.sink_path)
                    == (&b.id, b.kind.name, &b.inputs, &b.sink_path)
                    && a.values() == b.values()
        };
        self.scene == other.scene
            && self.root.folder() == other.root.folder()
            && self.nodes.len() == other.nodes.len()
            && self.nodes.iter().zip(&other.nodes).all(alike)
    }

    /// The value of a parameter of a node. `None` if the value is not a whole number, or if the node has no such
    /// parameter.
    pub fn number(&self, node: usize, parameter: &str) -> Option<u64> {
        if !self.nodes[node].kind.params.iter().any(|param| param.name == parameter) {
            return None;
        }
        let values = self.nodes[node].values();
        values.iter().find(|(name, _)| *name == parameter)?.1.parse().ok()
    }

    /// Indices of the nodes that a name refers to: one node, all nodes of a subgraph, or all instances of a node
    /// along axes. If the name contains axis values, only the instances with these values: `shot/y=2` matches
    /// `shot/x=1/y=2`.
    pub fn find_all(&self, id: &str) -> Vec<usize> {
        let (name, values) = id.split_once('/').map_or((id, None), |(name, values)| (name, Some(values)));
        let is = |node: &Arc<Node>| {
            let segments: Vec<String> = node.point.iter().map(segment).collect();
            let length: usize = segments.iter().map(String::len).sum();
            let plain = node.id.get(..node.id.len().saturating_sub(length)).unwrap_or_default();
            let inside = plain.strip_prefix(name);
            inside.is_some_and(|inside| inside.is_empty() || inside.starts_with('.'))
                && values.is_none_or(|values| stands_at(&node.point, values))
        };
        (0..self.nodes.len()).filter(|&index| is(&self.nodes[index])).collect()
    }

    /// Index of the node with the name `id`.
    pub fn find(&self, id: &str) -> Option<usize> {
        self.nodes.iter().position(|node| node.id == id)
    }

    /// Indices of the default targets of a run. These are the sinks or, if the graph has no sinks, the nodes whose
    /// outputs are not read by any node.
    pub fn targets(&self) -> Vec<usize> {
        let all = 0..self.nodes.len();
        let sinks: Vec<usize> = all.clone().filter(|&n| self.nodes[n].sink_path.is_some()).collect();
        if sinks.is_empty() { all.filter(|&n| self.consumers(n).is_empty()).collect() } else { sinks }
    }

    /// For each node, true if a run with the targets `only` needs it. An empty list stands for
    /// [`targets`](Self::targets).
    pub(crate) fn wanted(&self, only: &[usize]) -> Vec<bool> {
        self.above(&if only.is_empty() { self.targets() } else { only.to_vec() })
    }

    /// For each node, true if it is one of the targets or upstream of one.
    pub fn above(&self, targets: &[usize]) -> Vec<bool> {
        let mut wanted = vec![false; self.nodes.len()];
        for &target in targets {
            wanted[target] = true;
        }
        for &node in self.links.order.iter().rev() {
            if wanted[node] {
                for &above in self.reads(node) {
                    wanted[above] = true;
                }
            }
        }
        wanted
    }
}

/// The suffix of a node name for an axis value, such as `/yaw=15.0`.
fn segment((axis, value): &(String, String)) -> String {
    format!("/{axis}={}", value.trim_matches('"'))
}

/// True if `values`, such as `x=1/y=2`, is a subsequence of `point`, the axis values of a node. In `values`,
/// `x=1..3` matches every value in the range.
fn stands_at(point: &[(String, String)], values: &str) -> bool {
    let mut left = values;
    for (axis, value) in point {
        let after = after_value(left, axis, value.trim_matches('"'));
        if after.is_empty() && !left.is_empty() {
            return true;
        }
        left = after;
    }
    false
}

/// Inserts `{view}` into an output path: `out/final.png` becomes `out/final_{view}.png`.
fn with_view(path: &str) -> String {
    let name = path.rfind('/').map_or(0, |slash| slash + 1);
    let end = path[name..].rfind('.').map_or(path.len(), |dot| name + dot);
    format!("{}_{{view}}{}", &path[..end], &path[end..])
}

/// The parts of a checked graph except its text and root.
pub(crate) struct Parts {
    pub scene: Scene,
    pub nodes: Vec<Arc<Node>>,
    pub order: Vec<usize>,
    pub plain: bool,
}
