//! The values of the last run of a graph, from the store or recomputed.

use std::collections::BTreeMap;
use std::sync::Arc;

use cache::Digest;

use crate::graph::graph::Graph;
use crate::graph::node::{Node, Wire};
use crate::kind::contract::Keep;
use crate::record::action::{Action, last_outputs, look_up, read_sources};
use crate::record::record::{Output, Record};
use crate::run::code::stored_value;
use crate::run::engine::Engine;
use crate::run::job::context_of;
use crate::value::artifact::{AnyArtifact, Artifact, decode_all};
use crate::value::error::guarded;

/// A graph, and the records of the results of its nodes.
type Results<'a> = (&'a Graph, &'a dyn Fn(usize) -> Option<Record>);

/// The output at the start of a wire.
fn output_of(records: &dyn Fn(usize) -> Option<Record>, wire: Wire) -> Option<Output> {
    records(wire.node)?.outputs.get(wire.port).cloned()
}

/// An output of a result in the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredOutput {
    /// Name of the output.
    pub port: &'static str,
    /// Type of the value, as in [`ArtifactType::name`](crate::ArtifactType).
    pub type_name: &'static str,
    /// Digest of the value.
    pub digest: Digest,
    /// True if the value is in the store, and not only its digest.
    pub stored: bool,
}

impl Engine {
    /// The outputs of the result with the key `key`, which belongs to a node of the kind of `node`. `None` if the
    /// store has no such result. For viewers.
    pub fn outputs(&self, node: &Node, key: &Digest) -> Option<Vec<StoredOutput>> {
        let record = look_up(&self.store, node, key)?;
        let ports = node.kind.outputs.iter().map(|port| port.name);
        let output = |(port, output): (&'static str, Output)| {
            let Output { type_name, digest, stored, .. } = output;
            StoredOutput { port, type_name, digest, stored }
        };
        Some(ports.zip(record.outputs).map(output).collect())
    }

    /// The value with the digest `digest` from the store; `None` if it is missing, damaged, or not an `A`. For
    /// viewers.
    pub fn stored<A: Artifact>(&self, digest: &Digest) -> Option<A> {
        let bytes = self.store.get_blob(digest).ok()??;
        guarded(|| Ok(decode_all(&bytes)?)).ok()
    }

    /// The value with the digest `digest` that the runs of this process have left in memory; `None` if it is not
    /// there, or not an `A`. See [`keeping`](Self::keeping). For viewers.
    pub fn in_memory<A: Artifact>(&self, digest: &Digest) -> Option<Arc<A>> {
        let value = self.warm.as_ref()?.values.get(&(*digest, A::TYPE, A::FORMAT))?;
        value.downcast::<A>().ok()
    }

    /// The value of an output in the last run of a graph: from the store or, if only its digest was stored,
    /// recomputed with the nodes upstream of it. `None` if neither gives a value that has the digest of the last
    /// run. For tests and viewers.
    pub fn value<A: Artifact>(&self, graph: &Graph, wire: Wire) -> Option<A> {
        let last = self.last(graph);
        let bytes = self.bytes_of((graph, &last), wire, &output_of(&last, wire)?)?;
        guarded(|| Ok(decode_all(&bytes)?)).ok()
    }

    /// The value of an output in a run whose nodes had the keys `keys`, by their index. Another process may have run the
    /// graph with other values since. `None` if a node whose values are stored would have to run: its values are
    /// elsewhere, for example on a server, or were removed.
    pub fn value_at_hand<A: Artifact>(
        &self,
        graph: &Graph,
        keys: &dyn Fn(usize) -> Option<Digest>,
        wire: Wire,
    ) -> Option<A> {
        let records = |node: usize| look_up(&self.store, &graph.nodes[node], &keys(node)?);
        let output = output_of(&records, wire)?;
        let is_stored = self.store.has_blob(&output.digest);
        let stays = |node: usize| graph.nodes[node].kind.store == Keep::Always;
        if !is_stored && self.nodes_to_run((graph, &records), wire).into_iter().any(stays) {
            return None;
        }
        let bytes = self.bytes_of((graph, &records), wire, &output)?;
        guarded(|| Ok(decode_all(&bytes)?)).ok()
    }

    /// The canonical bytes of an output whose digest is known: from the store, or computed again from the results
    /// of the last run of the graph.
    pub(crate) fn encoded(&self, graph: &Graph, wire: Wire, output: &Output) -> Option<Vec<u8>> {
        self.bytes_of((graph, &self.last(graph)), wire, output)
    }

    /// The records of the last run of a graph, by the index of the node.
    fn last<'a>(&'a self, graph: &'a Graph) -> impl Fn(usize) -> Option<Record> + 'a {
        |node| last_outputs(&self.store, graph, &graph.nodes[node])
    }

    fn bytes_of(&self, (graph, records): Results<'_>, wire: Wire, output: &Output) -> Option<Vec<u8>> {
        if let Some(bytes) = self.store.get_blob(&output.digest).ok()? {
            return Some(bytes);
        }
        let value = self.made_again((graph, records), wire)?;
        let artifact = &graph.nodes[wire.node].kind.outputs[wire.port].artifact;
        let bytes = guarded(|| Ok((artifact.encode)(&value))).ok()?;
        Some(bytes).filter(|bytes| Digest::of(bytes) == output.digest)
    }

    /// The nodes that must run for a value that is not in the store, in the order of the graph.
    fn nodes_to_run(&self, (graph, records): Results<'_>, wire: Wire) -> Vec<usize> {
        // The values of results that machines share may be elsewhere.
        let kept = |node: usize| {
            let here = |output: &Output| self.store.has_blob(&output.digest);
            graph.nodes[node].kind.store == Keep::Always
                && records(node).is_some_and(|record| record.outputs.iter().all(here))
        };
        // The walk ends at nodes whose values are stored.
        let mut runs = vec![false; graph.nodes.len()];
        runs[wire.node] = true;
        for &node in graph.order().iter().rev() {
            if runs[node] {
                graph.reads(node).iter().for_each(|&above| runs[above] |= !kept(above));
            }
        }
        graph.order().iter().copied().filter(|&index| runs[index]).collect()
    }

    fn made_again(&self, (graph, records): Results<'_>, wire: Wire) -> Option<AnyArtifact> {
        let mut made: BTreeMap<usize, Vec<AnyArtifact>> = BTreeMap::new();
        for index in self.nodes_to_run((graph, records), wire) {
            let node = &graph.nodes[index];
            let input = |from: &Wire| match made.get(&from.node) {
                Some(values) => values.get(from.port).cloned(),
                None => {
                    let artifact = &graph.nodes[from.node].kind.outputs[from.port].artifact;
                    stored_value(&self.store, artifact, &output_of(records, *from)?.digest)
                }
            };
            let port = |wires: &Vec<Wire>| wires.iter().map(input).collect::<Option<Vec<_>>>();
            let inputs = node.inputs.iter().map(port).collect::<Option<Vec<_>>>()?;
            let sources = read_sources(graph, index, &self.store).ok()?;
            let context = context_of(graph, index, &Action { sources, ..Action::default() });
            let (values, _) = node.step.run(inputs, &context).ok()?;
            made.insert(index, values);
        }
        made.remove(&wire.node)?.into_iter().nth(wire.port)
    }
}
