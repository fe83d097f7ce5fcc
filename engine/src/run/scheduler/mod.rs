//! The scheduler: runs everything that is needed and not in the cache, on several threads and within a memory
//! budget.
//!
//! One thread schedules and the others compute. A node whose inputs are known by digest is *resolved*: its key is
//! looked up in the store. On a miss, its input values are loaded (see `supply`) and its code is queued. No
//! function recurses over the graph.

mod away;
mod begin;
mod end;
mod failure;
mod launch;
mod placing;
mod resolve;
mod sharing;
mod supply;

use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use crate::graph::graph::Graph;
use crate::graph::node::Wire;
use crate::run::away::Away;
use crate::run::claims::Claims;
use crate::run::engine::Engine;
use crate::run::event::{Event, Totals};
use crate::run::known::Known;
use crate::run::memory::Memory;
use crate::run::message::Message;
use crate::run::options::RunOptions;
use crate::run::queue::Queue;
use crate::run::slot::{Life, Slot};
use crate::run::trace::Tracer;
use crate::run::workers::{Work, Workers};
use crate::text::diag::Diagnostic;
use crate::value::error::NodeError;

/// Interval at which leases are renewed. This shows other processes that this process is still working.
const RENEW_EVERY: Duration = Duration::from_secs(1);

/// A pending step of the scheduler.
enum Task {
    Resolve(usize),
    Gather(usize),
    /// Loads an output of a node.
    Bring(Wire),
    Files(usize),
}

/// The threads that do a piece of work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pool {
    /// The code of a node.
    Code,
    /// Other work on this machine, such as loading a value.
    Other,
    /// Waiting for a worker that computes a node. These threads do not compute.
    Away,
}

/// Work for a node that has not been passed to a thread yet.
struct Unstarted<'a> {
    node: usize,
    pool: Pool,
    work: Work<'a>,
}

/// A run of a graph. Fields such as `queue` and `memory` maintain their own counters; the methods here and in the
/// submodules make the decisions.
pub(crate) struct Run<'a> {
    engine: &'a Engine,
    graph: &'a Graph,
    options: &'a RunOptions,
    sender: Sender<Message>,
    emit: &'a mut dyn FnMut(Event),
    slots: Vec<Slot>,
    todo: VecDeque<Task>,
    /// Work that has not been passed to a thread yet.
    unstarted: Vec<Unstarted<'a>>,
    /// The nodes whose code is to run.
    queue: Queue,
    /// The nodes that workers compute.
    away: Away,
    /// Memory taken by values and reserved for running code.
    memory: Memory,
    /// Keys of this run.
    known: Known,
    /// Buffer for making keys.
    scratch: Vec<u8>,
    /// The output files that sinks have claimed.
    claims: Claims,
    /// True if all nodes were inspected and no file has been written so far.
    unchanged: bool,
    /// Number of messages that threads still have to send.
    owed: usize,
    store_failed: bool,
    /// Indices of the nodes whose stored values were missing.
    gone: BTreeSet<usize>,
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
        if self.unstarted.is_empty() {
            return;
        }
        let jobs = self.engine.limits().jobs;
        let workers = Workers::new(self.engine.threads(), Queue::most(jobs) + jobs);
        let terms = self.engine.workers.as_deref().and_then(|workers| workers.terms());
        let away = Workers::new(self.engine.threads(), terms.map_or(1, |terms| terms.in_flight.max(1)));
        std::thread::scope(|scope| {
            let _closing = (workers.closing(), away.closing());
            self.coordinate(scope, &workers, &away, receiver);
        });
    }

    /// Marks a node as failed because no thread could be started for it.
    fn without_thread(&mut self, node: usize, pool: Pool, error: &std::io::Error) {
        let error =
            NodeError::new(format!("cannot start a thread: {error}")).hint("use fewer threads with `--jobs`");
        self.count_message(node);
        if pool == Pool::Away {
            self.away.end(node);
        }
        if pool == Pool::Code {
            self.end_running(node);
            self.slots[node].storing = false;
        }
        match self.slots[node].life {
            Life::Done => self.lose(node, Some(&error)),
            _ => self.fail_or_lose(node, &error),
        }
    }

    /// Performs all steps that need no thread.
    fn decide(&mut self) {
        while !self.stopped() {
            match self.todo.pop_front() {
                Some(Task::Resolve(node)) => self.resolve(node),
                Some(Task::Gather(node)) => self.gather(node),
                Some(Task::Bring(wire)) => self.bring(wire),
                Some(Task::Files(node)) => self.place_files(node),
                // All of these may add tasks.
                None => {
                    self.unpark();
                    self.dispatch();
                    self.supply();
                    self.launch();
                    if self.todo.is_empty() {
                        return;
                    }
                }
            }
        }
    }

    /// Passes work for a node to a thread, which sends a message at the end of the work.
    pub fn send(&mut self, node: usize, act: impl FnOnce() + Send + 'a) {
        self.send_to(Pool::Other, node, act);
    }

    /// Passes work for a node to a thread of a pool.
    fn send_to(&mut self, pool: Pool, node: usize, act: impl FnOnce() + Send + 'a) {
        self.owed += 1;
        self.slots[node].owed += 1;
        self.unstarted.push(Unstarted { node, pool, work: Box::new(act) });
    }

    /// Schedules until no work is left, or until the run is cancelled and the threads are idle.
    fn coordinate<'s>(
        &mut self,
        scope: &'s std::thread::Scope<'s, '_>,
        workers: &'s Workers<'a>,
        away: &'s Workers<'a>,
        receiver: &Receiver<Message>,
    ) {
        let mut renewed = Instant::now();
        loop {
            if renewed.elapsed() >= RENEW_EVERY {
                self.engine.store.renew_leases();
                renewed = Instant::now();
            }
            self.decide();
            for Unstarted { node, pool, work } in std::mem::take(&mut self.unstarted) {
                let threads = if pool == Pool::Away { away } else { workers };
                if let Err(error) = threads.hand(scope, pool == Pool::Code, work) {
                    self.without_thread(node, pool, &error);
                }
            }
            let idle = self.todo.is_empty() && self.queue.nothing_waits() && self.away.nothing_waits();
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

    /// Checks that all counters agree with the slots.
    fn check(&self) {
        self.queue.check(&self.slots);
        self.away.check(&self.slots);
        self.memory.check(self.graph, &self.slots);
        self.known.check(&self.slots);
        assert_eq!(self.owed, self.slots.iter().map(|slot| slot.owed).sum::<usize>(), "messages owed");
        let unstarted = self.unstarted.len();
        assert!(unstarted <= self.owed, "each piece of work that waits for a thread must owe a message");
    }

    /// Counts a message that a thread owed and has now sent.
    fn count_message(&mut self, node: usize) {
        self.owed -= 1;
        self.slots[node].owed -= 1;
    }

    fn receive(&mut self, message: Message) {
        self.act_on(message);
        self.remark();
        // For large graphs this would dominate the run.
        if cfg!(any(debug_assertions, feature = "checks")) && self.slots.len() < 1000 {
            self.check();
        }
    }

    fn act_on(&mut self, message: Message) {
        match message {
            Message::Event(event) => (self.emit)(event),
            Message::Sources { node, sources } => {
                self.count_message(node);
                match sources {
                    Ok(sources) => self.look_up(node, sources),
                    Err(error) => self.fail(node, &error),
                }
            }
            Message::Asked { node, found } => {
                self.count_message(node);
                self.asked(node, found);
            }
            Message::Worked { node, work } => {
                self.count_message(node);
                self.worked(node, work);
            }
            Message::Loaded { node, port, value } => {
                self.count_message(node);
                match value {
                    Ok(Some(value)) => self.arrive(node, port, value),
                    Ok(None) => self.missing(node, port),
                    Err(error) => self.lose(node, Some(&error)),
                }
            }
            Message::Busy { node, key, spent } => {
                self.count_message(node);
                self.end_running(node);
                self.slots[node].effort.add(&spent);
                self.park(node, key);
            }
            Message::Finished { node, outcome } => {
                self.end_running(node);
                match (outcome, self.slots[node].remaking) {
                    (Ok(finished), Some(_)) => self.remade(node, *finished),
                    (Ok(finished), None) => self.finished(node, *finished),
                    (Err(error), _) => self.fail_or_lose(node, &error),
                }
            }
            Message::Stored { node, error } => {
                self.count_message(node);
                self.slots[node].storing = false;
                if let Some(error) = error {
                    self.unstored(node, error);
                }
                self.memory.drop_unread(&mut self.slots[node]);
            }
            Message::Placed { node, placed } => {
                self.count_message(node);
                self.placed(node, placed);
            }
        }
    }

    fn end_running(&mut self, index: usize) {
        self.queue.end(index);
        self.memory.release(&mut self.slots[index]);
    }
}
