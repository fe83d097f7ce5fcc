//! Nodes that workers compute: choosing them, sending them, and accepting or checking their results.

use std::collections::{BTreeMap, BTreeSet};

use cache::Digest;

use crate::graph::node::Wire;
use crate::graph::surroundings::Surroundings;
use crate::record::pace::Pace;
use crate::record::record::{Output, Record};
use crate::remote::action_file::{self, ActionFile, BLOBS, FILES};
use crate::remote::entry::Entry;
use crate::remote::outputs::{ENTRY, VALUES};
use crate::remote::placement::Placement;
use crate::remote::workers::{Stage, Work, WorkContent, WorkFile, WorkRequest, is_checked};
use crate::run::event::{Event, State};
use crate::run::message::{Message, Owed};
use crate::run::scheduler::{Pool, Run};
use crate::run::slot::{Life, Waiter};
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;
use crate::value::error::NodeError;
use crate::value::root::staged_name;

/// Maximum number of attempts to have a node computed by a worker whose inputs are missing.
const ATTEMPTS: u32 = 3;

impl Run<'_> {
    /// Queues a node whose result is not known and whose time was estimated: here, or for a worker.
    pub(super) fn place(&mut self, index: usize) {
        if self.goes_away(index) {
            self.away.list(self.queue.place(index), &mut self.slots[index]);
        } else {
            self.queue.make_ready(index, &mut self.slots[index]);
        }
    }

    fn goes_away(&self, index: usize) -> bool {
        let Some(terms) = self.engine.workers.as_deref().and_then(|workers| workers.terms()) else {
            return false;
        };
        let node = &self.graph.nodes[index];
        let wires: BTreeSet<Wire> = node.inputs.iter().flatten().copied().collect();
        let unsent = wires.iter().filter(|wire| !self.is_held(**wire));
        let bytes = unsent.map(|wire| self.length(*wire)).sum::<u64>();
        let files = self.slots[index].action.sources.iter().map(|source| source.bytes).sum::<u64>();
        let seconds = self.slots[index].time.seconds;
        Placement::of(&node.kind, node.sink_path.is_some(), seconds, bytes + files, &terms).is_remote()
    }

    fn output(&self, wire: Wire) -> &Output {
        let record = self.slots[wire.node].record.as_ref();
        &record.expect("the inputs of a node with a key are known").outputs[wire.port]
    }

    /// True if the workers are believed to have the value of a wire.
    fn is_held(&self, wire: Wire) -> bool {
        let workers = self.engine.workers.as_deref();
        workers.is_some_and(|workers| workers.holds(&self.output(wire).digest))
    }

    /// The size of a value in bytes, as far as it is known without reading the value.
    fn length(&self, wire: Wire) -> u64 {
        let here = self.slots[wire.node].sized_value(wire.port).map(|(_, bytes)| bytes);
        here.or_else(|| self.engine.store.blob_length(&self.output(wire).digest)).unwrap_or(0)
    }

    /// Sends listed nodes to workers, as many as may be in progress at once. While memory is full, only one.
    pub(super) fn dispatch(&mut self) {
        if self.away.nothing_waits() {
            return;
        }
        let Some(terms) = self.engine.workers.as_deref().and_then(|workers| workers.terms()) else {
            for index in self.away.take_listed() {
                self.queue.make_ready(index, &mut self.slots[index]);
            }
            return;
        };
        while (self.memory.has_room() || self.away.is_idle())
            && let Some(index) = self.away.next(terms.in_flight.max(1))
        {
            self.collect(index);
        }
    }

    /// Requests the input values that neither the workers nor the store have.
    fn collect(&mut self, index: usize) {
        let graph = self.graph;
        self.slots[index].life = Life::Collecting;
        self.slots[index].missing = 0;
        for &wire in graph.nodes[index].inputs.iter().flatten() {
            let is_here = self.slots[wire.node].value(wire.port).is_some();
            if !is_here && !self.is_held(wire) && !self.engine.store.has_blob(&self.output(wire).digest) {
                self.slots[index].missing += 1;
                self.request(wire, Waiter::Code(index));
            }
        }
        if self.slots[index].missing == 0 {
            self.send_away(index);
        }
    }

    /// The files of the action folder of a node.
    fn work_files(&self, index: usize) -> Vec<WorkFile> {
        let (graph, slot) = (self.graph, &self.slots[index]);
        let node = &graph.nodes[index];
        let around = Surroundings::of(graph, index, slot.action.recipe.clone());
        let file = ActionFile::of(node, &around, |wire| self.output(wire), &slot.action);
        let text = WorkFile { path: action_file::NAME.to_owned(), content: WorkContent::Text(file.text()) };
        let wires = node.inputs.iter().flatten();
        let values: BTreeSet<Digest> = wires.map(|wire| self.output(*wire).digest).collect();
        let value =
            |digest| WorkFile { path: format!("{BLOBS}/{digest}"), content: WorkContent::Value(digest) };
        let sources = slot.action.sources.iter().map(|source| {
            let (path, digest) = (source.file.path.clone(), source.digest);
            let name = staged_name("", &source.file.name);
            WorkFile { path: format!("{FILES}/{name}"), content: WorkContent::File { path, digest } }
        });
        // Two names of the same file are the same file in the folder.
        let sources: BTreeMap<String, WorkFile> = sources.map(|file| (file.path.clone(), file)).collect();
        [text].into_iter().chain(values.into_iter().map(value)).chain(sources.into_values()).collect()
    }

    /// Passes a node whose inputs can be sent to a thread that waits for a worker.
    pub(super) fn send_away(&mut self, index: usize) {
        let (graph, engine, options) = (self.graph, self.engine, self.options);
        let Some(workers) = engine.workers.as_deref() else { return };
        let node = &graph.nodes[index];
        let files = self.work_files(index);
        let mut values: BTreeMap<Digest, (AnyArtifact, Wire)> = BTreeMap::new();
        for &wire in node.inputs.iter().flatten() {
            if let Some(value) = self.slots[wire.node].value(wire.port) {
                values.insert(self.output(wire).digest, (value.clone(), wire));
            }
        }
        let slot = &mut self.slots[index];
        slot.life = Life::Away;
        let key = slot.key.expect("a node that is sent has a key");
        let forecast = slot.time.seconds;
        let checked = is_checked(&key, workers.terms().map_or(0.0, |terms| terms.checked));
        slot.checked = checked;
        let (sender, tracer) = (self.sender.clone(), self.tracer.clone());
        self.send_to(Pool::Away, index, move || {
            let owed = Owed::new(&sender, |error| Message::Worked { node: index, work: Err(error) });
            let bytes = |digest: &Digest| {
                let stored = engine.store.get_blob(digest).ok().flatten();
                let encode = |(value, wire): &(AnyArtifact, Wire)| {
                    (graph.nodes[wire.node].kind.outputs[wire.port].artifact.encode)(value)
                };
                stored.or_else(|| values.get(digest).map(encode))
            };
            let outputs: Vec<String> = graph.nodes[index]
                .kind
                .outputs
                .iter()
                .map(|port| format!("{VALUES}/{}", port.name))
                .collect();
            let request = WorkRequest {
                key,
                files: &files,
                bytes: &bytes,
                entry: ENTRY,
                values: &outputs,
                forecast,
                checked,
            };
            let id = &graph.nodes[index].id;
            let report = |stage: Stage| {
                let _ = sender.send(Message::Event(Event::stage(id, stage)));
            };
            let compute = || engine.threads().waiting(|| workers.compute(&request, &options.cancel, &report));
            let work = tracer.span(id, "remote", compute);
            owed.send(Message::Worked { node: index, work });
        });
        let id = node.id.clone();
        (self.emit)(Event::Start { id, kind: node.kind.name, forecast });
    }

    /// Handles the answer of the workers.
    pub(super) fn worked(&mut self, index: usize, work: Result<Work, NodeError>) {
        self.away.end(index);
        // The node was skipped meanwhile.
        if self.slots[index].life != Life::Away {
            return;
        }
        match work {
            Ok(Work::Done { entry, worker }) if !self.away.is_distrusted() => {
                self.accept(index, &entry, worker);
            }
            Ok(Work::Failed { message, hint }) => {
                let error = NodeError::new(message);
                let error = hint.into_iter().fold(error, |error, hint| error.hint(hint));
                self.fail(index, &error);
            }
            Ok(Work::Missing) if self.slots[index].attempts + 1 < ATTEMPTS => {
                self.slots[index].attempts += 1;
                self.away.list(self.queue.place(index), &mut self.slots[index]);
            }
            Ok(Work::Done { .. } | Work::Missing | Work::Refused) => {
                self.queue.make_ready(index, &mut self.slots[index]);
            }
            Err(error) => self.fail(index, &error),
        }
    }

    /// Uses the result of a worker, or computes the node here as well to compare the results.
    fn accept(&mut self, index: usize, entry: &Entry, worker: String) {
        let (node, store) = (&self.graph.nodes[index], &self.engine.store);
        let record = Record::decode(&entry.record, node).ok();
        let Some(record) = record.filter(|record| record.outputs.iter().all(|output| output.stored)) else {
            let text =
                format!("the result of `{}` from {worker} is not valid; the node is computed here", node.id);
            (self.emit)(Event::Warning { id: "remote-invalid", text });
            return self.queue.make_ready(index, &mut self.slots[index]);
        };
        if self.slots[index].checked {
            self.slots[index].check = Some(Box::new((record, worker)));
            return self.queue.make_ready(index, &mut self.slots[index]);
        }
        if let Err(error) = self.put_local(entry) {
            self.warn_unstored("cache-write", error.to_string());
        }
        if self.slots[index].time.seconds.is_none() {
            let (work, seconds) = (self.slots[index].time.work, record.spent.seconds);
            Pace::learn(store, &node.kind, work, seconds);
            self.learn_time(index, seconds);
        }
        self.away.accept(entry.key);
        self.known.set_made(entry.key, index);
        for follower in self.take_followers(index) {
            self.settle(follower, record.clone(), State::Cached, Effort::default());
        }
        let (seconds, cpu_seconds) = (record.spent.seconds, record.spent.cpu_seconds);
        let effort = Effort { seconds, cpu_seconds, counts: record.spent.counts.clone() };
        self.settle(index, record, State::Ran, effort);
    }

    /// Compares a result that was computed here with the result of a worker, if the node was computed by both. If
    /// they differ, the workers compute no further nodes, and their results are removed from the store.
    ///
    /// # Errors
    /// If the results differ.
    pub(super) fn compare(&mut self, index: usize, ours: &Record) -> Result<(), NodeError> {
        let Some(check) = self.slots[index].check.take() else { return Ok(()) };
        let (theirs, worker) = *check;
        let digests =
            |record: &Record| -> Vec<Digest> { record.outputs.iter().map(|output| output.digest).collect() };
        if digests(&theirs) == digests(ours) && theirs.files == ours.files && theirs.notes == ours.notes {
            return Ok(());
        }
        let id = &self.graph.nodes[index].id;
        let why = format!("the result of `{id}` from {worker} differs from the result of this machine");
        if let Some(workers) = self.engine.workers.as_deref() {
            workers.distrust(&why);
        }
        for key in self.away.distrust() {
            if let Err(error) = self.engine.store.remove_record(&key) {
                self.warn_unstored("cache-write", NodeError::from(error).to_string());
            }
        }
        let error = NodeError::new(why).hint(
            "the other results of the workers in this run were removed from the cache; run again without \
             `--remote-execute`, and find out which machine computes wrong results",
        );
        Err(error)
    }
}
