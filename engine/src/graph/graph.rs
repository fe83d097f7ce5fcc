//! The checked graph, ready to run.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use crate::graph::node::{Node, Wire};
use crate::kind::context::{Point, Scene};
use crate::kind::contract::ViewCount;
use crate::kind::port::Wired;
use crate::text::diag::{Code, Diagnostic, Diagnostics};
use crate::text::source::Source;
use crate::value::error::NodeError;
use crate::value::root::SourceRoot;

/// A graph file that can run.
#[derive(Clone)]
pub struct Graph {
    /// The text it came from.
    pub source: Source,
    /// What every node shares.
    pub scene: Scene,
    /// Nodes in the order of the file.
    pub nodes: Vec<Arc<Node>>,
    /// Resolves the paths in it.
    pub root: SourceRoot,
    /// Whether it is one file in which each node stands once, in order.
    pub(crate) plain: bool,
    /// Where each node begins in the text.
    starts: Vec<usize>,
    links: Arc<Links>,
}

/// How nodes follow from one another.
struct Links {
    order: Vec<usize>,
    reads: Lists,
    consumers: Lists,
}

/// Many lists of indices, one after another in memory.
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
    /// A graph that was checked before.
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

    /// Where a node begins in the text.
    pub(crate) fn start(&self, node: usize) -> usize {
        self.starts[node]
    }

    /// How many nodes begin before a place of the text, in a graph that is [`plain`](Self::plain).
    pub(crate) fn begun_before(&self, place: usize) -> usize {
        self.starts.partition_point(|start| *start < place)
    }

    /// Moves where nodes begin, from one of them on.
    pub(crate) fn move_starts(&mut self, first: usize, moved: &impl Fn(usize) -> usize) {
        self.starts[first..].iter_mut().for_each(|start| *start = moved(*start));
    }

    /// Where a field of a node stands in the text, or the whole node.
    pub(crate) fn place(&self, node: usize, field: Option<&str>) -> Range<usize> {
        let (start, node) = (self.starts[node], &self.nodes[node]);
        let place = node.place(field);
        // What is laid over a node stands elsewhere, and no graph that has such was edited.
        let moved = |at: usize| at.wrapping_sub(node.span.start).wrapping_add(start);
        moved(place.start)..moved(place.end)
    }

    /// Finds the files that nodes read, as far as their headers tell, and what is wrong with them. A run finds
    /// it, too, but only when it comes to the node.
    ///
    /// # Errors
    /// Every file that is missing or of no known format.
    pub fn check_sources(&self) -> Result<(), Diagnostics> {
        let mut mistakes = Vec::new();
        for (index, node) in self.nodes.iter().enumerate() {
            let error = match node.step.sources(&self.root) {
                Err(error) => error,
                Ok(sources) => match sources.iter().find(|source| !source.path.is_file()) {
                    Some(source) => NodeError::new(format!("`{}` is no file", source.path.display())),
                    None => continue,
                },
            };
            let field = error.field.or(node.kind.source_param());
            let mut mistake = Diagnostic::of(Code::MissingFile, self.place(index, field), error.message());
            mistake.hints.extend(error.hint);
            mistakes.push(mistake);
        }
        if mistakes.is_empty() { Ok(()) } else { Err(Diagnostics::new(self.source.clone(), mistakes)) }
    }

    /// Every node, inputs before what reads them.
    pub fn order(&self) -> &[usize] {
        &self.links.order
    }

    /// The nodes whose outputs `node` reads, each once, by index.
    pub fn reads(&self, node: usize) -> &[usize] {
        self.links.reads.get(node)
    }

    /// The nodes that read an output of `node`, each once, in the order of the file.
    pub fn consumers(&self, node: usize) -> &[usize] {
        self.links.consumers.get(node)
    }

    /// For each input port of a node, the names of the outputs its wires come from.
    pub(crate) fn wired(&self, node: usize) -> Wired {
        let node = &self.nodes[node];
        let name = |wire: &Wire| self.nodes[wire.node].kind.outputs[wire.port].name;
        let ports = node.kind.inputs.iter().zip(&node.inputs);
        Wired(ports.map(|(port, wires)| (port.name, wires.iter().map(name).collect())).collect())
    }

    /// What can be wrong only between nodes that are right each: wires that do not go together, and sinks
    /// with one path for many views, as far as their number is known before anything runs.
    pub(crate) fn check_between(&self) -> Vec<Diagnostic> {
        let mut mistakes = Vec::new();
        for (index, node) in self.nodes.iter().enumerate() {
            if let Err(error) = node.step.check_wires(&self.wired(index)) {
                let mut mistake =
                    Diagnostic::of(Code::Wiring, self.place(index, error.field), error.message());
                mistake.hints.extend(error.hint);
                mistakes.push(mistake);
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
                Ok(ViewCount::Unknown) => None,
                Ok(ViewCount::Known(count)) => Some(count),
                Ok(ViewCount::As(inputs)) => inputs.iter().find_map(of_input),
                Err(error) => {
                    let mut mistake =
                        Diagnostic::of(Code::Wiring, self.place(index, error.field), error.message());
                    mistake.hints.extend(error.hint);
                    mistakes.push(mistake);
                    None
                }
            };
        }
        for index in sinks {
            let node = &self.nodes[index];
            if let (Some(views @ 2..), Some(path)) = (views[index], &node.sink_path) {
                let what = format!("`{path}` names one file, but {views} views come to it");
                let hint = format!("put `{{view}}` into the path: \"{}\"", with_view(path));
                mistakes
                    .push(Diagnostic::of(Code::OutputPath, self.place(index, Some("path")), what).hint(hint));
            }
        }
        mistakes
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

    /// The files that parameters name, without a look at what these name.
    pub(crate) fn named_files(&self) -> impl Iterator<Item = PathBuf> {
        let readers = self.nodes.iter().filter(|node| node.kind.reads_files);
        readers.flat_map(|node| node.named_files(&self.root))
    }

    /// Whether the other graph says the same, wherever it stands in its file.
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

    /// The value of a parameter that is a whole number.
    pub fn number(&self, node: usize, parameter: &str) -> Option<u64> {
        if !self.nodes[node].kind.params.iter().any(|param| param.name == parameter) {
            return None;
        }
        let values = self.nodes[node].values();
        values.iter().find(|(name, _)| *name == parameter)?.1.parse().ok()
    }

    /// The nodes of a name: one, all of a subgraph, or every instance of a node that axes multiply; of these those
    /// that stand at the values that the name has: `shot/y=2` of `shot/x=1/y=2`.
    pub fn find_all(&self, id: &str) -> Vec<usize> {
        let (name, values) = id.split_once('/').map_or((id, None), |(name, values)| (name, Some(values)));
        let is = |node: &Arc<Node>| {
            let segments: Vec<String> = node.point.iter().map(segment).collect();
            let length: usize = segments.iter().map(String::len).sum();
            let plain = node.id.get(..node.id.len().saturating_sub(length)).unwrap_or_default();
            let inside = plain.strip_prefix(name);
            inside.is_some_and(|inside| inside.is_empty() || inside.starts_with('.'))
                && values.is_none_or(|values| stands_at(&segments, values))
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

    /// Marks the nodes that a run comes to: those above `only`, or above the [`targets`](Self::targets) where that is empty.
    pub(crate) fn wanted(&self, only: &[usize]) -> Vec<bool> {
        self.above(&if only.is_empty() { self.targets() } else { only.to_vec() })
    }

    /// Marks the given nodes and everything above them.
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

/// What a value of an axis adds to the name of a node: `/yaw=15.0`.
fn segment((axis, value): &(String, String)) -> String {
    format!("/{axis}={}", value.trim_matches('"'))
}

/// Whether values, `x=1/y=2`, are some of those that a node stands at, in their order. A value may hold slashes itself.
fn stands_at(segments: &[String], values: &str) -> bool {
    let mut rest = Some(values);
    for segment in segments {
        let Some(left) = rest else { break };
        if let Some(after) = left.strip_prefix(&segment[1..])
            && (after.is_empty() || after.starts_with('/'))
        {
            rest = after.strip_prefix('/');
        }
    }
    rest.is_none()
}

/// `out/final.png` to `out/final_{view}.png`.
fn with_view(path: &str) -> String {
    let name = path.rfind('/').map_or(0, |slash| slash + 1);
    let end = path[name..].rfind('.').map_or(path.len(), |dot| name + dot);
    format!("{}_{{view}}{}", &path[..end], &path[end..])
}

/// What a graph consists of beside its text and folder.
pub(crate) struct Parts {
    pub scene: Scene,
    pub nodes: Vec<Arc<Node>>,
    pub order: Vec<usize>,
    pub plain: bool,
}
