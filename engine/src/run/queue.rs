//! The queue of nodes whose code is to run.
//!
//! A node is *ready* until its turn comes. It is then *supplied*: its input values are loaded, and it waits for a
//! thread. Finally it *runs*. Nodes proceed in topological order, as many at once as there are threads. In
//! addition, one *short* node (with a forecast below a second) may be supplied and one may run, so that a small
//! node never waits for large nodes to end.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use cache::Digest;

use crate::run::slot::{Life, Slot};

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
    /// Maximum number of running nodes. One short node may run in addition.
    jobs: usize,
    /// Position of each node in topological order.
    rank: Vec<usize>,
    ready: Line,
    /// Nodes that wait for a thread, including nodes that run again because their values are needed.
    queued: Line,
    parked: Vec<Parked>,
    /// Number of nodes that are [`Life::Gathering`] or [`Life::Queued`], except nodes that run again because their
    /// values are needed.
    supplied: Count,
    running: Count,
}

/// Nodes at the same stage, in topological order, and the subset of short nodes.
#[derive(Default)]
struct Line {
    all: BTreeSet<(usize, usize)>,
    short: BTreeSet<(usize, usize)>,
}

/// A number of nodes, and the number of short nodes among them.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
struct Count {
    all: usize,
    short: usize,
}

impl Line {
    fn insert(&mut self, place: (usize, usize), short: bool) {
        self.all.insert(place);
        if short {
            self.short.insert(place);
        }
    }

    fn remove(&mut self, place: (usize, usize)) {
        self.all.remove(&place);
        self.short.remove(&place);
    }

    /// The next node that may go to the following stage. `count` is the number of nodes at that stage, which may
    /// hold up to `jobs` nodes and one additional short node. `None` if the line is empty or the stage has no room.
    fn next(&self, count: Count, jobs: usize) -> Option<usize> {
        let line = match count {
            Count { all, .. } if all < jobs => &self.all,
            Count { short: 0, .. } => &self.short,
            _ => return None,
        };
        line.first().map(|(_, index)| *index)
    }
}

impl Count {
    fn add(&mut self, slot: &Slot) {
        self.all += 1;
        self.short += usize::from(slot.short);
    }

    fn subtract(&mut self, slot: &Slot) {
        self.all -= 1;
        self.short -= usize::from(slot.short);
    }
}

impl Queue {
    /// An empty queue. `rank` is the topological position of each node.
    pub fn new(jobs: usize, rank: Vec<usize>) -> Self {
        let (ready, queued) = (Line::default(), Line::default());
        let (supplied, running) = (Count::default(), Count::default());
        Self { jobs, rank, ready, queued, parked: Vec::new(), supplied, running }
    }

    /// True if no node runs.
    pub fn nothing_runs(&self) -> bool {
        self.running.all == 0
    }

    /// True if no node runs or is supplied.
    pub fn is_idle(&self) -> bool {
        self.nothing_runs() && self.supplied.all == 0
    }

    /// True if no node waits for a thread or for another process.
    pub fn nothing_waits(&self) -> bool {
        self.queued.all.is_empty() && self.parked.is_empty()
    }

    /// True if a node waits for another process.
    pub fn has_parked(&self) -> bool {
        !self.parked.is_empty()
    }

    fn place(&self, index: usize) -> (usize, usize) {
        (self.rank[index], index)
    }

    /// Adds a node whose result is not in the store.
    pub fn make_ready(&mut self, index: usize, slot: &mut Slot) {
        slot.life = Life::Ready;
        self.ready.insert(self.place(index), slot.short);
    }

    /// The next ready node, if one may be supplied.
    pub fn next_ready(&self) -> Option<usize> {
        self.ready.next(self.supplied, self.jobs)
    }

    /// Marks a ready node as supplied.
    pub fn supply(&mut self, index: usize, slot: &mut Slot) {
        self.ready.remove(self.place(index));
        slot.life = Life::Gathering;
        self.supplied.add(slot);
    }

    /// Adds a node whose input values are in memory.
    pub fn enqueue(&mut self, index: usize, slot: &mut Slot) {
        slot.life = Life::Queued;
        self.queued.insert(self.place(index), slot.short);
    }

    /// The next queued node, if one may start.
    pub fn next_queued(&self) -> Option<usize> {
        self.queued.next(self.running, self.jobs)
    }

    /// Marks a queued node as running.
    pub fn start(&mut self, index: usize, slot: &mut Slot) {
        self.queued.remove(self.place(index));
        if slot.remaking.is_none() {
            self.supplied.subtract(slot);
        }
        slot.life = Life::Running;
        self.running.add(slot);
    }

    /// Removes a node whose code ended.
    pub fn end(&mut self, slot: &Slot) {
        self.running.subtract(slot);
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
            self.supplied.add(slot);
        }
        self.enqueue(index, slot);
    }

    /// Removes a node that will not run.
    pub fn leave(&mut self, index: usize, slot: &Slot) {
        let counted = slot.remaking.is_none();
        match slot.life {
            Life::Ready => self.ready.remove(self.place(index)),
            Life::Gathering if counted => self.supplied.subtract(slot),
            Life::Queued => {
                self.queued.remove(self.place(index));
                if counted {
                    self.supplied.subtract(slot);
                }
            }
            Life::Parked => self.parked.retain(|parked| parked.node != index),
            _ => {}
        }
    }

    /// Checks, in debug builds only, that the queue agrees with the slots.
    pub fn check(&self, slots: &[Slot]) {
        let lives = |life: Life| slots.iter().enumerate().filter(move |(_, slot)| slot.life == life);
        let places =
            |life: Life| -> BTreeSet<_> { lives(life).map(|(index, _)| self.place(index)).collect() };
        let count = |lives: &[Life], remakes: bool| {
            let mut count = Count::default();
            let of_lives = slots.iter().filter(|slot| lives.contains(&slot.life));
            of_lives.filter(|slot| remakes || slot.remaking.is_none()).for_each(|slot| count.add(slot));
            count
        };
        assert_eq!(self.ready.all, places(Life::Ready), "ready nodes");
        assert_eq!(self.queued.all, places(Life::Queued), "queued nodes");
        let is_short = |place: &&(usize, usize)| slots[place.1].short;
        for line in [&self.ready, &self.queued] {
            assert!(
                line.all.iter().filter(is_short).eq(line.short.iter()),
                "the subset of short nodes must match the slots"
            );
        }
        let parked: BTreeSet<_> = self.parked.iter().map(|parked| self.place(parked.node)).collect();
        assert_eq!(parked, places(Life::Parked), "parked nodes");
        assert_eq!(self.supplied, count(&[Life::Gathering, Life::Queued], false), "supplied nodes");
        assert_eq!(self.running, count(&[Life::Running], true), "running nodes");
    }
}
