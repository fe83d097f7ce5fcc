//! The code of a node: running it, and describing its result.

use std::sync::PoisonError;
use std::sync::atomic::Ordering;
use std::time::Instant;

use cache::{Digest, Store};

use crate::graph::node::Node;
use crate::kind::context::Context;
use crate::kind::contract::Keep;
use crate::kind::port::PortSpec;
use crate::record::record::{FileRecord, Output, Record, Spent};
use crate::run::trace::Tracer;
use crate::value::artifact::{AnyArtifact, ArtifactType, decode_with};
use crate::value::counts::Effort;
use crate::value::error::NodeError;
use crate::value::files::Files;

/// Name of the counter for the size in memory of a node's inputs and source files, in bytes.
const BYTES_READ: &str = "bytes_read";
/// Name of the counter for the size in memory of a node's outputs, in bytes.
const BYTES_MADE: &str = "bytes_made";

/// The code of a node and everything that it reads.
pub(crate) struct Code<'a> {
    pub node: &'a Node,
    pub inputs: Vec<Vec<AnyArtifact>>,
    pub context: Context,
    /// Work of the code, in the units of the node's kind.
    pub work: f64,
    /// Memory in bytes that is reserved for the code.
    pub memory: u64,
    pub tracer: &'a Tracer,
}

/// The result of the code of a node.
pub(crate) struct Computed {
    pub record: Record,
    /// One value per output.
    pub values: Vec<AnyArtifact>,
    /// Work that was not taken from the cache.
    pub effort: Effort,
    /// The canonical bytes of each output; empty for outputs that are not stored.
    pub encoded: Vec<Vec<u8>>,
}

impl Code<'_> {
    /// Runs the code and encodes its outputs. `spent` receives the time and counts even if the code fails.
    pub fn run(self, spent: &mut Effort) -> Result<Computed, NodeError> {
        let Self { node, inputs, context, work, memory, tracer } = self;
        let ports = node.kind.inputs.iter().zip(&inputs);
        let of_values =
            bytes_of(ports.flat_map(|(port, values)| values.iter().map(|value| (port.artifact, value))));
        let of_files = context.sources.iter().fold(0, |sum, source| sum + source.bytes);
        let start = Instant::now();
        let outcome = context.on_cpu(|| node.step.run(inputs, &context));
        let seconds = start.elapsed().as_secs_f64();
        tracer.record(&node.id, "code", seconds);
        // After a cancellation, a codec may report the truncated data as an error.
        if context.saw_cancel.load(Ordering::Relaxed) {
            return Err(NodeError::cancelled());
        }
        let counts = context.counts().into_iter().map(|(name, n)| (name.to_owned(), n)).collect();
        *spent = Effort { seconds, cpu_seconds: context.cpu_seconds(), counts };
        let (values, notes) = outcome?;
        let (outputs, encoded) = encode(node, &values);
        let files =
            values.iter().filter_map(|value| value.downcast_ref::<Files>()).flat_map(|files| &files.0);
        let files = files
            .map(|file| FileRecord { view: file.view.clone(), digest: Digest::of(&file.bytes) })
            .collect();
        let mut effort = spent.clone();
        let made = bytes_of(node.kind.outputs.iter().map(|port| port.artifact).zip(&values));
        let memory = memory.max(made);
        let mut whole = context.known.into_inner().unwrap_or_else(PoisonError::into_inner);
        // Parts from the cache are not inputs, so their counts are left out.
        effort.counts.insert(BYTES_READ.to_owned(), of_values + of_files);
        effort.counts.insert(BYTES_MADE.to_owned(), made);
        whole.add(&effort);
        let Effort { seconds, cpu_seconds, counts } = whole;
        let spent = Spent { seconds, cpu_seconds, work, memory, counts };
        Ok(Computed { record: Record { outputs, files, notes, spent }, values, effort, encoded })
    }
}

/// Total size of the values in memory, in bytes.
fn bytes_of<'v>(values: impl Iterator<Item = (ArtifactType, &'v AnyArtifact)>) -> u64 {
    values.fold(0, |sum, (artifact, value)| sum + (artifact.bytes)(value) as u64)
}

/// The outputs of a node with their digests, and the canonical bytes of each output. The bytes are empty for
/// outputs that are not stored.
pub(crate) fn encode(node: &Node, values: &[AnyArtifact]) -> (Vec<Output>, Vec<Vec<u8>>) {
    let one = |(port, value): (&PortSpec, &AnyArtifact)| {
        let stored = node.kind.store == Keep::Always;
        let (digest, bytes) = if stored {
            let bytes = (port.artifact.encode)(value);
            (Digest::of(&bytes), bytes)
        } else {
            ((port.artifact.digest)(value), Vec::new())
        };
        let artifact = port.artifact;
        let (type_name, format, size) = (artifact.name, artifact.format, (artifact.size)(value));
        (Output { type_name, format, digest, size, stored }, bytes)
    };
    node.kind.outputs.iter().zip(values).map(one).unzip()
}

/// Reads a value from the store. Returns `None` if it is missing, damaged or of another format.
pub(crate) fn stored_value(store: &Store, artifact: &ArtifactType, digest: &Digest) -> Option<AnyArtifact> {
    decode_with(artifact, &store.get_blob(digest).ok()??).ok()
}
