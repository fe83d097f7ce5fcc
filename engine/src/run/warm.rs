//! State that a process keeps from one run of a graph to the next (`watch`).

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::run::previous::PreviousRun;
use crate::run::value_cache::ValueCache;

/// The most recently used values, and the end state of the last run, so that the next run inspects only the nodes
/// that changed.
pub(crate) struct Warm {
    pub values: ValueCache,
    previous: Mutex<Option<PreviousRun>>,
}

impl Warm {
    /// An empty state with space for this many bytes of values.
    pub fn new(bytes: u64) -> Self {
        Self { values: ValueCache::new(bytes), previous: Mutex::new(None) }
    }

    /// The end state of the last run.
    pub fn previous(&self) -> MutexGuard<'_, Option<PreviousRun>> {
        self.previous.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
