//! Running an action folder: the work of a worker.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Sender, channel};
use std::time::Instant;

use cache::Digest;

use crate::kind::context::{Context, ReadSource};
use crate::kind::registry::Registry;
use crate::record::key::node_key;
use crate::remote::action_file::{self, ActionFile, BLOBS, FILES};
use crate::remote::action_node::ActionNode;
use crate::remote::error::ActionError;
use crate::remote::outputs;
use crate::run::code::{Code, Computed};
use crate::run::engine::Engine;
use crate::run::event::Event;
use crate::run::message::Message;
use crate::run::parts::StoredParts;
use crate::run::trace::{Tracer, progress};
use crate::value::artifact::{AnyArtifact, decode_with};
use crate::value::counts::Effort;
use crate::value::error::{NodeError, guarded};
use crate::value::note::Notes;
use crate::value::root::{FileHead, SourceFile, SourceRoot, staged_name};
use crate::value::text_file::{MAX_GRAPH_BYTES, read_text};

/// The result of an action.
#[derive(Debug, Clone)]
pub struct ActionDone {
    /// The key of the node.
    pub key: Digest,
    /// The kind of the node.
    pub kind: &'static str,
    /// The notes of the node.
    pub notes: Notes,
    /// Wall time of the code in seconds.
    pub seconds: f64,
    /// Total length of the stored values in bytes.
    pub bytes: u64,
}

impl Engine {
    /// Computes the node of an action folder and writes its outputs to the new folder `out`. All inputs are
    /// verified, and the key is computed from them. The values and the record, except for times, are those of a run
    /// on any machine. Progress is sent to `emit` on the calling thread.
    ///
    /// # Errors
    /// If the action is not valid for this program, if a file does not have the stated content, or if the code
    /// fails. Nothing is written in these cases.
    pub fn run_action(
        &self,
        registry: &Registry,
        folder: &Path,
        out: &Path,
        cancel: &Arc<AtomicBool>,
        mut emit: impl FnMut(Event),
    ) -> Result<ActionDone, ActionError> {
        let file = read_file(folder)?;
        let action = ActionNode::new(&file, registry)?;
        let kind = action.node.kind.clone();
        let root = SourceRoot::staged(&folder.join(FILES));
        let sources = self.sources(&file, &root)?;
        let key = node_key(&action.node, &action.around, |wire| action.input(wire), &sources, Vec::new());
        let key = key.map_err(|error| ActionError::Invalid(error.to_string()))?;
        if key.digest != action.key {
            return Err(ActionError::Key { stated: action.key, found: key.digest });
        }
        let inputs = values(folder, &action)?;
        let memory = self.admit(&action, &inputs, &sources)?;
        let (sender, receiver) = channel();
        let key_digest = key.digest;
        // The code runs on a thread of its own, so that its events reach the caller while it runs.
        let computed = std::thread::scope(|scope| {
            let code = scope.spawn(|| self.code(action, inputs, sources, root, memory, cancel, sender));
            while let Ok(message) = receiver.recv() {
                if let Message::Event(event) = message {
                    emit(event);
                }
            }
            code.join().unwrap_or_else(|_| Err(NodeError::new("the thread of the code panicked")))
        });
        let failed = |error| ActionError::Failed { kind: kind.name.to_owned(), error };
        let Computed { record, encoded, .. } = computed.map_err(failed)?;
        let stored: Vec<(&str, &[u8])> = kind
            .outputs
            .iter()
            .zip(&record.outputs)
            .zip(&encoded)
            .filter(|((_, output), _)| output.stored)
            .map(|((port, _), bytes)| (port.name, bytes.as_slice()))
            .collect();
        outputs::write(out, key_digest, record.encode(&key.manifest), &stored)?;
        let bytes = stored.iter().map(|(_, bytes)| bytes.len() as u64).sum();
        let (notes, seconds) = (record.notes, record.spent.seconds);
        Ok(ActionDone { key: key_digest, kind: kind.name, notes, seconds, bytes })
    }

    /// Verifies the outputs of an action and stores them, as if the node had run here.
    ///
    /// # Errors
    /// If the outputs are not those of the action, or if they cannot be stored.
    pub fn take_outputs(
        &self,
        registry: &Registry,
        folder: &Path,
        out: &Path,
    ) -> Result<ActionDone, ActionError> {
        let action = ActionNode::new(&read_file(folder)?, registry)?;
        let outputs::Outputs { record, encoded, values } = outputs::read(out, &action.node, &action.key)?;
        for (digest, bytes) in &values {
            self.store().put_blob_as(digest, bytes)?;
        }
        self.store().put_record(&action.key, &encoded)?;
        self.store().flush()?;
        let bytes = values.iter().map(|(_, bytes)| bytes.len() as u64).sum();
        let (kind, seconds) = (action.node.kind.name, record.spent.seconds);
        Ok(ActionDone { key: action.key, kind, notes: record.notes, seconds, bytes })
    }

    /// Compares the estimated memory of a node with the budget, and returns the estimate in bytes.
    fn admit(
        &self,
        action: &ActionNode,
        inputs: &[Vec<AnyArtifact>],
        sources: &[ReadSource],
    ) -> Result<u64, ActionError> {
        let node = &action.node;
        let failed = |error| ActionError::Failed { kind: node.kind.name.to_owned(), error };
        let heads: Vec<_> = sources.iter().map(|source| FileHead::new(&source.file, source.bytes)).collect();
        let own = node.step.estimate(inputs.to_vec()).map_err(failed)?.bytes;
        let own = own.saturating_add(node.step.estimate_files(&heads).map_err(failed)?.bytes);
        let ports = node.kind.inputs.iter().zip(inputs);
        let held = ports.flat_map(|(port, values)| values.iter().map(|value| (port.artifact.bytes)(value)));
        let needs = held.fold(own, |sum, bytes| sum.saturating_add(bytes as u64));
        let budget = self.limits().memory;
        if needs > budget {
            return Err(ActionError::Memory { kind: node.kind.name.to_owned(), needs, budget });
        }
        Ok(own)
    }

    /// The source files of an action folder, verified.
    fn sources(&self, file: &ActionFile, root: &SourceRoot) -> Result<Vec<ReadSource>, ActionError> {
        let one = |source: &action_file::InputFile| {
            let path = root.folder().join(staged_name("", &source.name));
            let (found, bytes) = self.store.digest_file(&path).map_err(ActionError::io("read", &path))?;
            if (found, bytes) != (source.digest.0, source.bytes) {
                return Err(ActionError::Content { path, digest: source.digest.0 });
            }
            Ok(ReadSource { file: SourceFile { name: source.name.clone(), path }, digest: found, bytes })
        };
        file.sources.iter().map(one).collect()
    }

    #[allow(clippy::too_many_arguments, reason = "each is used once")]
    fn code(
        &self,
        action: ActionNode,
        inputs: Vec<Vec<AnyArtifact>>,
        sources: Vec<ReadSource>,
        root: SourceRoot,
        memory: u64,
        cancel: &Arc<AtomicBool>,
        sender: Sender<Message>,
    ) -> Result<Computed, NodeError> {
        let tracer = Tracer::new(Instant::now(), None);
        let digests = action.input_digests();
        let files = sources.iter().fold(0, |sum: u64, source| sum.saturating_add(source.bytes));
        let sizes = action.sizes(files);
        let ActionNode { node, around, .. } = action;
        let work = node.step.work(&sizes)?;
        let prepared = self.prepared().clone();
        let parts =
            StoredParts::new(&node, self.store.clone(), prepared, digests, sender.clone(), tracer.clone());
        let context = Context {
            cancel: cancel.clone(),
            threads: Some(self.threads().clone()),
            progress: progress(&node, sender),
            parts: Some(Box::new(parts)),
            ..around.context(&node.kind, root, sources)
        };
        let code = Code { node: &node, inputs, context, work, memory, tracer: &tracer };
        self.threads().occupied(|| guarded(|| code.run(&mut Effort::default())))
    }
}

fn read_file(folder: &Path) -> Result<ActionFile, ActionError> {
    let path = folder.join(action_file::NAME);
    let text = read_text(&path, MAX_GRAPH_BYTES).map_err(ActionError::io("read", &path))?;
    ActionFile::parse(&text).map_err(|why| ActionError::Format { path, why })
}

/// The values of an action folder, port by port, verified and decoded.
fn values(folder: &Path, action: &ActionNode) -> Result<Vec<Vec<AnyArtifact>>, ActionError> {
    // A value on several wires is read once.
    let mut read = BTreeMap::new();
    let mut inputs = Vec::new();
    for (port, wires) in action.node.kind.inputs.iter().zip(&action.node.inputs) {
        let mut values = Vec::with_capacity(wires.len());
        for wire in wires {
            let digest = action.input(*wire).digest;
            let value = match read.get(&(digest, port.artifact.name)) {
                Some(value) => AnyArtifact::clone(value),
                None => {
                    let path = folder.join(BLOBS).join(digest.to_string());
                    let bytes = fs::read(&path).map_err(ActionError::io("read", &path))?;
                    if Digest::of(&bytes) != digest {
                        return Err(ActionError::Content { path, digest });
                    }
                    let value = decode_with(&port.artifact, &bytes)
                        .map_err(|error| ActionError::Invalid(format!("`{}`: {error}", path.display())))?;
                    read.insert((digest, port.artifact.name), value.clone());
                    value
                }
            };
            values.push(value);
        }
        inputs.push(values);
    }
    Ok(inputs)
}
