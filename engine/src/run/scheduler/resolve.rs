//! Resolving nodes: making their keys, looking them up, and recording results.

use crate::graph::node::Wire;
use crate::kind::context::ReadSource;
use crate::record::action::{
    digest_sources, is_usable, known_sources, look_up, never_runs, prepare, remember,
};
use crate::record::record::{Output, Record};
use crate::run::event::{Event, State};
use crate::run::message::{Finished, Message, Owed};
use crate::run::scheduler::{Run, Task};
use crate::run::slot::Life;
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;
use crate::value::error::guarded;

impl Run<'_> {
    /// Resolves a node whose inputs are known by digest. Its source files, which are part of its key, are digested
    /// first.
    pub(super) fn resolve(&mut self, index: usize) {
        let (graph, engine) = (self.graph, self.engine);
        if !graph.nodes[index].kind.reads_files {
            return self.look_up(index, Vec::new());
        }
        let files = match graph.nodes[index].step.sources(&graph.root) {
            Ok(files) => files,
            Err(error) => return self.fail(index, &error),
        };
        if let Some(sources) = known_sources(&files, &engine.store) {
            return self.look_up(index, sources);
        }
        // Gigabytes may have to be hashed, so a thread does it.
        self.slots[index].life = Life::Reading;
        let (sender, tracer) = (self.sender.clone(), self.tracer.clone());
        let cancel = self.options.cancel.clone();
        self.send(index, move || {
            let cancelled = || cancel.load(std::sync::atomic::Ordering::Relaxed);
            let owed = Owed::new(&sender, |error| Message::Sources { node: index, sources: Err(error) });
            let node = &graph.nodes[index];
            let read = || guarded(|| digest_sources(node, files, &graph.root, &engine.store, &cancelled));
            let sources = tracer.span(&graph.nodes[index].id, "sources", read);
            owed.send(Message::Sources { node: index, sources });
        });
    }

    pub(super) fn look_up(&mut self, index: usize, sources: Vec<ReadSource>) {
        let node = &self.graph.nodes[index];
        let slots = &self.slots;
        let output = |wire: Wire| -> &Output {
            &slots[wire.node].record.as_ref().expect("inputs are resolved first").outputs[wire.port]
        };
        let sources_above = |above: usize| slots[above].action.sources.as_slice();
        let scratch = std::mem::take(&mut self.scratch);
        let action = match prepare(self.graph, index, sources, output, sources_above, scratch) {
            Ok(action) => action,
            Err(error) => return self.fail(index, &error),
        };
        let key = action.digest();
        self.slots[index].key = Some(key);
        self.slots[index].action = action;
        if let Some(twin) = self.known.made_by(&key) {
            let record = self.slots[twin].record.clone().expect("a computed node has a record");
            self.copy_values(twin, index);
            return self.settle(index, record, State::Cached, Effort::default());
        }
        if self.known.follow(&key, index) {
            self.slots[index].life = Life::Following;
            return;
        }
        let usable = |record: &Record| is_usable(self.graph, index, record, &self.engine.store);
        if let Some(record) = look_up(&self.engine.store, node, &key).filter(usable) {
            return self.settle(index, record, State::Cached, Effort::default());
        }
        if node.kind.runs_programs && self.graph.root.is_confined() {
            return self.fail(index, &never_runs(node, &self.graph.root));
        }
        if self.ask(index, key) {
            return;
        }
        if let Err(error) = self.forecast(index) {
            return self.fail(index, &error);
        }
        self.known.begin(key);
        self.queue.make_ready(index, &mut self.slots[index]);
    }

    pub(super) fn finished(&mut self, index: usize, finished: Finished) {
        if finished.ran {
            self.learn(index, &finished);
        }
        let Finished { mut record, values, mut effort, ran } = finished;
        if let Err(error) = self.compare(index, &record) {
            return self.fail(index, &error);
        }
        // Work done before the node was parked belongs to this run as well.
        effort.add(&std::mem::take(&mut self.slots[index].effort));
        let followers = self.take_followers(index);
        if let (true, Some(key)) = (ran, self.slots[index].key) {
            self.known.set_made(key, index);
            if let Some(why) = self.engine.store.why_read_only() {
                record.outputs.iter_mut().for_each(|output| output.stored = false);
                self.warn_unstored("cache-read-only", format!("the cache cannot be written ({why})"));
            }
        }
        for follower in followers {
            self.hold(follower, &values);
            self.settle(follower, record.clone(), State::Cached, Effort::default());
        }
        self.hold(index, &values);
        // Another process may have computed it first.
        self.settle(index, record, if ran { State::Ran } else { State::Cached }, effort);
    }

    /// Records the outputs of a node and resolves the nodes that waited for them.
    pub(super) fn settle(&mut self, index: usize, record: Record, state: State, effort: Effort) {
        let graph = self.graph;
        let node = &graph.nodes[index];
        let inherited = graph.reads(index).iter().any(|&above| self.slots[above].degraded);
        let rough = graph.reads(index).iter().any(|&above| self.slots[above].rough);
        let slot = &mut self.slots[index];
        slot.degraded = inherited || record.notes.is_degraded();
        slot.rough |= rough;
        if let Some(key) = slot.key.filter(|_| !slot.rough) {
            remember(&self.engine.store, self.known.history(), node, &key);
        }
        slot.record = Some(record);
        slot.end = Some(state);
        // The manifest is in the record, and those of a large graph would take much memory.
        self.scratch = slot.action.take_memory();
        for (name, n) in &effort.counts {
            *self.totals.counts.entry(name.clone()).or_default() += n;
        }
        self.keep_for_later(index);
        self.release_inputs(index);
        if node.sink_path.is_some() {
            self.slots[index].life = Life::Placing;
            self.slots[index].effort = effort;
            self.todo.push_back(Task::Files(index));
        } else {
            self.done(index, effort);
        }
    }

    /// Reports that a node is done, and queues its consumers to be resolved if they wait for no other node.
    pub fn done(&mut self, index: usize, effort: Effort) {
        let graph = self.graph;
        let node = &graph.nodes[index];
        let slot = &mut self.slots[index];
        slot.life = Life::Done;
        let state = slot.end.expect("a node that is done has an end state");
        let record = slot.record.as_ref().expect("a node that is done has a record");
        self.totals.add(state);
        self.totals.degraded += usize::from(slot.degraded);
        (self.emit)(Event::Node {
            id: node.id.clone(),
            kind: node.kind.name,
            state,
            key: slot.key,
            seconds: effort.seconds,
            cpu_seconds: effort.cpu_seconds,
            counts: effort.counts,
            notes: record.notes.iter().cloned().collect(),
            degraded: slot.degraded,
            error: None,
        });
        for &below in graph.consumers(index) {
            let slot = &mut self.slots[below];
            slot.unresolved -= 1;
            if slot.unresolved == 0 && slot.life == Life::Waiting {
                self.todo.push_back(Task::Resolve(below));
            }
        }
        self.memory.drop_unread(&mut self.slots[index]);
    }

    /// Copies the values of the node `from` to the node `to`, which has the same key, for the readers of `to`.
    pub(super) fn copy_values(&mut self, from: usize, to: usize) {
        let outputs = self.graph.nodes[from].kind.outputs.len();
        let values: Option<Vec<AnyArtifact>> =
            (0..outputs).map(|port| self.slots[from].value(port).cloned()).collect();
        if let Some(values) = values {
            self.hold(to, &values);
        }
    }
}
