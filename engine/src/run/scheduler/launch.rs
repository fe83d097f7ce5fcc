//! Starting the code of queued nodes when threads and memory are available.

use std::time::{Duration, Instant};

use cache::{Digest, LeaseState, STALLED_AFTER};

use crate::graph::node::Wire;
use crate::record::action::{Action, sizes};
use crate::record::record::Output;
use crate::run::event::Event;
use crate::run::job::Job;
use crate::run::message::Finished;
use crate::run::queue::Parked;
use crate::run::scheduler::{Pool, Run};
use crate::run::time_estimate::TimeEstimate;
use crate::value::artifact::AnyArtifact;
use crate::value::error::NodeError;
use crate::value::root::FileHead;
use crate::value::units::bytes_text;

/// Pause before the second check of whether a result is still being computed elsewhere.
const FIRST_PAUSE: Duration = Duration::from_millis(5);
/// Maximum pause between two checks of whether a result is still being computed elsewhere.
const LONGEST_PAUSE: Duration = Duration::from_millis(80);
/// Time after which a warning reports that a node waits for another process.
const REPORT_AFTER: Duration = Duration::from_secs(2);

impl<'a> Run<'a> {
    /// Starts queued nodes while threads and memory are available. If no node runs, the next one starts even if
    /// less memory is available than it needs. While a node waits for memory, only short nodes start.
    pub fn launch(&mut self) {
        let now = Instant::now();
        while let Some(index) = self.queue.next_queued(&self.slots, now) {
            let Some(bytes) = self.cost_or_fail(index) else { continue };
            if self.queue.nothing_runs() || self.memory.fits(bytes) {
                self.start(index, bytes, now);
                continue;
            }
            let Some(short) = self.queue.next_short(&self.slots, now) else { return };
            let Some(bytes) = self.cost_or_fail(short) else { continue };
            if !self.memory.fits(bytes) {
                return;
            }
            self.start(short, bytes, now);
        }
    }

    /// The memory in bytes that the code of a node needs. If it cannot be estimated or is more than the budget, the
    /// node fails, and the result is `None`.
    fn cost_or_fail(&mut self, index: usize) -> Option<u64> {
        let cost = self.cost(index);
        cost.map_err(|error| self.fail_or_lose(index, &error)).ok()
    }

    /// Estimates the time of a node with known inputs.
    pub fn forecast(&mut self, index: usize) -> Result<(), NodeError> {
        let (node, store) = (&self.graph.nodes[index], &self.engine.store);
        let output = |wire: Wire| -> &Output {
            &self.slots[wire.node].record.as_ref().expect("inputs are resolved first").outputs[wire.port]
        };
        let sizes = sizes(node, &self.slots[index].action.sources, output);
        let (kind, work) = (node.kind.name, node.step.work(&sizes)?.max(0.0));
        let seconds = if node.kind.instant { Some(0.0) } else { self.known.seconds(store, &node.kind, work) };
        self.slots[index].time = TimeEstimate { kind, work, seconds };
        Ok(())
    }

    /// Records the time of a node that ran. Nodes of its kind that had no forecast get one.
    pub fn learn(&mut self, index: usize, finished: &Finished) {
        self.learn_time(index, finished.record.spent.seconds);
    }

    /// Records that the code of a node took `seconds`.
    pub fn learn_time(&mut self, index: usize, seconds: f64) {
        let store = &self.engine.store;
        let kind = &self.graph.nodes[index].kind;
        self.known.learn(kind, self.slots[index].time.work, seconds);
        for other in self.queue.untimed(kind.name) {
            let slot = &mut self.slots[other];
            let seconds = self.known.seconds(store, kind, slot.time.work);
            self.queue.set_time(other, slot, TimeEstimate { seconds, ..slot.time });
        }
    }

    fn inputs(&self, index: usize) -> Vec<Vec<AnyArtifact>> {
        let value = |wire: &Wire| {
            let value = self.slots[wire.node].value(wire.port);
            value.expect("inputs stay in memory while a reader is queued").clone()
        };
        self.graph.nodes[index].inputs.iter().map(|wires| wires.iter().map(value).collect()).collect()
    }

    fn cost(&mut self, index: usize) -> Result<u64, NodeError> {
        if let Some(bytes) = self.slots[index].cost {
            return Ok(bytes);
        }
        let (node, inputs) = (&self.graph.nodes[index], self.inputs(index));
        let sources = &self.slots[index].action.sources;
        let heads: Vec<_> = sources.iter().map(|source| FileHead::new(&source.file, source.bytes)).collect();
        let parts = [node.step.estimate(inputs)?, node.step.estimate_files(&heads)?];
        let bytes = parts.iter().fold(0, |sum: u64, part| sum.saturating_add(part.bytes));
        let (held, budget) = (self.input_bytes(index), self.memory.limit());
        if bytes.saturating_add(held) > budget {
            let inputs = if bytes > budget || held < budget / 16 {
                String::new()
            } else {
                format!(" in addition to the {} that its inputs occupy", bytes_text(held))
            };
            let (needs, budget) = (bytes_text(bytes), bytes_text(budget));
            return Err(NodeError::new(format!(
                "the node needs about {needs} of memory{inputs}, but the budget is {budget}"
            ))
            .hint(
                "reduce the resolution, render the views one after the other (an axis `Cameras(..)` and `PickCameras`), or \
                 raise `--memory`",
            ));
        }
        self.slots[index].cost = Some(bytes);
        Ok(bytes)
    }

    /// Total size of the values that a node reads, in bytes. A value that is read through several wires is counted
    /// once.
    fn input_bytes(&self, index: usize) -> u64 {
        let mut wires: Vec<Wire> = self.graph.nodes[index].inputs.iter().flatten().copied().collect();
        wires.sort_unstable_by_key(|wire| (wire.node, wire.port));
        wires.dedup();
        wires
            .iter()
            .filter_map(|wire| self.slots[wire.node].sized_value(wire.port))
            .map(|(_, bytes)| bytes)
            .sum()
    }

    fn start(&mut self, index: usize, bytes: u64, now: Instant) {
        let (graph, engine) = (self.graph, self.engine);
        let node = &graph.nodes[index];
        let digest = |w: &Wire| self.slots[w.node].record.as_ref().map(|r| r.outputs[w.port].digest);
        let ports = node.kind.inputs.iter().zip(&node.inputs);
        let input_digests =
            ports.map(|(port, wires)| (port.name, wires.iter().filter_map(digest).collect())).collect();
        let inputs = self.inputs(index);
        let slot = &mut self.slots[index];
        self.queue.start(index, slot, now);
        self.memory.reserve(slot, bytes);
        slot.storing = true;
        let job = Job {
            store: &engine.store,
            shared: engine.shared.as_deref(),
            prepared: engine.prepared(),
            threads: engine.threads(),
            graph,
            node: index,
            inputs,
            input_digests,
            key: slot.key.expect("a queued node has a key"),
            action: Action {
                sources: slot.action.sources.clone(),
                recipe: slot.action.recipe.clone(),
                key: slot.action.key.clone(),
            },
            remake: slot.remaking.is_some(),
            work: slot.time.work,
            memory: bytes,
            tracer: self.tracer.clone(),
            cancel: self.options.cancel.clone(),
            sender: self.sender.clone(),
        };
        self.send_to(Pool::Code, index, move || job.run());
    }

    /// Parks a node because its result, or the result of one of its parts, is being computed elsewhere. A parked
    /// node occupies no thread.
    pub fn park(&mut self, node: usize, key: Digest) {
        let slot = &mut self.slots[node];
        slot.storing = false;
        let now = Instant::now();
        let (since, when) = (Some(now), now + FIRST_PAUSE);
        self.queue.park(Parked { node, key, since, when, pause: FIRST_PAUSE }, slot);
    }

    /// Queues each parked node unless a process that makes progress still holds the lease of its key.
    pub fn unpark(&mut self) {
        let now = Instant::now();
        let store = &self.engine.store;
        let mut stalled = Vec::new();
        let is_free = |parked: &Parked| {
            if parked.when > now {
                return false;
            }
            match store.lease(&parked.key) {
                LeaseState::Acquired(_) => true,
                LeaseState::Busy => false,
                LeaseState::Stalled(_) => {
                    stalled.push(parked.node);
                    true
                }
            }
        };
        let free = self.queue.take_parked(is_free);
        for node in stalled {
            let (id, seconds) = (&self.graph.nodes[node].id, STALLED_AFTER.as_secs());
            let text = format!(
                "`{id}` is computed here as well: the other process that computes it has made no progress for {seconds} s"
            );
            (self.emit)(Event::Warning { id: "stalled", text });
        }
        // While nodes of this run are running, one of them may hold the key.
        let idle = self.queue.nothing_runs();
        for parked in self.queue.parked().iter_mut().filter(|parked| parked.when <= now) {
            parked.pause = (parked.pause * 2).min(LONGEST_PAUSE);
            parked.when = now + parked.pause;
            if idle && parked.since.is_some_and(|since| now - since >= REPORT_AFTER) {
                parked.since = None;
                let id = &self.graph.nodes[parked.node].id;
                let text = format!(
                    "`{id}` waits for another process that is computing it in the same cache; if that process is \
                     suspended, `{id}` is computed here after {} s",
                    STALLED_AFTER.as_secs()
                );
                (self.emit)(Event::Warning { id: "waits", text });
            }
        }
        for node in free {
            self.queue.unpark(node, &mut self.slots[node]);
        }
    }
}
