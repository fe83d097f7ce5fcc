//! Values in memory: bringing them there for code that is to run, admitting that code, and letting go.
//!
//! A value comes from the store, or by running its node once more where only its digest was kept or the
//! stored bytes are gone. It stays while somebody may read it: see [`Slot::readers`].
//!
//! [`Slot::readers`]: crate::slot::Slot::readers

use std::time::{Duration, Instant};

use cache::Digest;

use crate::action::Action;
use crate::artifact::AnyArtifact;
use crate::error::NodeError;
use crate::event::Event;
use crate::graph::Wire;
use crate::job::{Finished, Job, guarded, load};
use crate::record::Output;
use crate::run::{Run, Scope, Task};
use crate::slot::{Life, Waiter};

/// How long a node waits before it asks again for a key that another process computes.
const FIRST_PAUSE: Duration = Duration::from_millis(5);

impl<'a> Run<'a> {
    /// Lets ready nodes gather their inputs: as many as there are threads to keep busy, and no more while
    /// memory is full, so that a wide graph does not come to memory all at once.
    pub fn supply(&mut self) {
        while self.supplied < self.engine.jobs
            && (self.held + self.reserved < self.engine.memory || self.supplied + self.running == 0)
            && let Some((_, index)) = self.ready.pop_first()
        {
            self.slots[index].life = Life::Gathering;
            self.supplied += 1;
            self.gather(index);
        }
    }

    /// Asks for every input value of a node whose code is to run.
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

    fn enqueue(&mut self, index: usize) {
        self.slots[index].life = Life::Queued;
        self.queue.insert((self.rank[index], index));
    }

    /// Has an output brought to memory for `waiter`.
    pub fn request(&mut self, wire: Wire, waiter: Waiter) {
        self.slots[wire.node].waiters.push((wire.port, waiter));
        self.todo.push_back(Task::Bring(wire));
    }

    /// Loads an output, or has it made once more.
    pub fn bring<'s>(&mut self, wire: Wire, scope: Scope<'_, 's>)
    where
        'a: 's,
    {
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
        if !output.stored {
            return self.remake(node, "only its digest was kept");
        }
        if slot.begin_loading(port) {
            let (engine, graph, sender) = (self.engine, self.graph, self.sender.clone());
            self.busy += 1;
            scope.spawn(move |_| load(&engine.store, graph, wire, &output, &sender));
        }
    }

    /// A value is not in the store although its record says so.
    pub fn missing(&mut self, index: usize, port: usize) {
        let node = &self.graph.nodes[index];
        let slot = &mut self.slots[index];
        slot.end_loading(port);
        let digest = slot.record.as_ref().map(|record| record.outputs[port].digest);
        let mut told = false;
        for incident in self.engine.store.take_incidents() {
            let ours = incident.digest.is_some() && incident.digest == digest;
            told |= ours;
            let text = if ours { format!("`{}`: {incident}", node.id) } else { incident.to_string() };
            (self.tell)(Event::Warning { id: "cache-damage", text });
        }
        if let (false, Some(digest)) = (told, digest) {
            let text = format!("`{}`: its stored value {} is gone", node.id, digest.short());
            (self.tell)(Event::Warning { id: "cache-damage", text });
        }
        self.remake(index, "its stored bytes were missing or damaged");
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
        let id = self.graph.nodes[index].id.clone();
        (self.tell)(Event::Remake { id, reason: reason.to_owned() });
        self.todo.push_back(Task::Gather(index));
    }

    /// A remake is over, whatever came of it.
    fn end_remake(&mut self, index: usize) {
        let Some(life) = self.slots[index].remaking.take() else { return };
        self.queue.remove(&(self.rank[index], index));
        self.slots[index].life = life;
        self.release_inputs(index);
    }

    /// The code of a node ran once more.
    pub fn remade(&mut self, index: usize, finished: Finished) {
        let digests = |outputs: &[Output]| -> Vec<Digest> { outputs.iter().map(|o| o.digest).collect() };
        let known = self.slots[index].record.as_ref().map(|record| digests(&record.outputs));
        if known != Some(digests(&finished.record.outputs)) {
            let error = NodeError::new("made once more, it gave another result for the same inputs").hint(
                "its kind is not deterministic, or a file changed while the graph ran; please report the former",
            );
            return self.lose(index, Some(&error));
        }
        self.end_remake(index);
        for (port, value) in finished.values.into_iter().enumerate() {
            self.arrive(index, port, value);
        }
    }

    /// The values of a node cannot be had once more: what waits for them is skipped. What is known by
    /// digest below it stays known.
    pub fn lose(&mut self, index: usize, error: Option<&NodeError>) {
        let mut error = error.filter(|error| !error.is_cancelled());
        let mut lost = vec![index];
        while let Some(node) = lost.pop() {
            self.end_remake(node);
            self.slots[node].lost = true;
            let waiters = std::mem::take(&mut self.slots[node].waiters);
            match (self.slots[node].life, error.take()) {
                (Life::Placing, Some(error)) => self.fail(node, error),
                (Life::Placing, None) => self.skip(node),
                (_, Some(error)) => {
                    self.report(node, error);
                    self.slots[node].life = Life::Failed;
                }
                _ => {}
            }
            for (_, waiter) in waiters {
                let Waiter::Code(reader) = waiter else { continue };
                if self.slots[reader].remaking.is_some() {
                    lost.push(reader);
                } else if self.slots[reader].life == Life::Gathering {
                    self.skip(reader);
                }
            }
            self.drop_unread(node);
        }
    }

    /// Keeps the values that a node's code gave.
    pub fn hold(&mut self, index: usize, values: &[AnyArtifact]) {
        for (port, value) in values.iter().enumerate() {
            self.take_in(index, port, value.clone());
        }
    }

    fn take_in(&mut self, index: usize, port: usize, value: AnyArtifact) {
        let bytes = (self.graph.nodes[index].kind.outputs[port].artifact.bytes)(&value) as u64;
        if self.slots[index].keep(port, value, bytes) {
            self.held += bytes;
            self.totals.peak_bytes = self.totals.peak_bytes.max(self.held);
        }
    }

    /// A value came to memory.
    pub fn arrive(&mut self, index: usize, port: usize, value: AnyArtifact) {
        self.take_in(index, port, value);
        self.wake(index, port);
        self.drop_unread(index);
    }

    /// Whoever waited for a value goes on.
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
                // It was skipped in the meantime.
                Waiter::Code(_) => {}
            }
        }
    }

    /// Starts queued code while threads and memory last. One node always runs, however large it is
    /// within the budget as a whole.
    pub fn launch<'s>(&mut self, scope: Scope<'_, 's>)
    where
        'a: 's,
    {
        while self.running < self.engine.jobs
            && let Some(&(rank, index)) = self.queue.first()
        {
            let bytes = match self.cost(index) {
                Ok(bytes) => bytes,
                Err(error) => {
                    self.stumble(index, &error);
                    continue;
                }
            };
            if self.running > 0 && self.held + self.reserved + bytes > self.engine.memory {
                return;
            }
            self.queue.remove(&(rank, index));
            self.start(index, bytes, scope);
        }
    }

    /// A node that runs or is about to cannot.
    pub fn stumble(&mut self, index: usize, error: &NodeError) {
        if self.slots[index].remaking.is_some() {
            self.lose(index, Some(error));
        } else {
            self.fail(index, error);
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
        let (step, inputs) = (&self.graph.nodes[index].step, self.inputs(index));
        let bytes = guarded(|| Ok(step.estimate(inputs)))?.bytes;
        if bytes > self.engine.memory {
            let (needs, budget) = (size_text(bytes), size_text(self.engine.memory));
            return Err(NodeError::new(format!("needs about {needs} of memory, the budget is {budget}"))
                .hint("ask for less (a smaller size, fewer views), or raise `--memory`"));
        }
        self.slots[index].cost = Some(bytes);
        Ok(bytes)
    }

    fn start<'s>(&mut self, index: usize, bytes: u64, scope: Scope<'_, 's>)
    where
        'a: 's,
    {
        let (graph, engine) = (self.graph, self.engine);
        let node = &graph.nodes[index];
        let digest = |w: &Wire| self.slots[w.node].record.as_ref().map(|r| r.outputs[w.port].digest);
        let ports = node.kind.inputs.iter().zip(&node.inputs);
        let input_digests =
            ports.map(|(port, wires)| (port.name, wires.iter().filter_map(digest).collect())).collect();
        let inputs = self.inputs(index);
        let slot = &mut self.slots[index];
        if slot.remaking.is_none() {
            self.supplied -= 1;
        }
        slot.life = Life::Running;
        slot.reserved = bytes;
        slot.storing = true;
        let job = Job {
            store: &engine.store,
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
            cancel: self.options.cancel.clone(),
            tell: self.sender.clone(),
        };
        self.reserved += bytes;
        self.running += 1;
        self.busy += 1;
        scope.spawn(move |_| job.run());
    }

    /// Another process computes the key of this node; its thread is free for others meanwhile.
    pub fn park(&mut self, index: usize) {
        let slot = &mut self.slots[index];
        slot.storing = false;
        slot.life = Life::Parked;
        let pause = FIRST_PAUSE * (1 << slot.parked.min(4));
        slot.parked += 1;
        self.parked.push((Instant::now() + pause, index));
    }

    /// Queues parked nodes that have waited long enough.
    pub fn unpark(&mut self) {
        let now = Instant::now();
        let parked = std::mem::take(&mut self.parked).into_iter();
        let (due, rest): (Vec<_>, Vec<_>) = parked.partition(|(when, _)| *when <= now);
        self.parked = rest;
        for (_, index) in due {
            if self.slots[index].remaking.is_none() {
                self.supplied += 1;
            }
            self.enqueue(index);
        }
    }

    /// A result could not be stored: its values are only in memory.
    pub fn unstored(&mut self, index: usize, error: String) {
        if let Some(record) = &mut self.slots[index].record {
            record.outputs.iter_mut().for_each(|output| output.stored = false);
        }
        self.warn_unstored("cache-write", error);
    }

    /// Says once that not everything is kept.
    pub fn warn_unstored(&mut self, id: &'static str, why: String) {
        if !std::mem::replace(&mut self.store_failed, true) {
            let text = format!("results of this run are not all kept: {why}");
            (self.tell)(Event::Warning { id, text });
        }
    }

    /// The node reads its inputs no more.
    pub fn release_inputs(&mut self, index: usize) {
        let graph = self.graph;
        for &above in graph.reads(index) {
            self.slots[above].readers -= 1;
            self.drop_unread(above);
        }
    }

    /// Lets go of values that nobody will ask for.
    pub fn drop_unread(&mut self, index: usize) {
        if self.slots[index].is_unread() {
            self.held -= self.slots[index].drop_values();
        }
    }
}

/// A size in the unit that a person would use.
fn size_text(bytes: u64) -> String {
    let gib = bytes as f64 / (1_u64 << 30) as f64;
    if gib >= 1.0 { format!("{gib:.1} GiB") } else { format!("{:.1} MiB", gib * 1024.0) }
}
