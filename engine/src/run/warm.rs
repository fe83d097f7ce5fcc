//! What a process that runs a graph again and again keeps in memory from one run to the next.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::run::previous::PreviousRun;
use crate::run::value_cache::ValueCache;

/// How the last run ended, so that the next one looks only at what changed since, and the values that it read last.
pub(crate) struct Warm {
    pub values: ValueCache,
    previous: Mutex<Option<PreviousRun>>,
}

impl Warm {
    /// Nothing yet, and at most this many bytes of values.
    pub fn new(bytes: u64) -> Self {
        Self { values: ValueCache::new(bytes), previous: Mutex::new(None) }
    }

    /// How the last run ended.
    pub fn previous(&self) -> MutexGuard<'_, Option<PreviousRun>> {
        self.previous.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
