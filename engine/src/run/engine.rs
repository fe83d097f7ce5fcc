//! [`Engine`]: the threads, memory and store shared by runs.

use std::num::NonZero;
use std::sync::{Arc, OnceLock};

use cache::Store;

use crate::kind::tiles::Threads;
use crate::remote::shared::SharedResults;
use crate::remote::workers::Workers;
use crate::run::value_cache::{ValueCache, default_memory};
use crate::run::warm::Warm;

/// The threads, memory and store shared by runs.
pub struct Engine {
    pub(crate) store: Arc<Store>,
    jobs: usize,
    memory: u64,
    limits: OnceLock<Limits>,
    threads: OnceLock<Arc<Threads>>,
    prepared: OnceLock<Arc<ValueCache>>,
    /// State kept from one run to the next; see [`keeping`](Self::keeping).
    pub(crate) warm: Option<Warm>,
    /// Results on another machine; see [`sharing`](Self::sharing).
    pub(crate) shared: Option<Arc<dyn SharedResults>>,
    /// Machines that compute nodes; see [`sending`](Self::sending).
    pub(crate) workers: Option<Arc<dyn Workers>>,
}

/// Limits that apply to all runs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Number of threads.
    pub jobs: usize,
    /// Memory budget in bytes, for values in memory and the estimated needs of running code.
    pub memory: u64,
}

impl Engine {
    /// An engine with `jobs` threads (one per core if 0) and a memory budget of about `memory` bytes for values
    /// (three quarters of the free memory if 0). Threads start, and cores and memory are inspected, when a run
    /// first needs them.
    pub fn new(store: Store, jobs: usize, memory: u64) -> Self {
        let (limits, threads) = (OnceLock::new(), OnceLock::new());
        let (store, prepared) = (Arc::new(store), OnceLock::new());
        Self { store, jobs, memory, limits, threads, prepared, warm: None, shared: None, workers: None }
    }

    /// Makes runs look for results that are not in the store in `shared`, and offer new results to it. A plan does
    /// not use it.
    pub fn sharing(self, shared: Arc<dyn SharedResults>) -> Self {
        Self { shared: Some(shared), ..self }
    }

    /// Makes runs have nodes computed by `workers`. The results stay where they are computed, so the engine must also
    /// [share](Self::sharing) results, and the shared results must be able to fetch those of the workers.
    pub fn sending(self, workers: Arc<dyn Workers>) -> Self {
        Self { workers: Some(workers), ..self }
    }

    /// Returns the limits, which are determined on the first call.
    pub(crate) fn limits(&self) -> Limits {
        *self.limits.get_or_init(|| {
            let cores = || std::thread::available_parallelism().map_or(1, NonZero::get);
            Limits {
                jobs: if self.jobs > 0 { self.jobs } else { cores() },
                memory: if self.memory > 0 { self.memory } else { default_memory() },
            }
        })
    }

    /// Cache of the values that nodes keep in memory for other nodes. Its limit is a sixth of the memory budget, in
    /// addition to that budget. For a budget of 8 GiB this is enough for the tree of a mesh of five million
    /// triangles.
    pub(crate) fn prepared(&self) -> &Arc<ValueCache> {
        self.prepared.get_or_init(|| Arc::new(ValueCache::new(self.limits().memory / 6)))
    }

    /// The threads that compute.
    pub(crate) fn threads(&self) -> &Arc<Threads> {
        self.threads.get_or_init(|| Arc::new(Threads::new(self.limits().jobs)))
    }

    /// Makes the engine keep values and the end state of each run for the next run. The values take up to a third
    /// of the memory budget. For processes that run a graph repeatedly: the next run inspects only nodes that
    /// changed and the nodes downstream of them, and reports only these nodes and the files of sinks.
    pub fn keeping(self) -> Self {
        let Limits { jobs, memory } = self.limits();
        let limits = OnceLock::from(Limits { jobs, memory: memory / 3 * 2 });
        Self { warm: Some(Warm::new(memory / 3)), limits, ..self }
    }

    /// The store of this engine, for use by several threads.
    pub fn shared_store(&self) -> Arc<Store> {
        self.store.clone()
    }

    /// The store of this engine.
    pub fn store(&self) -> &Store {
        &self.store
    }
}
