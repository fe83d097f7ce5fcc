//! Step counts of traversals, on request, since counting always would take a tenth of the time of rays.

use std::cell::Cell;

/// Step counts of traversals: the same for the same rays on any thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Steps {
    /// Number of nodes, each with up to eight boxes.
    pub nodes: u64,
    /// Number of packets of up to four triangles, tested at once.
    pub packets: u64,
}

thread_local! {
    /// Counts of this thread; `None` unless counting is on.
    static COUNTED: Cell<Option<Steps>> = const { Cell::new(None) };
}

impl Steps {
    /// The result of `work`, and the steps of its traversals, which must all run on this thread.
    pub fn of<R>(work: impl FnOnce() -> R) -> (R, Self) {
        let around = COUNTED.replace(Some(Self::default()));
        let done = work();
        (done, COUNTED.replace(around).unwrap_or_default())
    }

    /// True if traversals of this thread are counted.
    #[inline]
    pub(super) fn are_counted() -> bool {
        COUNTED.get().is_some()
    }

    /// Adds to the counts.
    pub(super) fn add(nodes: u64, packets: u64) {
        let more = |steps: Self| Self { nodes: steps.nodes + nodes, packets: steps.packets + packets };
        COUNTED.set(COUNTED.get().map(more));
    }
}

impl std::ops::AddAssign for Steps {
    fn add_assign(&mut self, other: Self) {
        self.nodes += other.nodes;
        self.packets += other.packets;
    }
}
