//! The scheduler: runs what is wanted and not known, on shared threads, within a memory budget.
//!
//! One thread decides, the others compute. Deciding is a walk over the graph: a node whose inputs are
//! known by digest is *resolved* by looking its key up; where nothing is found its input values are
//! brought to memory (from the store, or by making them once more where only a digest was kept or the
//! stored bytes are damaged) and its code is queued. Nothing here recurses over the graph.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use cache::{Digest, Store};

use crate::action::{Action, last_record, look_up, prepare, remember};
use crate::artifact::AnyArtifact;
use crate::diag::{Diagnostic, Diagnostics};
use crate::error::NodeError;
use crate::event::{Counts, Event, State, Totals};
use crate::graph::{Graph, Wire};
use crate::job::{Finished, Job, Message, load};
use crate::record::{Output, Record};
use crate::sink;

/// The threads, the memory and the store that runs share.
pub struct Engine {
    store: Arc<Store>,
    pool: rayon::ThreadPool,
    jobs: usize,
    memory: u64,
}

/// What a run is asked for beside the graph.
#[derive(Debug, Clone, Default)]
pub struct RunOptions {
    /// Folder that sinks write under.
    pub out: PathBuf,
    /// The nodes that are wanted; none stands for [`Graph::targets`].
    pub only: Vec<usize>,
    /// Set from outside to stop the run; what is finished by then is kept.
    pub cancel: Arc<AtomicBool>,
}

/// How a run ended.
#[derive(Debug)]
pub struct Outcome {
    /// Counts of nodes and work.
    pub totals: Totals,
    /// What failed, with its place in the graph file.
    pub failures: Option<Diagnostics>,
}

/// Why an engine cannot be made.
#[derive(Debug, thiserror::Error)]
#[error("cannot start {jobs} threads: {source}")]
pub struct EngineError {
    jobs: usize,
    source: rayon::ThreadPoolBuildError,
}

impl Engine {
    /// An engine of `jobs` threads (at least 1) that keeps at most about `memory` bytes of values.
    pub fn new(store: Store, jobs: usize, memory: u64) -> Result<Self, EngineError> {
        let jobs = jobs.max(1);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(jobs)
            .thread_name(|index| format!("node-{index}"))
            .build()
            .map_err(|source| EngineError { jobs, source })?;
        Ok(Self { store: Arc::new(store), pool, jobs, memory })
    }

    /// The store of this engine.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Runs a graph. Every event is told on the calling thread, in order.
    pub fn run(&self, graph: &Graph, options: &RunOptions, mut tell: impl FnMut(Event)) -> Outcome {
        let (sender, receiver) = channel();
        let mut run = Run::new(self, graph, options, sender, &mut tell);
        self.pool.in_place_scope(|scope| run.coordinate(scope, &receiver));
        run.finish()
    }

    /// The value of an output, from the store; `None` when it is not stored. For tests and viewers.
    pub fn value<A: crate::Artifact>(&self, graph: &Graph, wire: Wire) -> Option<A> {
        let node = &graph.nodes[wire.node];
        let record = last_record(&self.store, graph, node)?;
        let bytes = self.store.get_blob(&record.outputs.get(wire.port)?.digest).ok()??;
        crate::artifact::decode_all(&bytes).ok()
    }
}

/// Where a node is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Life {
    /// No target stands below it.
    Unwanted,
    /// An input is not yet known by digest.
    Waiting,
    /// Not in the store; its input values are on their way to memory.
    Gathering,
    /// Input values are there; waits for a thread and for memory.
    Queued,
    /// Its code runs.
    Running,
    /// Another node of the same key is being computed.
    Following,
    /// Outputs are known by digest.
    Resolved,
    /// Its code, its sources or a file of it failed.
    Failed,
    /// Not tried, since something it needs failed or the run was stopped.
    Skipped,
}

/// Who waits for a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Waiter {
    Code(usize),
    Files(usize),
}

struct Slot {
    life: Life,
    /// Nodes above that are not resolved.
    unresolved: usize,
    /// Input values that are not in memory.
    missing: usize,
    /// Nodes below, and its own files, that may still want the values.
    readers: usize,
    action: Action,
    record: Option<Record>,
    values: Vec<Option<AnyArtifact>>,
    loading: Vec<bool>,
    waiters: Vec<(usize, Waiter)>,
    /// Resolved, but its code runs once more for its values.
    remaking: bool,
    /// Its values are being written to the store.
    storing: bool,
    degraded: bool,
    reserved: u64,
}

enum Task {
    Resolve(usize),
    Gather(usize),
    Files(usize),
}

struct Run<'a> {
    engine: &'a Engine,
    graph: &'a Graph,
    options: &'a RunOptions,
    sender: Sender<Message>,
    tell: &'a mut dyn FnMut(Event),
    slots: Vec<Slot>,
    rank: Vec<usize>,
    todo: VecDeque<Task>,
    queue: BTreeSet<(usize, usize)>,
    in_flight: BTreeMap<Digest, Vec<usize>>,
    running: usize,
    busy: usize,
    held: u64,
    reserved: u64,
    store_failed: bool,
    failures: Vec<Diagnostic>,
    totals: Totals,
    start: Instant,
}

impl<'a> Run<'a> {
    fn new(
        engine: &'a Engine,
        graph: &'a Graph,
        options: &'a RunOptions,
        sender: Sender<Message>,
        tell: &'a mut dyn FnMut(Event),
    ) -> Self {
        let targets = if options.only.is_empty() { graph.targets() } else { options.only.clone() };
        let wanted = graph.above(&targets);
        let mut rank = vec![0; graph.nodes.len()];
        for (position, &node) in graph.order().iter().enumerate() {
            rank[node] = position;
        }
        let mut slots: Vec<Slot> = Vec::with_capacity(graph.nodes.len());
        for (index, node) in graph.nodes.iter().enumerate() {
            let above: BTreeSet<usize> = node.inputs.iter().flatten().map(|wire| wire.node).collect();
            let readers = graph.consumers(index).iter().filter(|&&below| wanted[below]).count();
            let outputs = node.kind.outputs.len();
            slots.push(Slot {
                life: if wanted[index] { Life::Waiting } else { Life::Unwanted },
                unresolved: above.len(),
                missing: 0,
                readers: readers + usize::from(node.sink_path.is_some()),
                action: Action::default(),
                record: None,
                values: vec![None; outputs],
                loading: vec![false; outputs],
                waiters: Vec::new(),
                remaking: false,
                storing: false,
                degraded: false,
                reserved: 0,
            });
        }
        let ready = graph.order().iter().filter(|&&n| wanted[n] && slots[n].unresolved == 0);
        let todo = ready.map(|&node| Task::Resolve(node)).collect();
        Self {
            engine,
            graph,
            options,
            sender,
            tell,
            slots,
            rank,
            todo,
            queue: BTreeSet::new(),
            in_flight: BTreeMap::new(),
            running: 0,
            busy: 0,
            held: 0,
            reserved: 0,
            store_failed: false,
            failures: Vec::new(),
            totals: Totals::default(),
            start: Instant::now(),
        }
    }

    fn stopped(&self) -> bool {
        self.options.cancel.load(Ordering::Relaxed)
    }

    fn coordinate<'s>(&mut self, scope: &rayon::Scope<'s>, receiver: &Receiver<Message>)
    where
        'a: 's,
    {
        loop {
            while !self.stopped() {
                match self.todo.pop_front() {
                    Some(Task::Resolve(node)) => self.resolve(node),
                    Some(Task::Gather(node)) => self.gather(node, scope),
                    Some(Task::Files(node)) => self.place_files(node, scope),
                    None => break,
                }
            }
            if !self.stopped() {
                self.launch(scope);
            }
            if self.busy == 0 && (self.stopped() || (self.todo.is_empty() && self.queue.is_empty())) {
                return;
            }
            match receiver.recv_timeout(Duration::from_millis(100)) {
                Ok(message) => self.receive(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            while let Ok(message) = receiver.try_recv() {
                self.receive(message);
            }
        }
    }

    fn resolve(&mut self, index: usize) {
        let node = &self.graph.nodes[index];
        let slots = &self.slots;
        let output = |wire: Wire| -> &Output {
            &slots[wire.node].record.as_ref().expect("inputs are resolved first").outputs[wire.port]
        };
        let prepared = prepare(self.graph, index, &self.engine.store, output, |above| {
            slots[above].action.sources.as_slice()
        });
        let action = match prepared {
            Ok(action) => action,
            Err(error) => return self.fail(index, error),
        };
        let key = action.key.as_ref().map(|key| key.digest).expect("a prepared action has a key");
        self.slots[index].action = action;
        if let Some(record) = look_up(&self.engine.store, node, &key) {
            return self.settle(index, record, State::Cached, Counts::new());
        }
        match self.in_flight.get_mut(&key) {
            Some(followers) => {
                followers.push(index);
                self.slots[index].life = Life::Following;
            }
            None => {
                self.in_flight.insert(key, Vec::new());
                self.slots[index].life = Life::Gathering;
                self.todo.push_back(Task::Gather(index));
            }
        }
    }

    /// Asks for every input value of a node whose code is to run.
    fn gather<'s>(&mut self, index: usize, scope: &rayon::Scope<'s>)
    where
        'a: 's,
    {
        let graph = self.graph;
        self.slots[index].missing = 0;
        for wire in graph.nodes[index].inputs.iter().flatten() {
            if self.slots[wire.node].values[wire.port].is_none() {
                self.slots[index].missing += 1;
                self.request(*wire, Waiter::Code(index), scope);
            }
        }
        if self.slots[index].missing == 0 {
            self.enqueue(index);
        }
    }

    fn enqueue(&mut self, index: usize) {
        if !self.slots[index].remaking {
            self.slots[index].life = Life::Queued;
        }
        self.queue.insert((self.rank[index], index));
    }

    /// Brings one output to memory: loads it, or has it made once more.
    fn request<'s>(&mut self, wire: Wire, waiter: Waiter, scope: &rayon::Scope<'s>)
    where
        'a: 's,
    {
        let slot = &mut self.slots[wire.node];
        slot.waiters.push((wire.port, waiter));
        if slot.remaking || std::mem::replace(&mut slot.loading[wire.port], true) {
            return;
        }
        let Some(output) = slot.record.as_ref().map(|record| record.outputs[wire.port].clone()) else {
            return;
        };
        if !output.stored {
            return self.remake(wire.node, "only its digest was kept");
        }
        let (engine, graph, sender) = (self.engine, self.graph, self.sender.clone());
        self.busy += 1;
        scope.spawn(move |_| load(&engine.store, graph, wire.node, wire.port, &output, &sender));
    }

    fn remake(&mut self, index: usize, reason: &str) {
        if !std::mem::replace(&mut self.slots[index].remaking, true) {
            let id = self.graph.nodes[index].id.clone();
            (self.tell)(Event::Remake { id, reason: reason.to_owned() });
            self.todo.push_back(Task::Gather(index));
        }
    }

    /// Starts queued code while threads and memory last. One node always runs, however large it is
    /// within the budget as a whole.
    fn launch<'s>(&mut self, scope: &rayon::Scope<'s>)
    where
        'a: 's,
    {
        while self.running < self.engine.jobs
            && let Some(&(rank, index)) = self.queue.first()
        {
            let graph = self.graph;
            let node = &graph.nodes[index];
            let inputs: Vec<Vec<AnyArtifact>> = node
                .inputs
                .iter()
                .map(|wires| wires.iter().filter_map(|w| self.slots[w.node].values[w.port].clone()).collect())
                .collect();
            let cost = node.step.estimate(inputs.clone());
            if cost.bytes > self.engine.memory {
                self.queue.remove(&(rank, index));
                let error = NodeError::new(format!(
                    "needs about {} of memory, the budget is {}",
                    size_text(cost.bytes),
                    size_text(self.engine.memory)
                ));
                self.fail(index, error.hint("make its pictures smaller, or raise `--memory`"));
                continue;
            }
            if self.running > 0 && self.held + self.reserved + cost.bytes > self.engine.memory {
                return;
            }
            self.queue.remove(&(rank, index));
            self.start(index, inputs, cost.bytes, scope);
        }
    }

    fn start<'s>(&mut self, index: usize, inputs: Vec<Vec<AnyArtifact>>, bytes: u64, scope: &rayon::Scope<'s>)
    where
        'a: 's,
    {
        let (graph, engine) = (self.graph, self.engine);
        let node = &graph.nodes[index];
        let input_digests = node
            .kind
            .inputs
            .iter()
            .zip(&node.inputs)
            .map(|(port, wires)| {
                let digest = |w: &Wire| self.slots[w.node].record.as_ref().map(|r| r.outputs[w.port].digest);
                (port.name, wires.iter().filter_map(digest).collect())
            })
            .collect();
        let forecast = last_record(&engine.store, graph, node).map(|record| record.seconds);
        let slot = &mut self.slots[index];
        let remake = slot.remaking;
        if !remake {
            slot.life = Life::Running;
            (self.tell)(Event::Start { id: node.id.clone(), kind: node.kind.name, forecast });
        }
        slot.reserved = bytes;
        slot.storing = true;
        let sources = slot.action.sources.iter().map(|source| source.copy()).collect();
        let key = slot.action.key.clone().expect("a queued node has a key");
        let action = Action { sources, recipe: slot.action.recipe.clone(), key: None };
        let job = Job {
            store: &engine.store,
            graph,
            node: index,
            inputs,
            input_digests,
            action,
            key,
            remake,
            cancel: self.options.cancel.clone(),
            tell: self.sender.clone(),
        };
        self.reserved += bytes;
        self.running += 1;
        self.busy += 1;
        scope.spawn(move |_| job.run());
    }

    fn receive(&mut self, message: Message) {
        match message {
            Message::Event(event) => (self.tell)(event),
            Message::Loaded { node, port, value } => {
                self.busy -= 1;
                self.slots[node].loading[port] = false;
                match value {
                    Some(value) => self.arrive(node, port, value),
                    None => self.remake(node, "its stored bytes were missing or damaged"),
                }
            }
            Message::Finished { node, outcome } => {
                self.running -= 1;
                self.reserved -= std::mem::take(&mut self.slots[node].reserved);
                match outcome {
                    Ok(finished) if self.slots[node].remaking => self.remade(node, *finished),
                    Ok(finished) => self.finished(node, *finished),
                    Err(error) => self.fail(node, error),
                }
            }
            Message::Stored { node, error } => {
                self.busy -= 1;
                self.slots[node].storing = false;
                if let Some(error) = error {
                    if let Some(record) = &mut self.slots[node].record {
                        record.outputs.iter_mut().for_each(|output| output.stored = false);
                    }
                    if !std::mem::replace(&mut self.store_failed, true) {
                        let text = format!("results of this run are not all kept: {error}");
                        (self.tell)(Event::Warning { id: "cache-write", text });
                    }
                }
                self.drop_unread(node);
            }
        }
    }

    fn finished(&mut self, index: usize, finished: Finished) {
        let Finished { record, values, counts } = finished;
        let key = self.slots[index].action.key.as_ref().map(|key| key.digest);
        let followers = key.and_then(|key| self.in_flight.remove(&key)).unwrap_or_default();
        // No values means that another process was faster.
        let state = if values.is_empty() { State::Cached } else { State::Ran };
        for follower in followers {
            self.hold(follower, &values);
            self.settle(follower, record.clone(), State::Cached, Counts::new());
        }
        self.hold(index, &values);
        self.settle(index, record, state, counts);
    }

    fn remade(&mut self, index: usize, finished: Finished) {
        let known =
            self.slots[index].record.as_ref().map(|r| r.outputs.iter().map(|o| o.digest).collect::<Vec<_>>());
        let made: Vec<Digest> = finished.record.outputs.iter().map(|output| output.digest).collect();
        self.slots[index].remaking = false;
        if known.as_deref() != Some(&made) {
            let error = NodeError::new("made once more, this node gave another result for the same inputs")
                .hint("its kind is not deterministic, or its files changed while the graph ran; please report the former");
            return self.fail(index, error);
        }
        for (port, value) in finished.values.into_iter().enumerate() {
            self.arrive(index, port, value);
        }
    }

    fn hold(&mut self, index: usize, values: &[AnyArtifact]) {
        for (port, value) in values.iter().enumerate() {
            self.held += (self.graph.nodes[index].kind.outputs[port].artifact.bytes)(value) as u64;
            self.slots[index].values[port] = Some(value.clone());
        }
    }

    /// A value came to memory: whoever waited for it goes on.
    fn arrive(&mut self, index: usize, port: usize, value: AnyArtifact) {
        let slot = &mut self.slots[index];
        if slot.values[port].is_none() {
            self.held += (self.graph.nodes[index].kind.outputs[port].artifact.bytes)(&value) as u64;
            slot.values[port] = Some(value);
        }
        slot.loading[port] = false;
        let (woken, rest): (Vec<_>, Vec<_>) =
            std::mem::take(&mut slot.waiters).into_iter().partition(|(wanted, _)| *wanted == port);
        slot.waiters = rest;
        for (_, waiter) in woken {
            match waiter {
                Waiter::Files(node) => self.todo.push_back(Task::Files(node)),
                Waiter::Code(node) => {
                    self.slots[node].missing -= 1;
                    if self.slots[node].missing == 0 && self.slots[node].life != Life::Skipped {
                        self.enqueue(node);
                    }
                }
            }
        }
        self.drop_unread(index);
    }

    /// The outputs of a node are known: tells it, and resolves what waited for it.
    fn settle(&mut self, index: usize, record: Record, state: State, counts: Counts) {
        let graph = self.graph;
        let node = &graph.nodes[index];
        let inherited = node.inputs.iter().flatten().any(|wire| self.slots[wire.node].degraded);
        let degraded = inherited || record.notes.is_degraded();
        let key = self.slots[index].action.key.as_ref().map(|key| key.digest);
        if let Some(key) = &key {
            remember(&self.engine.store, graph, node, key);
        }
        match state {
            State::Ran => self.totals.ran += 1,
            _ => self.totals.cached += 1,
        }
        self.totals.degraded += usize::from(degraded);
        for (name, n) in &counts {
            *self.totals.counts.entry(name.clone()).or_default() += n;
        }
        (self.tell)(Event::Node {
            id: node.id.clone(),
            kind: node.kind.name,
            state,
            key,
            seconds: if state == State::Ran { record.seconds } else { 0.0 },
            counts,
            notes: record.notes.iter().cloned().collect(),
            degraded,
            error: None,
        });
        let slot = &mut self.slots[index];
        slot.life = Life::Resolved;
        slot.degraded = degraded;
        slot.record = Some(record);
        for &below in graph.consumers(index) {
            let slot = &mut self.slots[below];
            slot.unresolved = slot.unresolved.saturating_sub(1);
            if slot.unresolved == 0 && slot.life == Life::Waiting {
                self.todo.push_back(Task::Resolve(below));
            }
        }
        if node.sink_path.is_some() {
            self.todo.push_back(Task::Files(index));
        }
        self.release_inputs(index);
        self.drop_unread(index);
    }

    /// Compares the files of a sink with what lies there, and writes those that differ.
    fn place_files<'s>(&mut self, index: usize, scope: &rayon::Scope<'s>)
    where
        'a: 's,
    {
        let graph = self.graph;
        let node = &graph.nodes[index];
        let (Some(record), Some(path)) = (&self.slots[index].record, &node.sink_path) else { return };
        let store = &self.engine.store;
        let value = self.slots[index].values.first().and_then(Option::as_ref);
        let placed = sink::place(store, &self.options.out, path, &record.files, value);
        match placed {
            Ok(None) => return self.request(Wire { node: index, port: 0 }, Waiter::Files(index), scope),
            Ok(Some(files)) => {
                for (path, written) in files {
                    (self.tell)(Event::File { id: node.id.clone(), path, written });
                }
            }
            Err(error) => self.report(index, &error),
        }
        let slot = &mut self.slots[index];
        slot.readers = slot.readers.saturating_sub(1);
        self.drop_unread(index);
    }

    /// The node reads its inputs no more.
    fn release_inputs(&mut self, index: usize) {
        let above: BTreeSet<usize> =
            self.graph.nodes[index].inputs.iter().flatten().map(|w| w.node).collect();
        for node in above {
            let slot = &mut self.slots[node];
            slot.readers = slot.readers.saturating_sub(1);
            self.drop_unread(node);
        }
    }

    fn drop_unread(&mut self, index: usize) {
        let slot = &mut self.slots[index];
        if slot.readers > 0 || slot.storing || !slot.waiters.is_empty() || slot.remaking {
            return;
        }
        for (value, port) in slot.values.iter_mut().zip(&self.graph.nodes[index].kind.outputs) {
            if let Some(value) = value.take() {
                self.held -= (port.artifact.bytes)(&value) as u64;
            }
        }
    }

    fn report(&mut self, index: usize, error: &NodeError) {
        let node = &self.graph.nodes[index];
        let message = format!("`{}` failed: {error}", node.id);
        let mut diagnostic = Diagnostic::new(node.place(error.field), message);
        diagnostic.hints.extend(error.hint.clone());
        self.failures.push(diagnostic);
        self.totals.failed += 1;
        let slot = &self.slots[index];
        (self.tell)(Event::Node {
            id: node.id.clone(),
            kind: node.kind.name,
            state: State::Failed,
            key: slot.action.key.as_ref().map(|key| key.digest),
            seconds: 0.0,
            counts: Counts::new(),
            notes: Vec::new(),
            degraded: false,
            error: Some(error.to_string()),
        });
    }

    /// A node cannot give its outputs: everything below it is skipped, everything else goes on.
    fn fail(&mut self, index: usize, error: NodeError) {
        if error.is_cancelled() {
            return self.skip(index);
        }
        self.report(index, &error);
        let key = self.slots[index].action.key.as_ref().map(|key| key.digest);
        let followers = key.and_then(|key| self.in_flight.remove(&key)).unwrap_or_default();
        self.slots[index].life = Life::Failed;
        self.slots[index].remaking = false;
        self.release_inputs(index);
        let mut doomed: Vec<usize> = self.graph.consumers(index).to_vec();
        for follower in followers {
            self.slots[follower].life = Life::Failed;
            self.report(follower, &error);
            doomed.extend(self.graph.consumers(follower));
        }
        while let Some(node) = doomed.pop() {
            if !matches!(
                self.slots[node].life,
                Life::Waiting | Life::Gathering | Life::Queued | Life::Following
            ) {
                continue;
            }
            self.queue.remove(&(self.rank[node], node));
            self.skip(node);
            doomed.extend(self.graph.consumers(node));
        }
    }

    fn skip(&mut self, index: usize) {
        let node = &self.graph.nodes[index];
        self.slots[index].life = Life::Skipped;
        self.totals.skipped += 1;
        (self.tell)(Event::Node {
            id: node.id.clone(),
            kind: node.kind.name,
            state: State::Skipped,
            key: None,
            seconds: 0.0,
            counts: Counts::new(),
            notes: Vec::new(),
            degraded: false,
            error: None,
        });
        self.release_inputs(index);
    }

    fn finish(mut self) -> Outcome {
        let open = [Life::Waiting, Life::Gathering, Life::Queued, Life::Running, Life::Following];
        for index in 0..self.slots.len() {
            if open.contains(&self.slots[index].life) {
                self.skip(index);
            }
        }
        if let Err(error) = self.engine.store.flush() {
            let text = NodeError::from(error).to_string();
            (self.tell)(Event::Warning { id: "cache-write", text });
        }
        for incident in self.engine.store.take_incidents() {
            (self.tell)(Event::Warning { id: "cache-damage", text: incident.to_string() });
        }
        self.totals.stopped = self.stopped();
        self.totals.seconds = self.start.elapsed().as_secs_f64();
        (self.tell)(Event::Done(self.totals.clone()));
        let failures = (!self.failures.is_empty())
            .then(|| Diagnostics::new(self.graph.source.clone(), std::mem::take(&mut self.failures)));
        Outcome { totals: self.totals, failures }
    }
}

/// A size in the unit that a person would use.
pub(crate) fn size_text(bytes: u64) -> String {
    let gib = bytes as f64 / (1_u64 << 30) as f64;
    if gib >= 1.0 { format!("{gib:.1} GiB") } else { format!("{:.1} MiB", gib * 1024.0) }
}
