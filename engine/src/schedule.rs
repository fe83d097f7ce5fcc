//! [`Engine`]: the threads, the memory and the store that runs of graphs share.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;

use cache::Store;

use crate::action::{last_keys, last_outputs};
use crate::diag::Diagnostics;
use crate::event::{Event, Totals};
use crate::graph::{Graph, Wire};
use crate::memory::Memory;
use crate::run::Run;

/// The threads, the memory and the store that runs share.
pub struct Engine {
    pub(crate) store: Arc<Store>,
    pub(crate) pool: rayon::ThreadPool,
    pub(crate) jobs: usize,
    pub(crate) memory: u64,
    pub(crate) kept: Memory,
}

/// What a run is asked for beside the graph.
#[derive(Debug, Clone, Default)]
pub struct RunOptions {
    /// Folder that sinks write under.
    pub out: PathBuf,
    /// The nodes that are wanted; none stands for [`Graph::targets`].
    pub only: Vec<usize>,
    /// Set from outside to stop the run; what is finished by then is kept.
    pub cancel: Arc<AtomicBool>,
    /// Nodes that do less than the graph file says, in a run that a better one follows: they and what is
    /// made from them are not remembered as the last run, and files made from them are marked as previews.
    pub rough: Vec<usize>,
    /// Whether to tell what each thread does when, as [`Event::Span`]s.
    pub trace: bool,
}

/// How a run ended.
#[derive(Debug)]
pub struct Outcome {
    /// Counts of nodes and work.
    pub totals: Totals,
    /// What failed, with its place in the graph file.
    pub failures: Option<Diagnostics>,
}

/// Why an engine cannot be made.
#[derive(Debug, thiserror::Error)]
#[error("cannot start {jobs} threads: {source}")]
pub struct EngineError {
    jobs: usize,
    source: rayon::ThreadPoolBuildError,
}

impl Engine {
    /// An engine of `jobs` threads (at least 1) that keeps at most about `memory` bytes of values.
    pub fn new(store: Store, jobs: usize, memory: u64) -> Result<Self, EngineError> {
        let jobs = jobs.max(1);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(jobs)
            .thread_name(|index| format!("node-{index}"))
            .build()
            .map_err(|source| EngineError { jobs, source })?;
        Ok(Self { store: Arc::new(store), pool, jobs, memory, kept: Memory::new(0) })
    }

    /// Keeps values in memory from one run to the next, at most `bytes` of them: for a process that runs
    /// a graph again and again. A part of them is what the running graph holds anyhow.
    pub fn keeping(self, bytes: u64) -> Self {
        Self { kept: Memory::new(bytes), ..self }
    }

    /// The store of this engine.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Runs a graph. Every event is told on the calling thread, in order.
    pub fn run(&self, graph: &Graph, options: &RunOptions, mut tell: impl FnMut(Event)) -> Outcome {
        let cancelled = || options.cancel.load(Ordering::Relaxed);
        let _running = self.store.begin_run(&last_keys(graph), &cancelled);
        let (sender, receiver) = channel();
        let mut run = Run::new(self, graph, options, sender, &mut tell);
        self.pool.in_place_scope(|scope| run.coordinate(scope, &receiver));
        run.finish()
    }

    /// The value of an output, from the store; `None` when it is not stored. For tests and viewers.
    pub fn value<A: crate::Artifact>(&self, graph: &Graph, wire: Wire) -> Option<A> {
        let record = last_outputs(&self.store, graph, &graph.nodes[wire.node])?;
        let bytes = self.store.get_blob(&record.outputs.get(wire.port)?.digest).ok()??;
        crate::artifact::decode_all(&bytes).ok()
    }
}
