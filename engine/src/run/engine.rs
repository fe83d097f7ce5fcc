//! [`Engine`]: the threads, the memory and the store that runs of graphs share.

use std::num::NonZero;
use std::sync::{Arc, OnceLock};

use cache::Store;

use crate::kind::tiles::Threads;
use crate::run::value_cache::{ValueCache, default_memory};
use crate::run::warm::Warm;

/// The threads, the memory and the store that runs share.
pub struct Engine {
    pub(crate) store: Arc<Store>,
    jobs: usize,
    memory: u64,
    limits: OnceLock<Limits>,
    threads: OnceLock<Arc<Threads>>,
    prepared: OnceLock<Arc<ValueCache>>,
    /// What is kept from one run to the next, where [`keeping`](Self::keeping).
    pub(crate) warm: Option<Warm>,
}

/// What a run may take.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Threads.
    pub jobs: usize,
    /// Bytes of values and of what running code was admitted with.
    pub memory: u64,
}

impl Engine {
    /// An engine of `jobs` threads (0: one for each core) that keeps at most about `memory` bytes of values
    /// (0: three quarters of what is free). Threads are started, and the machine is asked, when a run first
    /// has something to do.
    pub fn new(store: Store, jobs: usize, memory: u64) -> Self {
        let (limits, threads) = (OnceLock::new(), OnceLock::new());
        Self { store: Arc::new(store), jobs, memory, limits, threads, prepared: OnceLock::new(), warm: None }
    }

    /// What runs may take.
    pub(crate) fn limits(&self) -> Limits {
        *self.limits.get_or_init(|| {
            let cores = || std::thread::available_parallelism().map_or(1, NonZero::get);
            Limits {
                jobs: if self.jobs > 0 { self.jobs } else { cores() },
                memory: if self.memory > 0 { self.memory } else { default_memory() },
            }
        })
    }

    /// What nodes keep in memory for others, in a twelfth beside what runs may take.
    pub(crate) fn prepared(&self) -> &Arc<ValueCache> {
        self.prepared.get_or_init(|| Arc::new(ValueCache::new(self.limits().memory / 12)))
    }

    /// How many threads may compute at once, and the helpers among them.
    pub(crate) fn threads(&self) -> &Arc<Threads> {
        self.threads.get_or_init(|| Arc::new(Threads::new(self.limits().jobs)))
    }

    /// Keeps values in memory from one run to the next, in a third of what it may take: for a process that
    /// runs a graph again and again. A part of them is what the running graph holds anyhow. How a run ended is kept,
    /// too: the next one looks at what is another one since then and at what follows from that, and tells of nothing
    /// else but the files of sinks.
    pub fn keeping(self) -> Self {
        let Limits { jobs, memory } = self.limits();
        let limits = OnceLock::from(Limits { jobs, memory: memory / 3 * 2 });
        Self { warm: Some(Warm::new(memory / 3)), limits, ..self }
    }

    /// The store of this engine.
    pub fn store(&self) -> &Store {
        &self.store
    }
}
