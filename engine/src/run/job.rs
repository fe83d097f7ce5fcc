//! The work of a thread for one node.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use cache::{Digest, Lease, LeaseState, Store};

use crate::graph::graph::Graph;
use crate::graph::node::Node;
use crate::kind::context::{Context, ContextField};
use crate::kind::contract::Keep;
use crate::kind::part::{Part, PartStore};
use crate::kind::port::PortSpec;
use crate::kind::tiles::Threads;
use crate::record::action::{Action, look_up};
use crate::record::key::part_key;
use crate::record::pace::Pace;
use crate::record::record::{FileRecord, Output, PartRecord, Record, Spent};
use crate::run::event::{Event, State};
use crate::run::message::{Finished, Message, Owed};
use crate::run::trace::Tracer;
use crate::run::value_cache::{Name, ValueCache};
use crate::value::artifact::{AnyArtifact, ArtifactType};
use crate::value::counts::Effort;
use crate::value::error::{NodeError, NodeErrorKind, guarded};
use crate::value::files::Files;

/// Name of the counter for the size in memory of a node's inputs and source files, in bytes.
const BYTES_READ: &str = "bytes_read";
/// Name of the counter for the size in memory of a node's outputs, in bytes.
const BYTES_MADE: &str = "bytes_made";

/// A node whose code runs on a thread.
pub(crate) struct Job<'a> {
    pub store: &'a Arc<Store>,
    pub prepared: &'a Arc<ValueCache>,
    pub threads: &'a Arc<Threads>,
    pub graph: &'a Graph,
    pub node: usize,
    pub inputs: Vec<Vec<AnyArtifact>>,
    pub input_digests: Vec<(&'static str, Vec<Digest>)>,
    pub key: Digest,
    /// Source files, recipe and full key of the node. `action.key` is `None` when the node is rerun only for its
    /// output values, since its record is already stored.
    pub action: Action,
    /// True if the node is rerun only for its output values. Its record is already stored.
    pub remake: bool,
    pub work: f64,
    /// Memory in bytes that is reserved for the code.
    pub memory: u64,
    pub tracer: Tracer,
    pub cancel: Arc<AtomicBool>,
    pub sender: Sender<Message>,
}

impl Job<'_> {
    fn node(&self) -> &Node {
        &self.graph.nodes[self.node]
    }

    /// Runs the code, sends the output values to the scheduler, and then stores them.
    pub fn run(self) {
        let (index, sender, store, key) = (self.node, self.sender.clone(), self.store, self.key);
        // The variable declared last is dropped first, so that `Finished` is sent before `Stored` after a panic.
        let text = |error: NodeError| Some(error.to_string());
        let stored = Owed::new(&sender, |error| Message::Stored { node: index, error: text(error) });
        let finished = Owed::new(&sender, |error| Message::Finished { node: index, outcome: Err(error) });
        let ended = |outcome: Result<Finished, NodeError>| Message::Finished {
            node: index,
            outcome: outcome.map(Box::new),
        };
        // A node does not wait for a stalled process, since equal keys give equal bytes.
        let (LeaseState::Acquired(lease) | LeaseState::Stalled(lease)) = store.lease(&key) else {
            finished.send(Message::Busy { node: index, key, spent: Effort::default() });
            return stored.cancel();
        };
        let mut error = None;
        // Another process may have held the lease before and stored the result.
        match look_up(store, self.node(), &key).filter(|_| !self.remake) {
            Some(record) => {
                let (values, effort) = (Vec::new(), Effort::default());
                finished.send(ended(Ok(Finished { record, values, effort, ran: false })));
            }
            None => {
                if !self.remake {
                    let forecast = Pace::of(store, &self.node().kind).seconds(self.work);
                    let (id, kind) = (self.node().id.clone(), self.node().kind.name);
                    let _ = sender.send(Message::Event(Event::Start { id, kind, forecast }));
                }
                let manifest = self.action.key.as_ref().map(|key| key.manifest.clone());
                let (work, graph, tracer) = (self.work, self.graph, self.tracer.clone());
                let mut spent = Effort::default();
                match guarded(|| self.compute(&mut spent)) {
                    Err(NodeError { kind: NodeErrorKind::Busy(key), .. }) => {
                        finished.send(Message::Busy { node: index, key, spent });
                        return stored.cancel();
                    }
                    Err(error) => finished.send(ended(Err(error))),
                    Ok((result, encoded)) => {
                        let kind = &graph.nodes[index].kind;
                        Pace::learn(store, kind, work, result.record.spent.seconds);
                        let outputs = result.record.outputs.clone();
                        let record = manifest.map(|manifest| result.record.encode(&manifest));
                        finished.send(ended(Ok(result)));
                        let put = || {
                            encoded
                                .iter()
                                .zip(&outputs)
                                .filter(|(_, output)| output.stored)
                                .try_for_each(|(bytes, output)| store.put_blob_as(&output.digest, bytes))
                                .and_then(|()| {
                                    record.map_or(Ok(()), |record| store.put_record(&key, &record))
                                })
                        };
                        let put = tracer.span(&graph.nodes[index].id, "store", put);
                        error = put.err().map(|error| NodeError::from(error).to_string());
                    }
                }
            }
        }
        drop(lease);
        stored.send(Message::Stored { node: index, error });
    }

    /// Runs the code and encodes its outputs. `spent` receives the time and counts even if the code fails.
    fn compute(self, spent: &mut Effort) -> Result<(Finished, Vec<Vec<u8>>), NodeError> {
        let graph = self.graph;
        let node = &graph.nodes[self.node];
        let (id, sender) = (node.id.clone(), Mutex::new(self.sender.clone()));
        let last = Mutex::new(Instant::now());
        let progress = move |fraction: f32| {
            // At most twenty reports per second.
            let mut last = last.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            if fraction >= 1.0 || last.elapsed() > Duration::from_millis(50) {
                *last = Instant::now();
                let sender = sender.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                let _ = sender.send(Message::Event(Event::Progress { id: id.clone(), fraction }));
            }
        };
        let context = Context {
            cancel: self.cancel,
            threads: Some(self.threads.clone()),
            progress: Box::new(progress),
            parts: Some(Box::new(StoredParts {
                store: self.store.clone(),
                prepared: self.prepared.clone(),
                id: node.id.clone(),
                kind: node.kind.name,
                profile: node.kind.profile,
                inputs: self.input_digests,
                sender: Mutex::new(self.sender),
                tracer: self.tracer.clone(),
            })),
            ..context_of(graph, self.node, &self.action)
        };
        let ports = node.kind.inputs.iter().zip(&self.inputs);
        let of_values =
            bytes_of(ports.flat_map(|(port, values)| values.iter().map(|value| (port.artifact, value))));
        let of_files = context.sources.iter().fold(0, |sum, source| sum + source.bytes);
        let start = Instant::now();
        let outcome = context.on_cpu(|| node.step.run(self.inputs, &context));
        let seconds = start.elapsed().as_secs_f64();
        self.tracer.record(&node.id, "code", seconds);
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
        let memory = self.memory.max(made);
        let mut whole = context.known.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        // Parts from the cache are not inputs, so their counts are left out.
        effort.counts.insert(BYTES_READ.to_owned(), of_values + of_files);
        effort.counts.insert(BYTES_MADE.to_owned(), made);
        whole.add(&effort);
        let Effort { seconds, cpu_seconds, counts } = whole;
        let spent = Spent { seconds, cpu_seconds, work: self.work, memory, counts };
        let record = Record { outputs, files, notes, spent };
        Ok((Finished { record, values, effort, ran: true }, encoded))
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

/// Storage for the parts of a node. In the store, the record of a part names the blob that holds its value. Parts
/// that are never stored are kept in memory.
struct StoredParts {
    store: Arc<Store>,
    prepared: Arc<ValueCache>,
    id: String,
    kind: &'static str,
    profile: &'static str,
    inputs: Vec<(&'static str, Vec<Digest>)>,
    sender: Mutex<Sender<Message>>,
    tracer: Tracer,
}

impl StoredParts {
    fn key(&self, part: Part<'_>, extra: &str) -> Option<Digest> {
        part_key(self.kind, self.profile, part, &self.inputs, extra).ok().map(|key| key.digest)
    }

    fn emit(&self, part: Part<'_>, state: State, key: Digest, seconds: f64) {
        let event = Event::Part { id: self.id.clone(), part: part.name.to_owned(), state, key, seconds };
        let sender = self.sender.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let _ = sender.send(Message::Event(event));
    }
}

impl PartStore for StoredParts {
    fn load(&self, part: Part<'_>, extra: &str) -> Option<(Vec<u8>, Effort)> {
        let (key, begin) = (self.key(part, extra)?, Instant::now());
        let record = PartRecord::decode(&self.store.get_record(&key)?).ok()?;
        let bytes = self.store.get_blob(&record.blob).ok()??;
        self.tracer.record(&self.id, part.name, begin.elapsed().as_secs_f64());
        self.emit(part, State::Cached, key, 0.0);
        Some((bytes, record.spent))
    }

    fn claim(&self, part: Part<'_>, extra: &str) -> Result<Option<Lease>, NodeError> {
        let Some(key) = self.key(part, extra) else { return Ok(None) };
        match self.store.lease(&key) {
            LeaseState::Acquired(lease) | LeaseState::Stalled(lease) => Ok(Some(lease)),
            LeaseState::Busy => Err(NodeError::busy(key)),
        }
    }

    fn save(&self, part: Part<'_>, extra: &str, encoded: &[u8], spent: Effort) -> Result<(), NodeError> {
        let seconds = spent.seconds;
        self.tracer.record(&self.id, part.name, seconds);
        let Some(key) = self.key(part, extra) else { return Ok(()) };
        // A part that cannot be stored is recomputed later. The result of the node reports the problem.
        if let Ok(blob) = self.store.put_blob(encoded) {
            let _ = self.store.put_record(&key, &PartRecord { blob, spent }.encode());
        }
        self.emit(part, State::Ran, key, seconds);
        Ok(())
    }

    fn recall(&self, part: Part<'_>, extra: &str) -> Option<AnyArtifact> {
        self.prepared.get(&of_part(self.key(part, extra)?, part))
    }

    fn keep(&self, part: Part<'_>, extra: &str, value: AnyArtifact, bytes: u64) {
        if let Some(key) = self.key(part, extra) {
            self.prepared.put(&of_part(key, part), &value, bytes);
        }
    }
}

/// The name of a part in the memory cache, made from the key of the part.
fn of_part(key: Digest, part: Part<'_>) -> Name {
    (key, "part", part.version)
}

/// Reads a value from the store. Returns `None` if it is missing, damaged or of another format.
pub(crate) fn stored_value(store: &Store, artifact: &ArtifactType, digest: &Digest) -> Option<AnyArtifact> {
    let bytes = store.get_blob(digest).ok()??;
    guarded(|| {
        let value = (artifact.decode)(&bytes)?;
        // This, too, is code of a kind, and the scheduler calls it without a guard.
        (artifact.bytes)(&value);
        Ok(value)
    })
    .ok()
}

/// The context for the code of a node, without parts and cancellation.
pub(crate) fn context_of(graph: &Graph, index: usize, action: &Action) -> Context {
    Context {
        reads: graph.nodes[index].kind.reads,
        recipe: action.recipe.clone(),
        wired: graph.wired(index),
        points: if graph.nodes[index].kind.reads.contains(&ContextField::Points) {
            graph.points(index)
        } else {
            Vec::new()
        },
        root: graph.root.clone(),
        sources: action.sources.clone(),
        ..Context::detached(graph.scene, "")
    }
}
