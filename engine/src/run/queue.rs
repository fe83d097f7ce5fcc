//! The queue of nodes whose code is to run.
//!
//! A node is *ready* until its turn comes. It is then *supplied*: its input values are loaded, and it waits for a
//! thread. Finally it *runs*. Nodes proceed in topological order, as many at once as there are threads. In
//! addition, *small* nodes may be supplied and run, so that they never wait for large nodes to end: nodes with a
//! short forecast, nodes that are expected to take much less time than the nodes that run, and nodes without a
//! forecast (see [`TimeEstimate::may_join`]).

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use cache::Digest;

use crate::run::line::{Line, Position};
use crate::run::slot::{Life, Slot};
use crate::run::time_estimate::{Running, TimeEstimate};

/// A node that waits because the result of its key is being computed elsewhere.
pub(crate) struct Parked {
    pub node: usize,
    pub key: Digest,
    /// Start of the wait; `None` once the wait has been reported.
    pub since: Option<Instant>,
    /// Time of the next attempt to unpark the node.
    pub when: Instant,
    pub pause: Duration,
}

/// The nodes that are waiting for their turn, and the nodes that are running.
pub(crate) struct Queue {
    /// Number of nodes that may run at once, regardless of their expected time. Small nodes may run in addition;
    /// see [`Queue::most`].
    jobs: usize,
    /// Position of each node in topological order.
    rank: Vec<usize>,
    ready: Line,
    /// Nodes that wait for a thread, including nodes that run again because their values are needed.
    queued: Line,
    parked: Vec<Parked>,
    /// Nodes that are [`Life::Gathering`] or [`Life::Queued`], except nodes that run again because their values are
    /// needed.
    supplied: BTreeMap<usize, TimeEstimate>,
    running: BTreeMap<usize, Running>,
}

impl Queue {
    /// An empty queue. `rank` is the topological position of each node.
    pub fn new(jobs: usize, rank: Vec<usize>) -> Self {
        let (ready, queued) = (Line::default(), Line::default());
        let (supplied, running) = (BTreeMap::new(), BTreeMap::new());
        Self { jobs, rank, ready, queued, parked: Vec::new(), supplied, running }
    }

    /// Maximum number of nodes that run at once, including small nodes. The last place is reserved for a short
    /// node.
    pub fn most(jobs: usize) -> usize {
        2 * jobs + 2
    }

    /// True if no node runs.
    pub fn nothing_runs(&self) -> bool {
        self.running.is_empty()
    }

    /// True if no node runs or is supplied.
    pub fn is_idle(&self) -> bool {
        self.nothing_runs() && self.supplied.is_empty()
    }

    /// True if no node waits for a thread or for another process.
    pub fn nothing_waits(&self) -> bool {
        self.queued.is_empty() && self.parked.is_empty()
    }

    /// True if a node waits for another process.
    pub fn has_parked(&self) -> bool {
        !self.parked.is_empty()
    }

    /// The position of a node in topological order.
    pub fn place(&self, index: usize) -> Position {
        (self.rank[index], index)
    }

    /// True if a node may start at `now` although as many nodes run as there are threads.
    fn may_join(&self, time: &TimeEstimate, now: Instant) -> bool {
        let most = Self::most(self.jobs) - usize::from(!time.is_short());
        self.running.len() < most && time.may_join(self.running.values(), now)
    }

    /// Adds a node whose result is not in the store.
    pub fn make_ready(&mut self, index: usize, slot: &mut Slot) {
        slot.life = Life::Ready;
        self.ready.insert(self.place(index), &slot.time);
    }

    /// The ready node to supply next; `None` if no node may be supplied at `now`. If fewer nodes are supplied than
    /// there are threads, this is the first ready node. Otherwise it is the first short node, unless a short node
    /// is already supplied; otherwise a small node that may start at once, unless such a node is already supplied.
    pub fn next_ready(&self, slots: &[Slot], now: Instant) -> Option<usize> {
        let supplied = || self.supplied.values();
        if supplied().len() < self.jobs {
            return self.ready.first();
        }
        let has_room = supplied().len() < Self::most(self.jobs);
        let starts_next = || supplied().any(|time| !time.is_short() && self.may_join(time, now));
        let short = self.ready.first_short().filter(|_| supplied().all(|time| !time.is_short()));
        short.or_else(|| {
            let may = |index: usize| {
                let time = &slots[index].time;
                !time.is_short() && self.may_join(time, now)
            };
            (has_room && !starts_next()).then(|| self.ready.first_small(may)).flatten()
        })
    }

    /// Marks a ready node as supplied.
    pub fn supply(&mut self, index: usize, slot: &mut Slot) {
        self.ready.remove(self.place(index), &slot.time);
        slot.life = Life::Gathering;
        self.supplied.insert(index, slot.time);
    }

    /// Adds a node whose input values are in memory.
    pub fn enqueue(&mut self, index: usize, slot: &mut Slot) {
        slot.life = Life::Queued;
        self.queued.insert(self.place(index), &slot.time);
    }

    /// The queued node to start next; `None` if no node may start at `now`. If fewer nodes run than there are
    /// threads, this is the first queued node; otherwise it is a small node.
    pub fn next_queued(&self, slots: &[Slot], now: Instant) -> Option<usize> {
        if self.running.len() < self.jobs {
            return self.queued.first();
        }
        self.queued.first_small(|index| self.may_join(&slots[index].time, now))
    }

    /// The next short queued node, if it may start at `now`.
    pub fn next_short(&self, slots: &[Slot], now: Instant) -> Option<usize> {
        self.queued.first_short().filter(|&index| self.may_join(&slots[index].time, now))
    }

    /// Marks a queued node as running since `now`.
    pub fn start(&mut self, index: usize, slot: &mut Slot, now: Instant) {
        self.queued.remove(self.place(index), &slot.time);
        if slot.remaking.is_none() {
            self.supplied.remove(&index);
        }
        slot.life = Life::Running;
        self.running.insert(index, Running { time: slot.time, since: now });
    }

    /// Removes a node whose code ended.
    pub fn end(&mut self, index: usize) {
        self.running.remove(&index);
    }

    /// The nodes of a kind that have no forecast, in order of their indices.
    pub fn untimed(&self, kind: &str) -> BTreeSet<usize> {
        let is_of = |time: &TimeEstimate| time.seconds.is_none() && time.kind == kind;
        let supplied = self.supplied.iter().filter(|(_, time)| is_of(time)).map(|(index, _)| *index);
        let running = self.running.iter().filter(|(_, node)| is_of(&node.time)).map(|(index, _)| *index);
        self.ready.untimed(kind).chain(self.queued.untimed(kind)).chain(supplied).chain(running).collect()
    }

    /// Replaces the expected time of a node.
    pub fn set_time(&mut self, index: usize, slot: &mut Slot, time: TimeEstimate) {
        let place = self.place(index);
        for line in [&mut self.ready, &mut self.queued] {
            if line.remove(place, &slot.time) {
                line.insert(place, &time);
            }
        }
        slot.time = time;
        self.supplied.entry(index).and_modify(|known| *known = time);
        self.running.entry(index).and_modify(|running| running.time = time);
    }

    /// Adds a node that waits because the result of its key is being computed elsewhere.
    pub fn park(&mut self, parked: Parked, slot: &mut Slot) {
        slot.life = Life::Parked;
        self.parked.push(parked);
    }

    /// Removes and returns the parked nodes for which `is_free` is true.
    pub fn take_parked(&mut self, is_free: impl FnMut(&Parked) -> bool) -> Vec<usize> {
        let parked = std::mem::take(&mut self.parked).into_iter();
        let (free, rest): (Vec<_>, Vec<_>) = parked.partition(is_free);
        self.parked = rest;
        free.into_iter().map(|parked| parked.node).collect()
    }

    /// The parked nodes.
    pub fn parked(&mut self) -> &mut [Parked] {
        &mut self.parked
    }

    /// Queues a node that was parked.
    pub fn unpark(&mut self, index: usize, slot: &mut Slot) {
        if slot.remaking.is_none() {
            self.supplied.insert(index, slot.time);
        }
        self.enqueue(index, slot);
    }

    /// Removes a node that will not run.
    pub fn leave(&mut self, index: usize, slot: &Slot) {
        match slot.life {
            Life::Ready => {
                self.ready.remove(self.place(index), &slot.time);
            }
            Life::Gathering => {
                self.supplied.remove(&index);
            }
            Life::Queued => {
                self.queued.remove(self.place(index), &slot.time);
                self.supplied.remove(&index);
            }
            Life::Parked => self.parked.retain(|parked| parked.node != index),
            _ => {}
        }
    }

    /// Checks, in debug builds only, that the queue agrees with the slots.
    pub fn check(&self, slots: &[Slot]) {
        let of = |lives: &'static [Life]| {
            slots.iter().enumerate().filter(move |(_, slot)| lives.contains(&slot.life))
        };
        let places =
            |lives| -> BTreeSet<Position> { of(lives).map(|(index, _)| self.place(index)).collect() };
        self.ready.check(places(&[Life::Ready]), |index| slots[index].time);
        self.queued.check(places(&[Life::Queued]), |index| slots[index].time);
        let parked: BTreeSet<_> = self.parked.iter().map(|parked| self.place(parked.node)).collect();
        assert_eq!(parked, places(&[Life::Parked]), "parked nodes");
        let supplied = of(&[Life::Gathering, Life::Queued]).filter(|(_, slot)| slot.remaking.is_none());
        let supplied: BTreeMap<_, _> = supplied.map(|(index, slot)| (index, slot.time)).collect();
        assert_eq!(self.supplied, supplied, "supplied nodes");
        let running: BTreeMap<_, _> = of(&[Life::Running]).map(|(index, slot)| (index, slot.time)).collect();
        let known: BTreeMap<_, _> = self.running.iter().map(|(index, node)| (*index, node.time)).collect();
        assert_eq!(known, running, "running nodes");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    /// A queue for two threads with a clock, in which nodes are named by index.
    struct Bench {
        queue: Queue,
        slots: Vec<Slot>,
        now: Instant,
    }

    impl Bench {
        /// Nodes of the given kinds, work and forecasts in seconds, all of them ready.
        fn new(nodes: &[(&'static str, f64, Option<f64>)]) -> Self {
            let mut queue = Queue::new(2, (0..nodes.len()).collect());
            let mut slots = Vec::new();
            for (index, &(kind, work, seconds)) in nodes.iter().enumerate() {
                let mut slot = Slot::new(Life::Waiting, 0);
                slot.time = TimeEstimate { kind, work, seconds };
                queue.make_ready(index, &mut slot);
                slots.push(slot);
            }
            Self { queue, slots, now: Instant::now() }
        }

        /// Supplies and starts nodes as long as any may. Returns the nodes that started.
        fn start(&mut self) -> Vec<usize> {
            let mut started = Vec::new();
            loop {
                if let Some(index) = self.queue.next_ready(&self.slots, self.now) {
                    self.queue.supply(index, &mut self.slots[index]);
                    self.queue.enqueue(index, &mut self.slots[index]);
                } else if let Some(index) = self.queue.next_queued(&self.slots, self.now) {
                    self.queue.start(index, &mut self.slots[index], self.now);
                    started.push(index);
                } else {
                    self.queue.check(&self.slots);
                    return started;
                }
            }
        }

        fn end(&mut self, index: usize) {
            self.queue.end(index);
            self.slots[index].life = Life::Done;
        }
    }

    const TRACE: (&str, f64, Option<f64>) = ("trace", 100.0, None);
    const LONG: (&str, f64, Option<f64>) = ("trace", 100.0, Some(100.0));

    #[test]
    fn a_small_node_without_a_forecast_passes_large_ones() {
        let mut bench = Bench::new(&[TRACE, TRACE, TRACE, TRACE, ("score", 1.0, None), ("save", 1.0, None)]);
        assert_eq!(bench.start(), [0, 1]);
        bench.now += SECOND;
        assert_eq!(bench.start(), [4], "the kind of the traces is being tried already");
        bench.end(4);
        assert_eq!(bench.start(), [5], "as soon as the previous one has ended");
        bench.now += 100 * SECOND;
        assert_eq!(bench.start(), Vec::<usize>::new());
        bench.end(0);
        bench.end(5);
        assert_eq!(bench.start(), [2], "large nodes run in their order");
    }

    #[test]
    fn a_node_without_a_forecast_is_long_after_a_second() {
        let kinds = ["a", "b", "c", "d", "e", "f"].map(|kind| (kind, 1.0, None));
        let mut bench = Bench::new(&kinds);
        let mut started = Vec::new();
        for _ in 0..10 {
            started.push(bench.start().len());
            bench.now += SECOND;
        }
        assert_eq!(started, [2, 1, 1, 1, 0, 0, 0, 0, 0, 0], "at most five nodes that are not short");
        bench.end(0);
        assert_eq!(bench.start(), [5]);
    }

    #[test]
    fn a_node_that_is_much_shorter_passes_large_ones() {
        let mut bench = Bench::new(&[LONG, LONG, LONG, ("fuse", 1.0, Some(5.0)), ("fuse", 1.0, Some(4.0))]);
        assert_eq!(bench.start(), [0, 1, 4], "the shortest of them, and one at a time");
        bench.now += 4 * SECOND;
        bench.end(4);
        assert_eq!(bench.start(), [3]);
        bench.end(3);
        assert_eq!(bench.start(), Vec::<usize>::new());
    }

    #[test]
    fn a_short_node_passes_large_ones_and_nodes_on_trial() {
        let mut bench =
            Bench::new(&[LONG, LONG, ("a", 1.0, None), ("s", 1.0, Some(0.9)), ("s", 1.0, Some(0.5))]);
        assert_eq!(bench.start(), [0, 1, 3, 2]);
        bench.end(3);
        assert_eq!(bench.start(), [4]);
    }

    #[test]
    fn a_forecast_that_arrives_late_counts() {
        let mut bench = Bench::new(&[LONG, LONG, ("s", 9.0, None), ("s", 9.0, None), ("s", 9.0, None)]);
        assert_eq!(bench.start(), [0, 1, 2]);
        bench.end(2);
        assert_eq!(bench.queue.untimed("s"), [3, 4].into());
        for index in bench.queue.untimed("s") {
            let time = TimeEstimate { seconds: Some(50.0), ..bench.slots[index].time };
            bench.queue.set_time(index, &mut bench.slots[index], time);
        }
        assert_eq!(bench.start(), Vec::<usize>::new(), "they are long");
        bench.queue.set_time(
            4,
            &mut bench.slots[4],
            TimeEstimate { seconds: Some(0.1), ..TimeEstimate::default() },
        );
        assert_eq!(bench.start(), [4]);
    }
}
