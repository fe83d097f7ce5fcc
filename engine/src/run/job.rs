//! The work of a thread for one node.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::Sender;

use cache::{Digest, LeaseState, Store};

use crate::graph::graph::Graph;
use crate::graph::node::Node;
use crate::graph::surroundings::Surroundings;
use crate::kind::context::Context;
use crate::kind::tiles::Threads;
use crate::record::action::{Action, is_usable, look_up};
use crate::record::pace::Pace;
use crate::record::record::Record;
use crate::remote::entry::Entry;
use crate::remote::shared::SharedResults;
use crate::run::code::{Code, Computed};
use crate::run::event::Event;
use crate::run::message::{Finished, Message, Owed};
use crate::run::parts::StoredParts;
use crate::run::trace::{Tracer, progress};
use crate::run::value_cache::ValueCache;
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;
use crate::value::error::{NodeError, NodeErrorKind, guarded};

/// A node whose code runs on a thread.
pub(crate) struct Job<'a> {
    pub store: &'a Arc<Store>,
    /// Results on another machine, to which the new result is offered.
    pub shared: Option<&'a dyn SharedResults>,
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
        let (mut error, mut offer) = (None, None);
        let (shared, cancel) = (self.shared, self.cancel.clone());
        let (graph, threads, tracer) = (self.graph, self.threads, self.tracer.clone());
        // Another process may have held the lease before and stored the result.
        let usable = |record: &Record| !self.remake && is_usable(self.graph, index, record, store);
        match look_up(store, self.node(), &key).filter(usable) {
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
                let work = self.work;
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
                        let values: Vec<(Digest, Vec<u8>)> = encoded
                            .into_iter()
                            .zip(&outputs)
                            .filter(|(_, output)| output.stored)
                            .map(|(bytes, output)| (output.digest, bytes))
                            .collect();
                        let put = || {
                            values
                                .iter()
                                .try_for_each(|(digest, bytes)| store.put_blob_as(digest, bytes))
                                .and_then(|()| {
                                    record.as_ref().map_or(Ok(()), |record| store.put_record(&key, record))
                                })
                        };
                        let put = tracer.span(&graph.nodes[index].id, "store", put);
                        error = put.err().map(|error| NodeError::from(error).to_string());
                        offer = record
                            .filter(|_| !kind.instant && !kind.runs_programs)
                            .map(|record| (record, values));
                    }
                }
            }
        }
        drop(lease);
        if let (Some(shared), Some((record, values))) = (shared, offer) {
            let lengths = values.iter().map(|(_, bytes)| bytes.len() as u64).collect();
            let values: Vec<(Digest, &[u8])> =
                values.iter().map(|(digest, bytes)| (*digest, bytes.as_slice())).collect();
            let publish = || shared.publish(&Entry { key, lengths, record }, &values, &cancel);
            tracer.span(&graph.nodes[index].id, "publish", || threads.waiting(publish));
        }
        stored.send(Message::Stored { node: index, error });
    }

    /// Runs the code and encodes its outputs. `spent` receives the time and counts even if the code fails.
    fn compute(self, spent: &mut Effort) -> Result<(Finished, Vec<Vec<u8>>), NodeError> {
        let node = &self.graph.nodes[self.node];
        let parts = StoredParts::new(
            node,
            self.store.clone(),
            self.prepared.clone(),
            self.input_digests,
            self.sender.clone(),
            self.tracer.clone(),
        );
        let context = Context {
            cancel: self.cancel,
            threads: Some(self.threads.clone()),
            progress: progress(node, self.sender),
            parts: Some(Box::new(parts)),
            ..context_of(self.graph, self.node, &self.action)
        };
        let (work, memory, tracer) = (self.work, self.memory, &self.tracer);
        let Computed { record, values, effort, encoded } =
            Code { node, inputs: self.inputs, context, work, memory, tracer }.run(spent)?;
        Ok((Finished { record, values, effort, ran: true }, encoded))
    }
}

/// The context for the code of a node, without parts and cancellation.
pub(crate) fn context_of(graph: &Graph, index: usize, action: &Action) -> Context {
    let around = Surroundings::of(graph, index, action.recipe.clone());
    around.context(&graph.nodes[index].kind, graph.root.clone(), action.sources.clone())
}
