//! What walks through trees take, counted where it is asked for: always counting would cost a tenth of the rays.

use std::cell::Cell;

/// Steps of walks: the same for the same rays, whoever runs them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Steps {
    /// Nodes, each of up to eight boxes.
    pub nodes: u64,
    /// Packets of up to four triangles, tested at once.
    pub packets: u64,
}

thread_local! {
    /// Of the walks of this thread, while they are counted.
    static COUNTED: Cell<Option<Steps>> = const { Cell::new(None) };
}

impl Steps {
    /// What `work` gives and what its walks took, all of which run on this thread.
    pub fn of<R>(work: impl FnOnce() -> R) -> (R, Self) {
        let around = COUNTED.replace(Some(Self::default()));
        let done = work();
        (done, COUNTED.replace(around).unwrap_or_default())
    }

    /// Whether walks of this thread are counted now.
    #[inline]
    pub(super) fn are_counted() -> bool {
        COUNTED.get().is_some()
    }

    /// Adds to what is counted.
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
