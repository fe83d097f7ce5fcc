//! Compiled graphs: a checked graph as bytes, kept under the digest of its text, so that a large file that did
//! not change is neither parsed nor checked again.
//!
//! Names, wires and the walk of each node's parameters for its key are ready to use; the parameters
//! themselves are text, read when the node's code is wanted. A graph is checked anew when its text, its
//! folder, a kind of its nodes, the program, or a file that it names is another one.

use crate::graph::graph::Parts;
use crate::graph::lazy::LazyStep;
use crate::graph::lazy::Places;
use crate::graph::lazy::Stored;
use crate::graph::lazy::span;
use crate::graph::lazy::walk;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use cache::{Digest, FileStamp, KeyWriter, Store};

use crate::graph::graph::Graph;
use crate::graph::node::{Node, Wire};
use crate::kind::context::{Scene, Up};
use crate::kind::param_type::Role;
use crate::kind::port::{Arity, PortSpec};
use crate::kind::registry::{KindEntry, Registry, Step};
use crate::text::diag::Diagnostics;
use crate::text::source::Source;
use crate::value::artifact::{Corrupt, Decoder, Encoder};
use crate::value::root::InputFile;
use crate::value::root::{SourceFile, SourceRoot};

/// Raised when the bytes change their form.
const FORMAT: &str = "lightharmony compiled graph 3";

impl Graph {
    /// Shorter texts are parsed in less time than it takes to look for their compiled form, in bytes.
    pub const WORTH_COMPILING: usize = 16 << 10;

    /// [`Graph::parse`], by way of the compiled graph in `store` where there is one of this text.
    ///
    /// # Errors
    /// Every mistake in the text.
    pub fn parse_cached(
        source: Source,
        registry: &Registry,
        root: SourceRoot,
        store: &Store,
    ) -> Result<Self, Diagnostics> {
        if source.text.len() < Self::WORTH_COMPILING {
            return Self::parse(source, registry, root);
        }
        let key = key(&source.text, &root);
        if let Some(bytes) = load(store, &key)
            && let Ok(parts) = decode(&Arc::new(bytes), &source.text, registry, &root)
        {
            return Ok(Self::assemble(source, root, parts));
        }
        let graph = Self::parse(source, registry, root)?;
        let bytes = encode(&graph);
        // Not kept, it is only parsed again.
        if let Ok(blob) = store.put_blob(&bytes) {
            let _ = store.put_record(&key, blob.as_bytes());
        }
        Ok(graph)
    }
}

fn load(store: &Store, key: &Digest) -> Option<Vec<u8>> {
    let blob = Digest::from_bytes(store.get_record(key)?.try_into().ok()?);
    store.get_blob(&blob).ok()?
}

/// Everything that what was checked depends on, but for the kinds of its nodes and the files it names.
fn key(text: &str, root: &SourceRoot) -> Digest {
    let mut of = Encoder::default();
    of.str(env!("CARGO_PKG_VERSION"));
    of.str(FORMAT);
    // With the folders that a stranger's graph may read: what was checked for one is not for the other.
    of.str(&format!("{root:?}"));
    of.u8s(Digest::of(text.as_bytes()).as_bytes());
    Digest::of(&of.finish())
}

/// What nodes of a kind were checked by.
pub(crate) fn shape(kind: &KindEntry) -> Digest {
    let mut of = Encoder::default();
    of.u32(kind.version);
    of.str(kind.profile);
    for param in &kind.params {
        let (low, high) = param.range.unwrap_or_default();
        of.str(param.name);
        of.str(&(param.default)().unwrap_or_default());
        of.f64s(&[low, high]);
    }
    for port in kind.inputs.iter().chain(&kind.outputs) {
        of.str(port.name);
        of.str(port.artifact.name);
        of.u8(port.arity as u8);
    }
    Digest::of(&of.finish())
}

fn encode(graph: &Graph) -> Vec<u8> {
    let mut to = Encoder::default();
    to.str(graph.scene.up.name());
    to.f64(graph.scene.metres_per_unit);
    to.u64(graph.scene.seed);
    to.u64(graph.scene.exhaustive.into());
    let files = files(graph);
    to.u32(files.len() as u32);
    for (file, stamp) in files {
        to.str(&file);
        to.u8s(&stamp);
    }
    let kinds: BTreeMap<&str, &KindEntry> =
        graph.nodes.iter().map(|node| (node.kind.name, &*node.kind)).collect();
    to.u32(kinds.len() as u32);
    for (name, kind) in &kinds {
        to.str(name);
        to.raw(shape(kind).as_bytes());
    }
    let numbers: BTreeMap<&str, u32> = kinds.keys().copied().zip(0..).collect();
    to.u32(graph.nodes.len() as u32);
    for node in &graph.nodes {
        to.str(&node.id);
        to.u32(numbers[node.kind.name]);
        for wires in &node.inputs {
            to.u32(wires.len() as u32);
            for wire in wires {
                to.u32(wire.node as u32);
                to.u32(wire.port as u32);
            }
        }
        to.bool(node.sink_path.is_some());
        node.sink_path.iter().for_each(|path| to.str(path));
        to.u32(node.point.len() as u32);
        for (axis, value) in &node.point {
            to.str(axis);
            to.str(value);
        }
        span(&mut to, &node.span);
        to.u8s(&node.places.encode(&node.kind));
        to.u8s(&node.texts());
        to.u8s(&key_fields(&*node.step));
    }
    to.u32s(&graph.order().iter().map(|&node| node as u32).collect::<Vec<_>>());
    to.finish()
}

fn decode(
    bytes: &Arc<Vec<u8>>,
    text: &str,
    registry: &Registry,
    root: &SourceRoot,
) -> Result<Parts, Corrupt> {
    let mut from = Decoder::new(bytes);
    let up = Up::try_from(from.str()?).map_err(Corrupt)?;
    let (metres_per_unit, seed, exhaustive) = (from.f64()?, from.u64()?, from.u64()? != 0);
    let scene = Scene { up, metres_per_unit, seed, exhaustive };
    for _ in 0..from.count(12)? {
        let file = root.file(&InputFile(from.str()?));
        if from.raw()? != stamp(&file) {
            return Err(Corrupt("a file was changed".to_owned()));
        }
    }
    let unknown = || Corrupt("a kind is not known".to_owned());
    let mut kinds = Vec::new();
    for _ in 0..from.count(8 + 32)? {
        let kind = registry.get(&from.str()?).ok_or_else(unknown)?;
        if from.array::<32>()? != *shape(kind).as_bytes() {
            return Err(Corrupt("a kind is another one".to_owned()));
        }
        kinds.push(kind.clone());
    }
    let count = from.count(30)?;
    let mut nodes = Vec::with_capacity(count);
    for _ in 0..count {
        let id = from.str()?;
        let kind = kinds.get(from.u32()? as usize).ok_or_else(unknown)?.clone();
        let mut inputs = Vec::with_capacity(kind.inputs.len());
        for _ in &kind.inputs {
            let wires = from.count(8)?;
            let wire = |_| Ok(Wire { node: from.u32()? as usize, port: from.u32()? as usize });
            inputs.push((0..wires).map(wire).collect::<Result<_, Corrupt>>()?);
        }
        let sink_path = if from.bool()? { Some(from.str()?) } else { None };
        let axes = 0..from.count(16)?;
        let point = axes.map(|_| Ok((from.str()?, from.str()?))).collect::<Result<_, Corrupt>>()?;
        let place = read_span(&mut from, text)?;
        let places = Places::Stored(bytes.clone(), from.raw_range(bytes)?);
        let texts = from.raw_range(bytes)?;
        let key_fields = from.raw_range(bytes)?;
        let step = LazyStep::of(Stored { bytes: bytes.clone(), kind: kind.clone(), texts, key_fields });
        nodes.push(Arc::new(Node { id, kind, inputs, sink_path, point, span: place, places, step }));
    }
    let order: Vec<usize> = from.u32s()?.into_iter().map(|node| node as usize).collect();
    from.end()?;
    if !is_sound(&nodes, &order) {
        return Err(Corrupt("its wires do not fit".to_owned()));
    }
    // Nobody edits it: a watch parses.
    Ok(Parts { scene, nodes, order, plain: false })
}

/// Whether the order has every node once and after those it reads, and each wire fits its port.
fn is_sound(nodes: &[Arc<Node>], order: &[usize]) -> bool {
    let mut seen = vec![false; nodes.len()];
    let in_turn = |&index: &usize| {
        let Some(node) = nodes.get(index) else { return false };
        let fits = |(port, wires): (&PortSpec, &Vec<Wire>)| {
            let count = match port.arity {
                Arity::One => wires.len() == 1,
                Arity::Optional => wires.len() <= 1,
                Arity::Many => true,
            };
            let output = |wire: &Wire| nodes.get(wire.node)?.kind.outputs.get(wire.port);
            let typed = |wire| output(wire).is_some_and(|found| found.artifact.name == port.artifact.name);
            count && wires.iter().all(|wire| typed(wire) && seen[wire.node])
        };
        node.kind.inputs.iter().zip(&node.inputs).all(fits) && !std::mem::replace(&mut seen[index], true)
    };
    order.len() == nodes.len() && order.iter().all(in_turn)
}

/// The files that the graph names, each with what the file system says of it.
fn files(graph: &Graph) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for node in graph.nodes.iter().filter(|node| node.kind.reads_files) {
        let mut params = node.kind.params.iter();
        node.step.visit(&mut |_, value| {
            if params.next().is_some_and(|param| param.role == Role::Input) {
                files.extend(value.paths().into_iter().map(str::to_owned));
            }
        });
    }
    files.sort_unstable();
    files.dedup();
    let stamped = |name: String| {
        let stamp = stamp(&graph.root.file(&InputFile(name.clone())));
        (name, stamp)
    };
    files.into_iter().map(stamped).collect()
}

/// Enough to see that a file may be another one: what was checked of it is then checked again.
fn stamp(file: &SourceFile) -> Vec<u8> {
    FileStamp::of(&file.path).map_or_else(|_| Vec::new(), |stamp| stamp.to_bytes().to_vec())
}

/// The part of a node's key that its parameters make.
fn key_fields(step: &dyn Step) -> Vec<u8> {
    KeyWriter::fields(|to| walk(step, to))
}

fn read_span(from: &mut Decoder<'_>, text: &str) -> Result<Range<usize>, Corrupt> {
    let span = from.u32()? as usize..from.u32()? as usize;
    text.get(span.clone()).map(|_| span).ok_or_else(|| Corrupt("a place beyond the text".to_owned()))
}
