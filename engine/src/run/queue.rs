//! The nodes whose code is to run, in the order in which they come, and how many of them are on their way.
//!
//! A node is *ready* until its turn comes, *supplied* while its input values come to memory and it waits for a thread,
//! then it *runs*. Nodes come in the order of the graph, as many at once as there may be threads. So that a small node
//! never waits for the end of large ones, one *short* node, by forecast, may be supplied and one may run besides.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use cache::Digest;

use crate::run::slot::{Life, Slot};

/// A node that waits for a key that another computes.
pub(crate) struct Parked {
    pub node: usize,
    pub key: Digest,
    /// Since when it waits, until that was reported.
    pub since: Option<Instant>,
    /// When to ask.
    pub when: Instant,
    pub pause: Duration,
}

/// See the [module](self).
pub(crate) struct Queue {
    /// As many nodes may run at once.
    jobs: usize,
    /// Position of each node in the order of the graph.
    rank: Vec<usize>,
    ready: Line,
    /// Nodes that wait for a thread, those among them that run again for their values.
    queued: Line,
    parked: Vec<Parked>,
    /// Nodes whose life is [`Life::Gathering`] or [`Life::Queued`], but for those that run again for their values.
    supplied: Count,
    running: Count,
}

/// Nodes by rank, the short ones among them once more.
#[derive(Default)]
struct Line {
    all: BTreeSet<(usize, usize)>,
    short: BTreeSet<(usize, usize)>,
}

/// A number of nodes, and how many of them are short.
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

    /// Whose turn it is where `count` nodes are past the line and `jobs` may be.
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
    /// `rank` has the position of each node in the order of the graph.
    pub fn new(jobs: usize, rank: Vec<usize>) -> Self {
        let (ready, queued) = (Line::default(), Line::default());
        let (supplied, running) = (Count::default(), Count::default());
        Self { jobs, rank, ready, queued, parked: Vec::new(), supplied, running }
    }

    /// Whether no node runs.
    pub fn nothing_runs(&self) -> bool {
        self.running.all == 0
    }

    /// Whether no node runs or is supplied.
    pub fn is_idle(&self) -> bool {
        self.nothing_runs() && self.supplied.all == 0
    }

    /// Whether no node waits for a thread or for another process.
    pub fn nothing_waits(&self) -> bool {
        self.queued.all.is_empty() && self.parked.is_empty()
    }

    /// Whether a node waits for another process.
    pub fn has_parked(&self) -> bool {
        !self.parked.is_empty()
    }

    fn place(&self, index: usize) -> (usize, usize) {
        (self.rank[index], index)
    }

    /// The result of a node is not known.
    pub fn make_ready(&mut self, index: usize, slot: &mut Slot) {
        slot.life = Life::Ready;
        self.ready.insert(self.place(index), slot.short);
    }

    /// The ready node whose turn it is.
    pub fn next_ready(&self) -> Option<usize> {
        self.ready.next(self.supplied, self.jobs)
    }

    /// The input values of a ready node come to memory.
    pub fn supply(&mut self, index: usize, slot: &mut Slot) {
        self.ready.remove(self.place(index));
        slot.life = Life::Gathering;
        self.supplied.add(slot);
    }

    /// The input values of a node are there.
    pub fn enqueue(&mut self, index: usize, slot: &mut Slot) {
        slot.life = Life::Queued;
        self.queued.insert(self.place(index), slot.short);
    }

    /// The queued node whose turn it is.
    pub fn next_queued(&self) -> Option<usize> {
        self.queued.next(self.running, self.jobs)
    }

    /// The code of a queued node runs.
    pub fn start(&mut self, index: usize, slot: &mut Slot) {
        self.queued.remove(self.place(index));
        if slot.remaking.is_none() {
            self.supplied.subtract(slot);
        }
        slot.life = Life::Running;
        self.running.add(slot);
    }

    /// The code of a node has ended.
    pub fn end(&mut self, slot: &Slot) {
        self.running.subtract(slot);
    }

    /// A node waits for a key that another computes.
    pub fn park(&mut self, parked: Parked, slot: &mut Slot) {
        slot.life = Life::Parked;
        self.parked.push(parked);
    }

    /// Takes out the parked nodes for which `is_free` holds.
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

    /// A node that was parked waits for a thread.
    pub fn unpark(&mut self, index: usize, slot: &mut Slot) {
        if slot.remaking.is_none() {
            self.supplied.add(slot);
        }
        self.enqueue(index, slot);
    }

    /// A node is not to run after all.
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

    /// Compares all of it with what the slots say; for debug builds.
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
            assert!(line.all.iter().filter(is_short).eq(line.short.iter()), "the short ones among them");
        }
        let parked: BTreeSet<_> = self.parked.iter().map(|parked| self.place(parked.node)).collect();
        assert_eq!(parked, places(Life::Parked), "parked nodes");
        assert_eq!(self.supplied, count(&[Life::Gathering, Life::Queued], false), "supplied nodes");
        assert_eq!(self.running, count(&[Life::Running], true), "running nodes");
    }
}
