//! The events of a run, for progress bars, JSON output and tests.

use std::path::PathBuf;

use cache::Digest;
use serde::{Serialize, Serializer};

use crate::remote::workers::Stage;
use crate::text::diag::Mistake;
use crate::value::counts::Counts;
use crate::value::note::Note;

/// Outcome of a node or a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// The code ran.
    Ran,
    /// The result came from the cache.
    Cached,
    /// The code failed.
    Failed,
    /// The code did not run, since a node that this node depends on failed or the run was cancelled.
    Skipped,
}

/// An event of a run. Serialises to one JSON object per line.
#[derive(Debug, Clone, Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum Event {
    /// The code of a node starts.
    Start {
        /// Name of the node.
        id: String,
        /// Kind of the node.
        kind: &'static str,
        /// Forecast of the time in seconds that the code takes, from earlier runs of the kind; absent if there were
        /// none.
        #[serde(skip_serializing_if = "Option::is_none")]
        forecast: Option<f64>,
    },
    /// A new stage of a node that a worker computes.
    Stage {
        /// Name of the node.
        id: String,
        /// The stage: `sending`, `queued` or `executing`.
        stage: &'static str,
        /// Name of the worker, if it is known.
        #[serde(skip_serializing_if = "String::is_empty")]
        worker: String,
    },
    /// Progress of a running node.
    Progress {
        /// Name of the node.
        id: String,
        /// Progress from 0 to 1.
        fraction: f32,
    },
    /// A part of a running node ended.
    Part {
        /// Name of the node.
        id: String,
        /// Name of the part.
        part: String,
        /// State in which the part ended: `Ran` or `Cached`.
        state: State,
        /// Key of the part.
        #[serde(serialize_with = "hex")]
        key: Digest,
        /// Wall time in seconds.
        seconds: f64,
    },
    /// A period during which a thread worked for a node. Sent only if [`crate::RunOptions::trace`] is set.
    Span {
        /// Name of the node.
        id: String,
        /// Kind of work: `code`, `sources`, `load`, `store`, `files`, or the name of a part.
        what: String,
        /// Number of the thread within the run.
        thread: usize,
        /// Start in seconds since the start of the run.
        start: f64,
        /// Duration in seconds.
        seconds: f64,
    },
    /// The code of a node runs again, since a reader needs a value that was not stored or is damaged.
    Remake {
        /// Name of the node.
        id: String,
        /// Reason for the rerun.
        reason: String,
    },
    /// A node ended.
    Node {
        /// Name of the node.
        id: String,
        /// Kind of the node.
        kind: &'static str,
        /// State in which the node ended.
        state: State,
        /// Key of the node; absent if a node that it depends on failed.
        #[serde(serialize_with = "hex_option")]
        key: Option<Digest>,
        /// Wall time of the node's code in seconds.
        seconds: f64,
        /// CPU time of the node's code in seconds, on all threads.
        cpu_seconds: f64,
        /// Counts of the work that the node did in this run.
        counts: Counts,
        /// Notes of the node, whether it ran or was cached.
        notes: Vec<Note>,
        /// True if the result of this node, or of an upstream node, is worse than what the graph asks for.
        degraded: bool,
        /// The error, if the node failed.
        #[serde(skip_serializing_if = "Option::is_none")]
        error: Option<String>,
    },
    /// A file of a sink is up to date.
    File {
        /// Name of the sink.
        id: String,
        /// Path of the file.
        path: PathBuf,
        /// True if the file was written, false if an equal file existed already.
        written: bool,
        /// True if the file shows a preview, which a later run replaces.
        #[serde(skip_serializing_if = "std::ops::Not::not")]
        preview: bool,
    },
    /// A warning of the engine, such as a damaged cache entry that was recomputed.
    Warning {
        /// Stable name in kebab-case.
        id: &'static str,
        /// Text in one line.
        text: String,
    },
    /// The run ended.
    Done(Totals),
    /// Watching: the graph was saved, but its meaning is unchanged.
    Same,
    /// Watching: the plan of the run that starts.
    Plan(Forecast),
    /// Watching: a preview run starts.
    Pass {
        /// The parameter that the preview limits.
        parameter: String,
        /// Maximum value of the parameter in this preview.
        level: u64,
        /// The value of the parameter in the graph.
        of: u64,
        /// Side length, in pixels, of the blocks in which only one pixel is computed; 1 if all pixels are computed.
        coarse: u64,
    },
    /// The graph has mistakes, or nodes failed.
    Mistakes {
        /// The mistakes with their positions; empty if the graph file cannot be read.
        list: Vec<Mistake>,
        /// The mistakes as formatted text.
        #[serde(skip_serializing_if = "String::is_empty")]
        text: String,
    },
    /// Watching: a file still shows an earlier version of the graph.
    Stale {
        /// Path of the file.
        path: PathBuf,
    },
    /// Watching: everything is up to date; waiting for a file to change.
    Idle {
        /// Number of watched files.
        files: usize,
    },
}

impl Event {
    /// The event of a new stage of the node `id`.
    pub(crate) fn stage(id: &str, stage: Stage) -> Self {
        let (stage, worker) = match stage {
            Stage::Sending => ("sending", String::new()),
            Stage::Queued => ("queued", String::new()),
            Stage::Executing(worker) => ("executing", worker),
        };
        Self::Stage { id: id.to_owned(), stage, worker }
    }
}

/// Totals of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Totals {
    /// Number of nodes whose code ran.
    pub ran: usize,
    /// Number of nodes whose result came from the cache.
    pub cached: usize,
    /// Number of nodes whose result was cached but whose code ran again, since a reader needed values that were
    /// damaged or had not been stored.
    pub remade: usize,
    /// Number of nodes whose code failed.
    pub failed: usize,
    /// Number of nodes that were skipped.
    pub skipped: usize,
    /// Number of nodes whose result is degraded.
    pub degraded: usize,
    /// True if the run was cancelled.
    pub stopped: bool,
    /// Wall time in seconds.
    pub seconds: f64,
    /// CPU time of this process during the run in seconds, including the storing of results.
    pub cpu_seconds: f64,
    /// Peak memory of values in bytes, as estimated by their types.
    pub peak_bytes: u64,
    /// Counts of work, summed over all nodes that ran.
    pub counts: Counts,
}

impl Totals {
    pub(crate) fn add(&mut self, state: State) {
        *self.of(state) += 1;
    }

    pub(crate) fn take_back(&mut self, state: State) {
        *self.of(state) -= 1;
    }

    fn of(&mut self, state: State) -> &mut usize {
        match state {
            State::Ran => &mut self.ran,
            State::Cached => &mut self.cached,
            State::Failed => &mut self.failed,
            State::Skipped => &mut self.skipped,
        }
    }

    /// Exit code of a run: 0 success, 1 a node failed, 3 degraded, 130 cancelled.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self { stopped: true, .. } => 130,
            Self { failed: 1.., .. } => 1,
            Self { degraded: 1.., .. } => 3,
            _ => 0,
        }
    }
}

fn hex<S: Serializer>(digest: &Digest, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(digest)
}

fn hex_option<S: Serializer>(digest: &Option<Digest>, to: S) -> Result<S::Ok, S::Error> {
    match digest {
        Some(digest) => to.collect_str(digest),
        None => to.serialize_none(),
    }
}

/// Summary of a plan.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Forecast {
    /// Number of nodes that may run. Fewer may actually run, since a node does not run if its inputs, after they
    /// were recomputed, equal the inputs of its last run.
    pub open: usize,
    /// Number of nodes that the targets need.
    pub wanted: usize,
    /// Forecast of the total time in seconds of the nodes that may run. Nodes without a forecast are not included.
    pub seconds: f64,
    /// Number of nodes that may run and have no forecast.
    pub untimed: usize,
}
