//! Step counts of traversals. They are optional, because counting takes a tenth of the time of tracing.

use std::cell::Cell;

/// Step counts of traversals. They depend only on the rays, not on the thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Steps {
    /// Number of nodes visited, each with up to eight boxes.
    pub nodes: u64,
    /// Number of packets tested, each with up to four triangles.
    pub packets: u64,
}

thread_local! {
    /// Counts of this thread. `None` if counting is off.
    static COUNTED: Cell<Option<Steps>> = const { Cell::new(None) };
}

impl Steps {
    /// Runs `work`, and returns its result and the steps of its traversals. All traversals must run on this thread.
    pub fn of<R>(work: impl FnOnce() -> R) -> (R, Self) {
        let around = COUNTED.replace(Some(Self::default()));
        let done = work();
        (done, COUNTED.replace(around).unwrap_or_default())
    }

    /// Runs `work` without counting the steps of its traversals, and returns its result.
    pub fn uncounted<R>(work: impl FnOnce() -> R) -> R {
        let around = COUNTED.replace(None);
        let done = work();
        COUNTED.set(around);
        done
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
