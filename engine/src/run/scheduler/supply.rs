//! Loading of input values, and dropping of values that are not needed any more.
//!
//! A value comes from the store, or from a rerun of its node if only its digest was stored or the stored bytes are
//! missing. It stays in memory while it may be read: see [`Slot::readers`].
//!
//! [`Slot::readers`]: crate::run::slot::Slot::readers

use std::time::Instant;

use cache::Digest;

use crate::graph::node::Wire;
use crate::record::action::never_runs;
use crate::record::record::Output;
use crate::run::event::Event;
use crate::run::message::{Finished, Message, Owed};
use crate::run::scheduler::sharing::{may_be_available, value_of};
use crate::run::scheduler::{Run, Task};
use crate::run::slot::{Life, Waiter};
use crate::value::artifact::AnyArtifact;
use crate::value::error::NodeError;

/// The reason to run a node again if the store has only the digest of its value.
const DIGEST_ONLY: &str = "only the digest of its value was stored";

impl<'a> Run<'a> {
    /// Requests the input values of ready nodes. About as many nodes as there are threads are supplied at once, and
    /// none while memory is full, so that the values of a wide graph are not all loaded at once.
    pub fn supply(&mut self) {
        let now = Instant::now();
        while let Some(index) = self.queue.next_ready(&self.slots, now)
            && (self.memory.has_room() || self.queue.is_idle())
        {
            self.queue.supply(index, &mut self.slots[index]);
            self.gather(index);
        }
    }

    /// Requests all input values of a node.
    pub fn gather(&mut self, index: usize) {
        let graph = self.graph;
        self.slots[index].missing = 0;
        for &wire in graph.nodes[index].inputs.iter().flatten() {
            if self.slots[wire.node].value(wire.port).is_none() {
                self.slots[index].missing += 1;
                self.request(wire, Waiter::Code(index));
            }
        }
        if self.slots[index].missing == 0 {
            self.enqueue(index);
        }
    }

    /// Queues a node whose input values are in memory.
    pub fn enqueue(&mut self, index: usize) {
        self.queue.enqueue(index, &mut self.slots[index]);
    }

    /// Requests an output for `waiter`.
    pub fn request(&mut self, wire: Wire, waiter: Waiter) {
        self.slots[wire.node].waiters.push((wire.port, waiter));
        self.todo.push_back(Task::Bring(wire));
    }

    /// Loads an output from the store, or reruns its node if the value is not stored.
    pub fn bring(&mut self, wire: Wire) {
        let Wire { node, port } = wire;
        let slot = &mut self.slots[node];
        if slot.lost {
            return self.lose(node, None);
        }
        if slot.value(port).is_some() {
            return self.wake(node, port);
        }
        let Some(record) = slot.record.as_ref().filter(|_| slot.remaking.is_none()) else { return };
        let output = record.outputs[port].clone();
        if let Some(value) = self.engine.warm.as_ref().and_then(|warm| warm.values.get(&output.name())) {
            return self.arrive(node, port, value);
        }
        if !may_be_available(self.engine, &self.graph.nodes[node], &output) {
            return self.remake(node, DIGEST_ONLY);
        }
        if slot.begin_loading(port) {
            let (engine, options, graph) = (self.engine, self.options, self.graph);
            let (sender, tracer, key) = (self.sender.clone(), self.tracer.clone(), slot.key);
            self.send(node, move || {
                let owed = Owed::new(&sender, |_| Message::Loaded { node, port, value: Ok(None) });
                let read = || value_of(engine, options, &graph.nodes[node], port, key, &output.digest);
                let value = tracer.span(&graph.nodes[node].id, "load", read);
                owed.send(Message::Loaded { node, port, value });
            });
        }
    }

    /// Handles a value that is missing from the store although the record of its node exists.
    pub fn missing(&mut self, index: usize, port: usize) {
        let node = &self.graph.nodes[index];
        let slot = &mut self.slots[index];
        slot.end_loading(port);
        let output = slot.record.as_ref().map(|record| &record.outputs[port]);
        if output.is_some_and(|output| !output.stored) {
            return self.remake(index, DIGEST_ONLY);
        }
        let digest = output.map(|output| output.digest);
        let mut reported = false;
        for incident in self.engine.store.take_incidents() {
            let ours = incident.digest.is_some() && incident.digest == digest;
            reported |= ours;
            let text = if ours { format!("`{}`: {incident}", node.id) } else { incident.to_string() };
            (self.emit)(Event::Warning { id: "cache-damage", text });
        }
        if !reported {
            self.gone.insert(index);
        }
        self.remake(index, "its stored value was missing or damaged");
    }

    fn remake(&mut self, index: usize, reason: &str) {
        let slot = &mut self.slots[index];
        if slot.remaking.is_some() {
            return;
        }
        slot.remaking = Some(slot.life);
        slot.life = Life::Gathering;
        for &above in self.graph.reads(index) {
            self.slots[above].readers += 1;
        }
        if self.graph.nodes[index].kind.runs_programs && self.graph.root.is_confined() {
            let error = never_runs(&self.graph.nodes[index], &self.graph.root);
            return self.lose(index, Some(&error));
        }
        let id = self.graph.nodes[index].id.clone();
        (self.emit)(Event::Remake { id, reason: reason.to_owned() });
        match self.forecast(index) {
            Ok(()) => self.todo.push_back(Task::Gather(index)),
            Err(error) => self.lose(index, Some(&error)),
        }
    }

    /// Ends a rerun that only provides values, whether it succeeded or failed.
    pub fn end_remake(&mut self, index: usize) {
        let slot = &mut self.slots[index];
        if slot.remaking.is_none() {
            return;
        }
        self.queue.leave(index, slot);
        slot.life = slot.remaking.take().unwrap_or(slot.life);
        self.release_inputs(index);
    }

    /// Handles the result of a rerun that only provides values.
    pub fn remade(&mut self, index: usize, finished: Finished) {
        let digests = |outputs: &[Output]| -> Vec<Digest> { outputs.iter().map(|o| o.digest).collect() };
        let known = self.slots[index].record.as_ref().map(|record| digests(&record.outputs));
        if known != Some(digests(&finished.record.outputs)) {
            let hint = if self.graph.nodes[index].kind.runs_programs {
                "programs may give another result each time; run again, which computes everything after it as well"
            } else {
                "a file changed while the graph was running, or the kind is not deterministic, which is a bug to report"
            };
            let error = NodeError::new("a rerun gave a different result for the same inputs").hint(hint);
            return self.lose(index, Some(&error));
        }
        self.learn(index, &finished);
        self.end_remake(index);
        self.totals.remade += 1;
        for (name, n) in &finished.effort.counts {
            *self.totals.counts.entry(name.clone()).or_default() += n;
        }
        for (port, value) in finished.values.into_iter().enumerate() {
            self.arrive(index, port, value);
        }
    }

    /// Keeps in memory the values that a node computed, as long as they may be read.
    pub fn hold(&mut self, index: usize, values: &[AnyArtifact]) {
        for (port, value) in values.iter().enumerate() {
            self.take_in(index, port, value.clone());
        }
    }

    fn take_in(&mut self, index: usize, port: usize, value: AnyArtifact) {
        let bytes = (self.graph.nodes[index].kind.outputs[port].artifact.bytes)(&value) as u64;
        self.memory.keep(&mut self.slots[index], port, value, bytes);
        self.keep_for_later(index);
    }

    /// Puts the values of a node into the cache that outlives the run.
    pub fn keep_for_later(&self, index: usize) {
        let Some(warm) = &self.engine.warm else { return };
        let slot = &self.slots[index];
        for (port, output) in slot.record.iter().flat_map(|record| &record.outputs).enumerate() {
            if let Some((value, bytes)) = slot.sized_value(port) {
                warm.values.put(&output.name(), value, bytes);
            }
        }
    }

    /// Handles a value that was loaded or recomputed.
    pub fn arrive(&mut self, index: usize, port: usize, value: AnyArtifact) {
        self.take_in(index, port, value);
        self.wake(index, port);
        self.memory.drop_unread(&mut self.slots[index]);
    }

    /// Continues all consumers that waited for a value.
    fn wake(&mut self, index: usize, port: usize) {
        let waiters = std::mem::take(&mut self.slots[index].waiters);
        let (woken, rest): (Vec<_>, Vec<_>) = waiters.into_iter().partition(|(wanted, _)| *wanted == port);
        self.slots[index].waiters = rest;
        for (_, waiter) in woken {
            match waiter {
                Waiter::Files(node) => self.todo.push_back(Task::Files(node)),
                Waiter::Code(node) if self.slots[node].life == Life::Gathering => {
                    self.slots[node].missing -= 1;
                    if self.slots[node].missing == 0 {
                        self.enqueue(node);
                    }
                }
                Waiter::Code(node) if self.slots[node].life == Life::Collecting => {
                    self.slots[node].missing -= 1;
                    if self.slots[node].missing == 0 {
                        self.send_away(node);
                    }
                }
                // The reader was skipped meanwhile.
                Waiter::Code(_) => {}
            }
        }
    }

    /// Handles the failure to store a result.
    pub fn unstored(&mut self, index: usize, error: String) {
        if let Some(record) = &mut self.slots[index].record {
            record.outputs.iter_mut().for_each(|output| output.stored = false);
        }
        self.warn_unstored("cache-write", error);
    }

    /// Warns once that not all results are stored.
    pub fn warn_unstored(&mut self, id: &'static str, why: String) {
        if !std::mem::replace(&mut self.store_failed, true) {
            let text = format!("not all results of this run were stored: {why}");
            (self.emit)(Event::Warning { id, text });
        }
    }

    /// Removes a node from the readers of its inputs.
    pub fn release_inputs(&mut self, index: usize) {
        let graph = self.graph;
        for &above in graph.reads(index) {
            self.memory.remove_reader(&mut self.slots[above]);
        }
    }
}
