//! The nodes of a run that workers compute.

use std::collections::BTreeSet;

use cache::Digest;

use crate::run::line::Position;
use crate::run::slot::{Life, Slot};

/// The nodes that wait for a worker, and the nodes in progress. A node is *listed* until its turn comes. Then its
/// inputs that the server does not have are *collected*, and it is *away* until its result or a refusal arrives.
#[derive(Default)]
pub(crate) struct Away {
    listed: BTreeSet<Position>,
    in_flight: BTreeSet<usize>,
    /// The keys of the results that were accepted in this run.
    accepted: Vec<Digest>,
    is_distrusted: bool,
}

impl Away {
    /// Adds a node that a worker is to compute.
    pub fn list(&mut self, place: Position, slot: &mut Slot) {
        slot.life = Life::Listed;
        self.listed.insert(place);
    }

    /// The listed node that comes first in topological order, if at most `most` nodes are in progress with it. It is
    /// removed from the list.
    pub fn next(&mut self, most: usize) -> Option<usize> {
        let (_, index) = (self.in_flight.len() < most).then(|| self.listed.pop_first()).flatten()?;
        self.in_flight.insert(index);
        Some(index)
    }

    /// True if no node is in progress.
    pub fn is_idle(&self) -> bool {
        self.in_flight.is_empty()
    }

    /// True if no node waits for a worker.
    pub fn nothing_waits(&self) -> bool {
        self.listed.is_empty()
    }

    /// Removes a node that is no longer in progress.
    pub fn end(&mut self, index: usize) {
        self.in_flight.remove(&index);
    }

    /// Removes and returns all listed nodes.
    pub fn take_listed(&mut self) -> Vec<usize> {
        std::mem::take(&mut self.listed).into_iter().map(|(_, index)| index).collect()
    }

    /// Removes a node that will not be computed. A node that is away stays in progress until its answer arrives.
    pub fn leave(&mut self, place: Position, slot: &Slot) {
        match slot.life {
            Life::Listed => {
                self.listed.remove(&place);
            }
            Life::Collecting => self.end(place.1),
            _ => {}
        }
    }

    /// Records that the result of a worker was accepted.
    pub fn accept(&mut self, key: Digest) {
        self.accepted.push(key);
    }

    /// Records that a result of the workers was wrong. Removes and returns the keys of all results that were accepted.
    pub fn distrust(&mut self) -> Vec<Digest> {
        self.is_distrusted = true;
        std::mem::take(&mut self.accepted)
    }

    /// True if a result of the workers was wrong, so that no further ones are accepted.
    pub fn is_distrusted(&self) -> bool {
        self.is_distrusted
    }

    /// Checks, in debug builds only, that the lists agree with the slots.
    pub fn check(&self, slots: &[Slot]) {
        let of = |life: Life| {
            let found = slots.iter().enumerate().filter(move |(_, slot)| slot.life == life);
            found.map(|(index, _)| index).collect::<BTreeSet<usize>>()
        };
        let listed: BTreeSet<usize> = self.listed.iter().map(|place| place.1).collect();
        assert_eq!(listed, of(Life::Listed), "nodes that wait for a worker");
        let busy: BTreeSet<usize> = of(Life::Collecting).union(&of(Life::Away)).copied().collect();
        assert!(busy.is_subset(&self.in_flight), "nodes in progress on workers");
    }
}
