//! A run of a graph: what is wanted and not known runs, on shared threads, within a memory budget.
//!
//! One thread decides, the others compute. Deciding is a walk over the graph: a node whose inputs are
//! known by digest is *resolved* by looking its key up; where nothing is found its input values are
//! brought to memory (see `supply`) and its code is queued. Nothing here recurses over the graph.

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use cache::Digest;

use crate::graph::graph::Graph;
use crate::graph::node::Wire;
use crate::graph::reads::ReadFiles;
use crate::kind::context::ReadSource;
use crate::record::action::{digest_sources, known_sources, look_up, prepare, remember};
use crate::record::record::{Output, Record};
use crate::run::engine::Engine;
use crate::run::event::{Event, State, Totals};
use crate::run::message::{Finished, Message};
use crate::run::options::{Outcome, RunOptions};
use crate::run::remembered::lookups::LookupMemo;
use crate::run::remembered::unchanged as noop_check;
use crate::run::slot::{Life, Slot};
use crate::run::trace::Tracer;
use crate::text::diag::{Diagnostic, Diagnostics};
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;
use crate::value::cpu;
use crate::value::error::NodeError;
use crate::value::error::guarded;

/// How often other processes are shown that the holder of this process's leases is at work.
const RENEW_EVERY: Duration = Duration::from_secs(1);

/// What the deciding thread has yet to do.
pub(crate) enum Task {
    Resolve(usize),
    Gather(usize),
    /// Bring an output of a node to memory.
    Bring(Wire),
    Files(usize),
}

/// What a thread is to do for a node; it tells what came of it.
pub(crate) struct Errand<'a> {
    node: usize,
    act: Box<dyn FnOnce() + Send + 'a>,
}

/// A node that waits for a key that another computes.
pub(crate) struct Parked {
    pub node: usize,
    pub key: Digest,
    /// Since when it waits, until that was told.
    pub since: Option<Instant>,
    /// When to ask.
    pub when: Instant,
    pub pause: Duration,
}

pub(crate) struct Run<'a> {
    pub engine: &'a Engine,
    pub graph: &'a Graph,
    pub options: &'a RunOptions,
    pub sender: Sender<Message>,
    pub tell: &'a mut dyn FnMut(Event),
    pub slots: Vec<Slot>,
    /// Position of each node in the order of the graph: what comes first there runs first.
    pub rank: Vec<usize>,
    pub todo: VecDeque<Task>,
    /// What threads are to do and were not given yet.
    pub errands: Vec<Errand<'a>>,
    /// Nodes that are [`Life::Ready`], [`Life::Queued`] and [`Life::Parked`], by rank.
    pub ready: BTreeSet<(usize, usize)>,
    pub queue: BTreeSet<(usize, usize)>,
    pub parked: Vec<Parked>,
    /// Nodes being computed, by key, each with those of the same key.
    pub in_flight: HashMap<Digest, Vec<usize>>,
    /// Nodes whose code ran in this run, by key: asked before the store, which may not keep everything.
    pub made: HashMap<Digest, usize>,
    /// Name of the book in which keys are remembered.
    pub last_keys: String,
    /// What the last run looked up, and whether this one comes to something else.
    pub known: LookupMemo,
    pub news: bool,
    /// Whether every node is looked at, and not only what changed since the last run of this process.
    pub whole: bool,
    /// Memory in which keys are written.
    pub scratch: Vec<u8>,
    /// Which sink writes a file.
    pub claims: BTreeMap<PathBuf, usize>,
    /// What no sink may write over.
    pub read: OnceCell<ReadFiles>,
    /// Nodes whose life is [`Life::Gathering`] or [`Life::Queued`], remakes left out.
    pub supplied: usize,
    pub running: usize,
    /// Messages that threads still owe.
    pub busy: usize,
    /// Bytes of values in memory, and bytes that running code was admitted with.
    pub held: u64,
    pub reserved: u64,
    pub store_failed: bool,
    pub failures: Vec<Diagnostic>,
    pub totals: Totals,
    pub tracer: Tracer,
    pub start: Instant,
    pub start_cpu: Duration,
}

impl<'a> Run<'a> {
    fn stopped(&self) -> bool {
        self.options.cancel.load(Ordering::Relaxed)
    }

    /// Runs to the end. Threads are started only for what needs them: a run that finds nothing to do is over
    /// before they would be there.
    pub fn run(&mut self, receiver: &Receiver<Message>) {
        self.decide();
        if self.errands.is_empty() {
            return;
        }
        match self.engine.pool() {
            Ok(pool) => pool.in_place_scope(|scope| self.coordinate(scope, receiver)),
            Err(error) => {
                let error = NodeError::from(error).hint("ask for fewer threads with `--jobs`");
                for Errand { node, .. } in std::mem::take(&mut self.errands) {
                    match self.slots[node].life {
                        Life::Done => self.lose(node, Some(&error)),
                        _ => self.stumble(node, &error),
                    }
                }
            }
        }
    }

    /// Does whatever needs no thread, until there is nothing of that.
    fn decide(&mut self) {
        while !self.stopped() {
            match self.todo.pop_front() {
                Some(Task::Resolve(node)) => self.resolve(node),
                Some(Task::Gather(node)) => self.gather(node),
                Some(Task::Bring(wire)) => self.bring(wire),
                Some(Task::Files(node)) => self.place_files(node),
                // Launching may fail nodes and supplying may lose values, which gives tasks again.
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

    /// Has a thread do something for a node, of which it tells in a message.
    pub fn send(&mut self, node: usize, act: impl FnOnce() + Send + 'a) {
        self.busy += 1;
        self.errands.push(Errand { node, act: Box::new(act) });
    }

    /// Decides until nothing is left to do, or the run is stopped and the threads are idle.
    fn coordinate<'s>(&mut self, scope: &rayon::Scope<'s>, receiver: &Receiver<Message>)
    where
        'a: 's,
    {
        let mut renewed = Instant::now();
        loop {
            if renewed.elapsed() >= RENEW_EVERY {
                self.engine.store.renew_leases();
                renewed = Instant::now();
            }
            self.decide();
            for Errand { act, .. } in self.errands.drain(..) {
                scope.spawn(move |_| act());
            }
            let idle = self.todo.is_empty() && self.queue.is_empty() && self.parked.is_empty();
            if self.busy == 0 && (self.stopped() || idle) {
                return;
            }
            // Short enough to notice that the run was stopped.
            let patience = if self.parked.is_empty() { 100 } else { 5 };
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

    fn receive(&mut self, message: Message) {
        match message {
            Message::Event(event) => (self.tell)(event),
            Message::Sources { node, sources } => {
                self.busy -= 1;
                match sources {
                    Ok(sources) => self.look_up(node, sources),
                    Err(error) => self.fail(node, &error),
                }
            }
            Message::Loaded { node, port, value } => {
                self.busy -= 1;
                match value {
                    Some(value) => self.arrive(node, port, value),
                    None => self.missing(node, port),
                }
            }
            Message::Busy { node, key, spent } => {
                self.busy -= 1;
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
                self.busy -= 1;
                self.slots[node].storing = false;
                if let Some(error) = error {
                    self.unstored(node, error);
                }
                self.drop_unread(node);
            }
            Message::Placed { node, placed } => {
                self.busy -= 1;
                self.placed(node, placed);
            }
        }
    }

    fn end_running(&mut self, index: usize) {
        self.running -= 1;
        self.reserved -= std::mem::take(&mut self.slots[index].reserved);
    }

    /// All inputs of a node are known by digest: so is its key, once the files it reads are.
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
        // Gigabytes may have to be hashed, so this is not for the thread that decides.
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
        let mut action = match prepare(self.graph, index, sources, output, sources_above, scratch) {
            Ok(action) => action,
            Err(error) => return self.fail(index, &error),
        };
        let key = action.digest();
        self.slots[index].key = Some(key);
        if let Some(record) = self.known.record(self.graph, index, &key) {
            self.scratch = action.take_memory();
            self.slots[index].action = action;
            return self.settle_known(index, record);
        }
        self.news = true;
        self.slots[index].action = action;
        if let Some(&twin) = self.made.get(&key) {
            let record = self.slots[twin].record.clone().expect("what was made has a record");
            self.copy_values(twin, index);
            return self.settle(index, record, State::Cached, Effort::default());
        }
        if let Some(followers) = self.in_flight.get_mut(&key) {
            followers.push(index);
            self.slots[index].life = Life::Following;
            return;
        }
        if let Some(record) = look_up(&self.engine.store, node, &key) {
            return self.settle(index, record, State::Cached, Effort::default());
        }
        self.in_flight.insert(key, Vec::new());
        self.slots[index].life = Life::Ready;
        self.ready.insert((self.rank[index], index));
    }

    fn finished(&mut self, index: usize, finished: Finished) {
        let Finished { mut record, values, mut effort, ran } = finished;
        // What it did before it had to wait is known by now, and was done in this run all the same.
        effort.add(&std::mem::take(&mut self.slots[index].effort));
        let followers = self.take_followers(index);
        if let (true, Some(key)) = (ran, self.slots[index].key) {
            self.made.insert(key, index);
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
        // Another process may have been faster.
        self.settle(index, record, if ran { State::Ran } else { State::Cached }, effort);
    }

    /// The outputs of a node are known: what waited for that is resolved.
    fn settle(&mut self, index: usize, record: Record, state: State, effort: Effort) {
        let rough = self.graph.reads(index).iter().any(|&above| self.slots[above].rough);
        if let Some(key) = self.slots[index].key.filter(|_| !rough && !self.slots[index].rough) {
            remember(&self.engine.store, &self.last_keys, &self.graph.nodes[index], &key);
        }
        self.settle_as(index, record, state, effort);
    }

    /// Nothing about the node is new.
    fn settle_known(&mut self, index: usize, record: Record) {
        self.settle_as(index, record, State::Cached, Effort::default());
    }

    fn settle_as(&mut self, index: usize, record: Record, state: State, effort: Effort) {
        let graph = self.graph;
        let node = &graph.nodes[index];
        let inherited = graph.reads(index).iter().any(|&above| self.slots[above].degraded);
        let rough = graph.reads(index).iter().any(|&above| self.slots[above].rough);
        let slot = &mut self.slots[index];
        slot.degraded = inherited || record.notes.is_degraded();
        slot.rough |= rough;
        slot.record = Some(record);
        slot.end = Some(state);
        // What the key was made of is in the record, and a large graph would hold it all.
        slot.action.key = None;
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

    /// Tells that a node is done, and wakes those below.
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
        self.drop_unread(index);
    }

    /// Ends the run. Gives what became of each node as well.
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
        if self.whole && self.news && !self.store_failed {
            self.known.write(store, &self.last_keys, &self.slots);
        }
        let mut quiet = self.whole && !self.news;
        if let Err(error) = store.flush() {
            let text = NodeError::from(error).to_string();
            (self.tell)(Event::Warning { id: "cache-write", text });
            quiet = false;
        }
        for incident in store.take_incidents() {
            (self.tell)(Event::Warning { id: "cache-damage", text: incident.to_string() });
            quiet = false;
        }
        self.totals.stopped = self.stopped();
        if quiet && self.all_is_known() {
            noop_check::keep(store, self.graph, &self.options.out, &self.slots);
        }
        self.totals.seconds = self.start.elapsed().as_secs_f64();
        self.totals.cpu_seconds = (cpu::of_process() - self.start_cpu).as_secs_f64();
        (self.tell)(Event::Done(self.totals.clone()));
        let failures = (!self.failures.is_empty())
            .then(|| Diagnostics::new(self.graph.source.clone(), std::mem::take(&mut self.failures)));
        (Outcome { totals: self.totals, failures }, self.slots)
    }

    /// Whether every sink was found to be in place, and nothing had to be done for that.
    fn all_is_known(&self) -> bool {
        let Totals { ran: 0, remade: 0, failed: 0, skipped: 0, stopped: false, .. } = self.totals else {
            return false;
        };
        let asked = self.options.only.is_empty() && self.options.rough.is_empty();
        asked && self.graph.nodes.iter().any(|node| node.sink_path.is_some())
    }

    /// Values of a node of the same key, for the readers of this one.
    fn copy_values(&mut self, from: usize, to: usize) {
        let outputs = self.graph.nodes[from].kind.outputs.len();
        let values: Option<Vec<AnyArtifact>> =
            (0..outputs).map(|port| self.slots[from].value(port).cloned()).collect();
        if let Some(values) = values {
            self.hold(to, &values);
        }
    }
}
