//! The scheduler: runs everything that is needed and not in the cache, on several threads and within a memory
//! budget.
//!
//! One thread decides, the others compute. A node whose inputs are known by digest is *resolved*: its key is looked
//! up in the store. On a miss, its input values are loaded (see `supply`) and its code is queued. Nothing here
//! recurses over the graph.

mod begin;
mod failure;
mod launch;
mod placing;
mod supply;

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use crate::graph::graph::Graph;
use crate::graph::node::Wire;
use crate::kind::context::ReadSource;
use crate::record::action::{digest_sources, known_sources, look_up, prepare, remember};
use crate::record::record::{Output, Record};
use crate::run::claims::Claims;
use crate::run::engine::Engine;
use crate::run::event::{Event, State, Totals};
use crate::run::known::Known;
use crate::run::memory::Memory;
use crate::run::message::{Finished, Message};
use crate::run::options::{Outcome, RunOptions};
use crate::run::queue::Queue;
use crate::run::slot::{Life, Slot};
use crate::run::trace::Tracer;
use crate::run::unchanged;
use crate::run::workers::{Work, Workers};
use crate::text::diag::{Diagnostic, Diagnostics};
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;
use crate::value::cpu;
use crate::value::error::{NodeError, guarded};

/// A pending step of the scheduler.
enum Task {
    Resolve(usize),
    Gather(usize),
    /// Load an output of a node.
    Bring(Wire),
    Files(usize),
}

/// Work for a node that was not passed to a thread yet.
struct Errand<'a> {
    node: usize,
    is_code: bool,
    work: Work<'a>,
}

/// A run of a graph. Its parts maintain their own counters; the methods here and in the submodules decide.
pub(crate) struct Run<'a> {
    engine: &'a Engine,
    graph: &'a Graph,
    options: &'a RunOptions,
    sender: Sender<Message>,
    tell: &'a mut dyn FnMut(Event),
    slots: Vec<Slot>,
    todo: VecDeque<Task>,
    /// Work that was not passed to a thread yet.
    errands: Vec<Errand<'a>>,
    /// The nodes whose code is to run.
    queue: Queue,
    /// Bytes of values and of running code.
    memory: Memory,
    /// Keys of this run.
    known: Known,
    /// Buffer for keys.
    scratch: Vec<u8>,
    /// The files of sinks.
    claims: Claims,
    /// Whether all nodes were inspected and no file was written.
    unchanged: bool,
    /// Number of messages that threads are still to send.
    owed: usize,
    store_failed: bool,
    failures: Vec<Diagnostic>,
    totals: Totals,
    tracer: Tracer,
    start: Instant,
    start_cpu: Duration,
}

impl<'a> Run<'a> {
    fn stopped(&self) -> bool {
        self.options.cancel.load(Ordering::Relaxed)
    }

    /// Runs to the end. Threads start only if there is work for them.
    pub fn run(&mut self, receiver: &Receiver<Message>) {
        self.decide();
        if self.errands.is_empty() {
            return;
        }
        let workers = Workers::new(self.engine.threads(), self.engine.limits().jobs);
        std::thread::scope(|scope| {
            let _closing = workers.closing();
            self.coordinate(scope, &workers, receiver);
        });
    }

    /// Fails a node for which no thread could be started.
    fn without_thread(&mut self, node: usize, is_code: bool, error: &std::io::Error) {
        let error = NodeError::new(format!("cannot start a thread: {error}"))
            .hint("ask for fewer threads with `--jobs`");
        self.settle_debt(node);
        if is_code {
            self.end_running(node);
            self.slots[node].storing = false;
        }
        match self.slots[node].life {
            Life::Done => self.lose(node, Some(&error)),
            _ => self.stumble(node, &error),
        }
    }

    /// Does everything that needs no thread.
    fn decide(&mut self) {
        while !self.stopped() {
            match self.todo.pop_front() {
                Some(Task::Resolve(node)) => self.resolve(node),
                Some(Task::Gather(node)) => self.gather(node),
                Some(Task::Bring(wire)) => self.bring(wire),
                Some(Task::Files(node)) => self.place_files(node),
                // Both may fail nodes, which adds tasks.
                None => {
                    self.unpark();
                    self.supply();
                    self.launch();
                    if self.todo.is_empty() {
                        return;
                    }
                }
            }
        }
    }

    /// Has a thread do work for a node, which ends with a message.
    pub fn send(&mut self, node: usize, act: impl FnOnce() + Send + 'a) {
        self.owed += 1;
        self.slots[node].owed += 1;
        self.errands.push(Errand { node, is_code: false, work: Box::new(act) });
    }

    /// Has a thread run the code of a node.
    pub fn send_code(&mut self, node: usize, act: impl FnOnce() + Send + 'a) {
        self.owed += 1;
        self.slots[node].owed += 1;
        self.errands.push(Errand { node, is_code: true, work: Box::new(act) });
    }

    /// Decides until nothing is left to do, or the run is cancelled and the threads are idle.
    fn coordinate<'s>(
        &mut self,
        scope: &'s std::thread::Scope<'s, '_>,
        workers: &'s Workers<'a>,
        receiver: &Receiver<Message>,
    ) {
        loop {
            self.decide();
            for Errand { node, is_code, work } in std::mem::take(&mut self.errands) {
                if let Err(error) = workers.hand(scope, is_code, work) {
                    self.without_thread(node, is_code, &error);
                }
            }
            let idle = self.todo.is_empty() && self.queue.nothing_waits();
            if self.owed == 0 && (self.stopped() || idle) {
                return;
            }
            // Short enough to notice a cancellation.
            let patience = if self.queue.has_parked() { 5 } else { 100 };
            match receiver.recv_timeout(Duration::from_millis(patience)) {
                Ok(message) => self.receive(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            while let Ok(message) = receiver.try_recv() {
                self.receive(message);
            }
        }
    }

    /// Compares all counters with the slots.
    fn check(&self) {
        self.queue.check(&self.slots);
        self.memory.check(self.graph, &self.slots);
        self.known.check(&self.slots);
        assert_eq!(self.owed, self.slots.iter().map(|slot| slot.owed).sum::<usize>(), "messages owed");
        let unstarted = self.errands.len();
        assert!(unstarted <= self.owed, "messages owed by work that waits for a thread");
    }

    /// Counts a message of a thread.
    fn settle_debt(&mut self, node: usize) {
        self.owed -= 1;
        self.slots[node].owed -= 1;
    }

    fn receive(&mut self, message: Message) {
        self.act_on(message);
        // For large graphs this would dominate the run.
        if cfg!(debug_assertions) && self.slots.len() < 1000 {
            self.check();
        }
    }

    fn act_on(&mut self, message: Message) {
        match message {
            Message::Event(event) => (self.tell)(event),
            Message::Sources { node, sources } => {
                self.settle_debt(node);
                match sources {
                    Ok(sources) => self.look_up(node, sources),
                    Err(error) => self.fail(node, &error),
                }
            }
            Message::Loaded { node, port, value } => {
                self.settle_debt(node);
                match value {
                    Some(value) => self.arrive(node, port, value),
                    None => self.missing(node, port),
                }
            }
            Message::Busy { node, key, spent } => {
                self.settle_debt(node);
                self.end_running(node);
                self.slots[node].effort.add(&spent);
                self.park(node, key);
            }
            Message::Finished { node, outcome } => {
                self.end_running(node);
                match (outcome, self.slots[node].remaking) {
                    (Ok(finished), Some(_)) => self.remade(node, *finished),
                    (Ok(finished), None) => self.finished(node, *finished),
                    (Err(error), _) => self.stumble(node, &error),
                }
            }
            Message::Stored { node, error } => {
                self.settle_debt(node);
                self.slots[node].storing = false;
                if let Some(error) = error {
                    self.unstored(node, error);
                }
                self.memory.drop_unread(&mut self.slots[node]);
            }
            Message::Placed { node, placed } => {
                self.settle_debt(node);
                self.placed(node, placed);
            }
        }
    }

    fn end_running(&mut self, index: usize) {
        self.queue.end(&self.slots[index]);
        self.memory.release(&mut self.slots[index]);
    }

    /// Resolves a node whose inputs are known by digest: its key is known once its source files are.
    fn resolve(&mut self, index: usize) {
        let (graph, engine) = (self.graph, self.engine);
        if !graph.nodes[index].kind.reads_files {
            return self.look_up(index, Vec::new());
        }
        let files = match guarded(|| graph.nodes[index].step.sources(&graph.root)) {
            Ok(files) => files,
            Err(error) => return self.fail(index, &error),
        };
        if let Some(sources) = known_sources(&files, &engine.store) {
            return self.look_up(index, sources);
        }
        // Gigabytes may have to be hashed, so a thread does it.
        self.slots[index].life = Life::Reading;
        let (sender, tracer) = (self.sender.clone(), self.tracer.clone());
        self.send(index, move || {
            let read = || guarded(|| digest_sources(&graph.nodes[index], files, &engine.store));
            let sources = tracer.span(&graph.nodes[index].id, "sources", read);
            let _ = sender.send(Message::Sources { node: index, sources });
        });
    }

    fn look_up(&mut self, index: usize, sources: Vec<ReadSource>) {
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
            let record = self.slots[twin].record.clone().expect("what was made has a record");
            self.copy_values(twin, index);
            return self.settle(index, record, State::Cached, Effort::default());
        }
        if self.known.follow(&key, index) {
            self.slots[index].life = Life::Following;
            return;
        }
        if let Some(record) = look_up(&self.engine.store, node, &key) {
            return self.settle(index, record, State::Cached, Effort::default());
        }
        if let Err(error) = self.forecast(index) {
            return self.fail(index, &error);
        }
        self.known.begin(key);
        self.queue.make_ready(index, &mut self.slots[index]);
    }

    fn finished(&mut self, index: usize, finished: Finished) {
        let Finished { mut record, values, mut effort, ran } = finished;
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
    fn settle(&mut self, index: usize, record: Record, state: State, effort: Effort) {
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

    /// Reports that a node is done, and resolves the nodes below.
    pub fn done(&mut self, index: usize, effort: Effort) {
        let graph = self.graph;
        let node = &graph.nodes[index];
        let slot = &mut self.slots[index];
        slot.life = Life::Done;
        let state = slot.end.expect("a node that is done came to an end");
        let record = slot.record.as_ref().expect("a node that is done has a record");
        self.totals.add(state);
        self.totals.degraded += usize::from(slot.degraded);
        (self.tell)(Event::Node {
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

    /// Ends the run. Returns its outcome and the end state of each node.
    pub fn finish(mut self) -> (Outcome, Vec<Slot>) {
        for index in 0..self.slots.len() {
            let slot = &self.slots[index];
            let over = matches!(slot.life, Life::Unwanted | Life::Done | Life::Failed | Life::Skipped);
            if !over && slot.remaking != Some(Life::Done) {
                self.slots[index].life = Life::Skipped;
                self.tell_skipped(index);
            }
        }
        let store = &self.engine.store;
        let mut quiet = self.unchanged;
        if let Err(error) = store.flush() {
            let text = NodeError::from(error).to_string();
            (self.tell)(Event::Warning { id: "cache-write", text });
            quiet = false;
        }
        for incident in store.take_incidents() {
            (self.tell)(Event::Warning { id: "cache-damage", text: incident.to_string() });
            quiet = false;
        }
        self.totals.peak_bytes = self.memory.peak();
        self.totals.stopped = self.stopped();
        if quiet && self.all_is_known() {
            unchanged::keep(store, self.graph, &self.options.out, &self.slots);
        }
        self.totals.seconds = self.start.elapsed().as_secs_f64();
        self.totals.cpu_seconds = (cpu::of_process() - self.start_cpu).as_secs_f64();
        (self.tell)(Event::Done(self.totals.clone()));
        let failures = (!self.failures.is_empty())
            .then(|| Diagnostics::new(self.graph.source.clone(), std::mem::take(&mut self.failures)));
        (Outcome { totals: self.totals, failures }, self.slots)
    }

    /// Whether all sinks were up to date and nothing had to be done.
    fn all_is_known(&self) -> bool {
        let Totals { ran: 0, remade: 0, failed: 0, skipped: 0, stopped: false, .. } = self.totals else {
            return false;
        };
        let asked = self.options.only.is_empty() && self.options.rough.is_empty();
        asked && self.graph.nodes.iter().any(|node| node.sink_path.is_some())
    }

    /// Copies the values of a node with the same key for the readers of this one.
    fn copy_values(&mut self, from: usize, to: usize) {
        let outputs = self.graph.nodes[from].kind.outputs.len();
        let values: Option<Vec<AnyArtifact>> =
            (0..outputs).map(|port| self.slots[from].value(port).cloned()).collect();
        if let Some(values) = values {
            self.hold(to, &values);
        }
    }
}
