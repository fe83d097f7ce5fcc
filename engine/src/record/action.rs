//! Actions: nodes with known inputs, their keys, and their records in the store.

use std::sync::Arc;

use cache::{Digest, Key, Manifest, Store};

use crate::graph::graph::Graph;
use crate::graph::node::{Node, Wire};
use crate::graph::surroundings::Surroundings;
use crate::kind::context::{ContextField, ReadSource};
use crate::kind::contract::Sizes;
use crate::record::key::node_key;
use crate::record::recipe::recipe;
use crate::record::record::{Output, Record, Spent};
use crate::text::source::Source;
use crate::value::error::NodeError;
use crate::value::root::{PROGRAMS_HINT, SourceFile, SourceRoot};

/// A node whose inputs are known by digest.
#[derive(Default)]
pub(crate) struct Action {
    pub sources: Vec<ReadSource>,
    pub recipe: Option<Arc<str>>,
    pub key: Option<Key>,
}

impl Action {
    /// The digest of the key.
    pub fn digest(&self) -> Digest {
        self.key.as_ref().expect("a prepared action has a key").digest
    }

    /// Drops the manifest of the key and returns its memory for the next manifest.
    pub fn take_memory(&mut self) -> Vec<u8> {
        self.key.take().map(|key| key.manifest.into_bytes()).unwrap_or_default()
    }
}

/// Finds and digests the source files of a node.
pub(crate) fn read_sources(graph: &Graph, index: usize, store: &Store) -> Result<Vec<ReadSource>, NodeError> {
    let node = &graph.nodes[index];
    digest_sources(node, node.step.sources(&graph.root)?, &graph.root, store, &|| false)
}

/// Digests the source files of a node. If `cancelled` returns true in the meantime, the error is that of a cancelled run.
pub(crate) fn digest_sources(
    node: &Node,
    files: Vec<SourceFile>,
    root: &SourceRoot,
    store: &Store,
    cancelled: &dyn Fn() -> bool,
) -> Result<Vec<ReadSource>, NodeError> {
    let digest = |file: SourceFile| {
        if file.is_program() && root.is_confined() {
            let digest = root.stated_program(&file.name).ok_or_else(|| never_runs(node, root))?;
            return Ok(ReadSource { file, digest, bytes: 0 });
        }
        digest_source(store, node, file, cancelled)
    };
    files.into_iter().map(digest).collect()
}

/// True if a record in the store makes a run of the node unnecessary. A program is not expected to give the same
/// values again, so the record of a node that runs one is used only together with its values.
pub(crate) fn is_usable(graph: &Graph, index: usize, record: &Record, store: &Store) -> bool {
    let is_there = |output: &Output| !output.stored || store.has_blob(&output.digest);
    !graph.nodes[index].kind.runs_programs || graph.root.is_confined() || record.outputs.iter().all(is_there)
}

/// The error of a node that runs a program and whose result is not known, in an untrusted graph.
pub(crate) fn never_runs(node: &Node, root: &SourceRoot) -> NodeError {
    let why = format!("`{}` runs a program, which a graph from others may not do", node.kind.camel_name());
    let error = NodeError::new(why);
    if root.permits_programs() {
        return error.hint("its values are not in the bundle; `pack --results all` includes them");
    }
    error.hint(PROGRAMS_HINT)
}

/// Returns the remembered digests of source files, without reading the files. `None` unless the store remembers the
/// digests of all of them.
pub(crate) fn known_sources(files: &[SourceFile], store: &Store) -> Option<Vec<ReadSource>> {
    let known = |file: &SourceFile| {
        let (digest, bytes) = store.known_digest(&file.path)?;
        Some(ReadSource { file: file.clone(), digest, bytes })
    };
    files.iter().map(known).collect()
}

/// Makes the action of a node with its key, using `memory` as a buffer. `output` returns the output from which a
/// wire comes, and `sources_above` returns the source files of an upstream node.
pub(crate) fn prepare<'s>(
    graph: &Graph,
    index: usize,
    sources: Vec<ReadSource>,
    output: impl Fn(Wire) -> &'s Output,
    sources_above: impl Fn(usize) -> &'s [ReadSource],
    memory: Vec<u8>,
) -> Result<Action, NodeError> {
    let node = &graph.nodes[index];
    let recipe = node.kind.reads.contains(&ContextField::Recipe).then(|| {
        let sources_of = |node: usize| if node == index { sources.as_slice() } else { sources_above(node) };
        Arc::from(recipe(graph, index, sources_of))
    });
    let around = Surroundings::of(graph, index, recipe);
    let key = node_key(node, &around, output, &sources, memory)?;
    Ok(Action { sources, recipe: around.recipe, key: Some(key) })
}

fn digest_source(
    store: &Store,
    node: &Node,
    file: SourceFile,
    cancelled: &dyn Fn() -> bool,
) -> Result<ReadSource, NodeError> {
    match store.digest_file_unless(&file.path, cancelled) {
        Ok(Some((digest, bytes))) => Ok(ReadSource { file, digest, bytes }),
        Ok(None) => Err(NodeError::cancelled()),
        Err(error) => {
            let field =
                node.kind.params.iter().find(|param| param.role == crate::kind::param_type::Role::Input);
            let error = NodeError::new(format!("cannot read `{}`: {error}", file.path.display()));
            Err(match field {
                Some(field) => error.at(field.name),
                None => error,
            })
        }
    }
}

/// The record of a key in the store; `None` if it is missing or cannot be decoded.
pub(crate) fn look_up(store: &Store, node: &Node, key: &Digest) -> Option<Record> {
    Record::decode(&store.get_record(key)?, node).ok()
}

/// Name of the history that holds the last keys of a graph's nodes.
pub(crate) fn history_of(graph: &Graph) -> String {
    history_name(&graph.source, &graph.root)
}

/// Like [`history_of`], for a graph that has not been parsed yet.
pub(crate) fn history_name(source: &Source, root: &SourceRoot) -> String {
    let file = source.name.rsplit('/').next().unwrap_or_default();
    format!("last key\n{}\n{file}\n", root.folder().display())
}

/// The sizes of the inputs of a node. `output` returns the output from which a wire comes.
pub(crate) fn sizes<'s>(node: &Node, sources: &[ReadSource], output: impl Fn(Wire) -> &'s Output) -> Sizes {
    let ports = node.kind.inputs.iter().zip(&node.inputs);
    let size = |wires: &[Wire]| wires.iter().fold(0, |sum: u64, wire| sum.saturating_add(output(*wire).size));
    Sizes {
        ports: ports.map(|(port, wires)| (port.name, size(wires))).collect(),
        files: sources.iter().fold(0, |sum, source| sum.saturating_add(source.bytes)),
    }
}

/// The last two keys of a node, newest first. The history is found by the names of the graph file and of the node.
fn keys_of(store: &Store, graph: &Graph, node: &Node) -> Vec<Digest> {
    let bytes = store.history_get(&history_of(graph), &node.id).unwrap_or_default();
    bytes.as_chunks::<32>().0.iter().map(|key| Digest::from_bytes(*key)).collect()
}

/// The record of the last run of a node, found by the names of the graph file and of the node.
pub(crate) fn last_outputs(store: &Store, graph: &Graph, node: &Node) -> Option<Record> {
    look_up(store, node, keys_of(store, graph, node).first()?)
}

/// Time, counts and manifest of the last run of a node, found by the names of the graph file and of the node.
pub(crate) fn last_run(store: &Store, graph: &Graph, node: &Node) -> Option<(Spent, Manifest)> {
    let bytes = store.get_record(keys_of(store, graph, node).first()?)?;
    Some((Record::decode(&bytes, node).ok()?.spent, Record::manifest(&bytes)?))
}

/// The manifest of the newest key, other than `now`, in the history of a node.
pub(crate) fn manifest_before(store: &Store, graph: &Graph, node: &Node, now: &Digest) -> Option<Manifest> {
    let before = keys_of(store, graph, node).into_iter().find(|key| key != now)?;
    Record::manifest(&store.get_record(&before)?)
}

/// Adds the key of a node to the history of its graph, which keeps the last two keys of each node.
pub(crate) fn remember(store: &Store, history_name: &str, node: &Node, key: &Digest) {
    let known = store.history_get(history_name, &node.id).unwrap_or_default();
    if !known.starts_with(key.as_bytes()) {
        let mut keys = key.as_bytes().to_vec();
        keys.extend(known.iter().take(32));
        store.history_put(history_name, &node.id, &keys);
    }
}
