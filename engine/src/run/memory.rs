//! Memory accounting: the size of the values that may still be read, and the estimated needs of running code.

use crate::graph::graph::Graph;
use crate::run::slot::{Life, Slot};
use crate::value::artifact::AnyArtifact;

/// Memory counters of a run. The scheduler changes the readers and the state of slots itself, and calls the methods of
/// this type when values come and go. Tests (feature `checks`) and builds with debug assertions compare the counters
/// with the slots after each message.
pub(crate) struct Memory {
    limit: u64,
    held: u64,
    reserved: u64,
    peak: u64,
}

impl Memory {
    /// A budget of about `limit` bytes.
    pub fn new(limit: u64) -> Self {
        Self { limit, held: 0, reserved: 0, peak: 0 }
    }

    /// The budget in bytes.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// Peak memory of values so far, in bytes.
    pub fn peak(&self) -> u64 {
        self.peak
    }

    /// True if the budget is not exhausted.
    pub fn has_room(&self) -> bool {
        self.held.saturating_add(self.reserved) < self.limit
    }

    /// True if code that needs this many bytes fits into the budget.
    pub fn fits(&self, bytes: u64) -> bool {
        self.held.saturating_add(self.reserved).saturating_add(bytes) <= self.limit
    }

    /// Reserves memory for the code of a node.
    pub fn reserve(&mut self, slot: &mut Slot, bytes: u64) {
        self.reserved = self.reserved.saturating_add(bytes);
        slot.reserved = bytes;
    }

    /// Releases the memory that was reserved for the code of a node.
    pub fn release(&mut self, slot: &mut Slot) {
        self.reserved = self.reserved.saturating_sub(std::mem::take(&mut slot.reserved));
    }

    /// Keeps the value of an output of a node, unless it is present already.
    pub fn keep(&mut self, slot: &mut Slot, port: usize, value: AnyArtifact, bytes: u64) {
        if slot.keep(port, value, bytes) {
            self.held += bytes;
            self.peak = self.peak.max(self.held);
        }
    }

    /// Removes one reader of a node, and drops the node's values if it has no readers left.
    pub fn remove_reader(&mut self, slot: &mut Slot) {
        slot.readers -= 1;
        self.drop_unread(slot);
    }

    /// Drops the values of a node if no consumer needs them any more.
    pub fn drop_unread(&mut self, slot: &mut Slot) {
        if slot.is_unread() {
            self.held -= slot.drop_values();
        }
    }

    /// Checks, in debug builds only, that the counters agree with the slots.
    pub fn check(&self, graph: &Graph, slots: &[Slot]) {
        assert_eq!(
            self.held,
            slots.iter().map(Slot::bytes).sum::<u64>(),
            "the counted bytes of values must match the slots"
        );
        assert_eq!(self.reserved, slots.iter().map(|slot| slot.reserved).sum::<u64>(), "bytes reserved");
        for (index, slot) in slots.iter().enumerate() {
            let out_of_run = |life| matches!(life, Life::Unwanted | Life::Failed | Life::Skipped);
            let reads = |below: &usize| {
                let below = &slots[*below];
                let unsettled = below.record.is_none() && !out_of_run(below.life);
                usize::from(unsettled) + usize::from(below.remaking.is_some())
            };
            let below: usize = graph.consumers(index).iter().map(reads).sum();
            let ended = slot.life == Life::Done || out_of_run(slot.life) || slot.remaking == Some(Life::Done);
            let files = usize::from(graph.nodes[index].sink_path.is_some() && !ended);
            assert_eq!(slot.readers, below + files, "readers of `{}`", graph.nodes[index].id);
        }
    }
}
