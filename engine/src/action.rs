//! Actions: one node with known inputs, its key, and what the store knows of it.

use std::sync::Arc;

use cache::{Digest, Key, Store};

use crate::context::{ContextField, ReadSource, SourceFile};
use crate::error::NodeError;
use crate::graph::{Graph, Node, Wire};
use crate::key::node_key;
use crate::recipe::recipe;
use crate::record::{Output, Record, read_digest};

/// A node whose inputs are known by digest.
#[derive(Default)]
pub(crate) struct Action {
    pub sources: Vec<ReadSource>,
    pub recipe: Option<Arc<str>>,
    pub key: Option<Key>,
}

/// Digests the sources of a node and makes its key. `output` gives what a wire carries, `sources` the
/// sources of the nodes above.
pub(crate) fn prepare<'s>(
    graph: &Graph,
    index: usize,
    store: &Store,
    output: impl Fn(Wire) -> &'s Output,
    sources_above: impl Fn(usize) -> &'s [ReadSource],
) -> Result<Action, NodeError> {
    let node = &graph.nodes[index];
    let mut sources = Vec::new();
    for file in node.step.sources(&graph.root)? {
        sources.push(digest_source(store, node, file)?);
    }
    let reads_recipe = node.kind.reads.contains(&ContextField::Recipe);
    let recipe = reads_recipe.then(|| Arc::from(recipe(graph, index, &sources_above)));
    let inputs: Vec<Vec<&Output>> =
        node.inputs.iter().map(|wires| wires.iter().map(|wire| output(*wire)).collect()).collect();
    let key = node_key(graph, index, &inputs, &sources, recipe.as_deref())?;
    Ok(Action { sources, recipe, key: Some(key) })
}

fn digest_source(store: &Store, node: &Node, file: SourceFile) -> Result<ReadSource, NodeError> {
    match store.digest_file(&file.path) {
        Ok((digest, _)) => Ok(ReadSource { file, digest }),
        Err(error) => {
            let field = node.kind.params.iter().find(|param| param.role == crate::param::Role::Input);
            let error = NodeError::new(format!("cannot read `{}`: {error}", file.path.display()));
            Err(match field {
                Some(field) => error.at(field.name),
                None => error,
            })
        }
    }
}

/// The types of a kind's outputs, as its records must state them.
pub(crate) fn output_types(node: &Node) -> Vec<(&'static str, u32)> {
    node.kind.outputs.iter().map(|port| (port.artifact.name, port.artifact.format)).collect()
}

/// What the store knows of a key. A record that does not decode is no record.
pub(crate) fn look_up(store: &Store, node: &Node, key: &Digest) -> Option<Record> {
    Record::decode(&store.get_record(key)?, &output_types(node)).ok()
}

/// Name under which the last key of a node is remembered, for forecasts and explanations.
fn last_name(graph: &Graph, node: &Node) -> String {
    let file = graph.source.name.rsplit('/').next().unwrap_or_default();
    format!("last key\n{}\n{file}\n{}", graph.root.folder().display(), node.id)
}

/// The record of the last run of a node of this name in a graph file of this name.
pub(crate) fn last_record(store: &Store, graph: &Graph, node: &Node) -> Option<Record> {
    let bytes = store.history_get(&last_name(graph, node))?;
    let key = read_digest(&mut crate::artifact::Decoder::new(&bytes)).ok()?;
    look_up(store, node, &key)
}

/// Remembers the key of a node.
pub(crate) fn remember(store: &Store, graph: &Graph, node: &Node, key: &Digest) {
    let name = last_name(graph, node);
    if store.history_get(&name).as_deref() != Some(key.as_bytes()) {
        store.history_put(&name, key.as_bytes());
    }
}
