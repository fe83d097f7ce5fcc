//! The one stream of events that bars, pages, JSON and tests read.

use std::path::PathBuf;

use cache::Digest;
use serde::{Serialize, Serializer};

use crate::text::diag::Mistake;
use crate::value::counts::Counts;
use crate::value::note::Note;

/// How a node or a part ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Its code ran.
    Ran,
    /// Its result was known.
    Cached,
    /// Its code failed.
    Failed,
    /// Something it needs failed, or the run was stopped.
    Skipped,
}

/// Something that happened during a run. Serialises to one JSON object a line.
#[derive(Debug, Clone, Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum Event {
    /// A node's code begins to run.
    Start {
        /// Name of the node.
        id: String,
        /// Its kind.
        kind: &'static str,
        /// How long it will take, in seconds, by earlier runs of its kind; absent when there is none.
        #[serde(skip_serializing_if = "Option::is_none")]
        forecast: Option<f64>,
    },
    /// A running node has come so far.
    Progress {
        /// Name of the node.
        id: String,
        /// From 0 to 1.
        fraction: f32,
    },
    /// A part of a running node is done.
    Part {
        /// Name of the node.
        id: String,
        /// Name of the part.
        part: String,
        /// Whether it ran.
        state: State,
        /// Its key.
        #[serde(serialize_with = "hex")]
        key: Digest,
        /// Wall time.
        seconds: f64,
    },
    /// What one of the shared threads did for a node; told only where [`crate::RunOptions::trace`] asks for it.
    Span {
        /// Name of the node.
        id: String,
        /// `code`, `sources`, `load`, `store`, `files`, or the name of a part.
        what: String,
        /// Number of the thread.
        thread: usize,
        /// Seconds since the run began.
        start: f64,
        /// How long it took.
        seconds: f64,
    },
    /// A value that was not kept, or was damaged, is made once more because a reader needs it.
    Remake {
        /// Name of the node.
        id: String,
        /// Why it is made again.
        reason: String,
    },
    /// A node is done.
    Node {
        /// Name of the node.
        id: String,
        /// Its kind.
        kind: &'static str,
        /// How it ended.
        state: State,
        /// Its key, absent where something it needs failed.
        #[serde(serialize_with = "hex_option")]
        key: Option<Digest>,
        /// Wall time of its code.
        seconds: f64,
        /// CPU time of its code on all threads.
        cpu_seconds: f64,
        /// Work of this run.
        counts: Counts,
        /// What it has to say, the same whether it ran or was cached.
        notes: Vec<Note>,
        /// True when it, or something above it, is less than what was asked for.
        degraded: bool,
        /// What went wrong, for a node that failed.
        #[serde(skip_serializing_if = "Option::is_none")]
        error: Option<String>,
    },
    /// A file of a sink is in place.
    File {
        /// Name of the sink.
        id: String,
        /// Where it lies.
        path: PathBuf,
        /// False when an equal file was there already.
        written: bool,
        /// True when it shows less than the graph says, since a better one follows.
        #[serde(skip_serializing_if = "std::ops::Not::not")]
        preview: bool,
    },
    /// A remark of the engine itself, such as a damaged cache entry that was made again.
    Warning {
        /// Stable name in kebab-case.
        id: &'static str,
        /// One line for a person.
        text: String,
    },
    /// The run is over.
    Done(Totals),
    /// Watching: the graph was saved and says the same as before.
    Same,
    /// Watching: what is about to run.
    Plan(Forecast),
    /// Watching: a run begins that shows roughly what a later one shows well.
    Pass {
        /// The parameter that it caps.
        parameter: String,
        /// At how much.
        level: u64,
        /// What the graph says.
        of: u64,
        /// Side of the blocks of pixels of which one is computed; 1 where all are.
        coarse: u64,
    },
    /// The graph is wrong or nodes of it failed.
    Mistakes {
        /// Each with its place; empty where the graph file cannot even be read.
        list: Vec<Mistake>,
        /// All of it for a person.
        #[serde(skip_serializing_if = "String::is_empty")]
        text: String,
    },
    /// Watching: a file shows what the graph said before, and stays as it is for now.
    Stale {
        /// Where it lies.
        path: PathBuf,
    },
    /// Watching: nothing is to be done until a file changes.
    Idle {
        /// How many files are followed.
        files: usize,
    },
}

/// What a run came to.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Totals {
    /// Nodes whose code ran.
    pub ran: usize,
    /// Nodes whose result was known.
    pub cached: usize,
    /// Of them, those whose code ran all the same, since a reader needed values that were not kept or
    /// were damaged.
    pub remade: usize,
    /// Nodes whose code failed.
    pub failed: usize,
    /// Nodes that were not tried.
    pub skipped: usize,
    /// Nodes whose result is less than what was asked for.
    pub degraded: usize,
    /// True when the run was asked to stop.
    pub stopped: bool,
    /// Wall time of the run.
    pub seconds: f64,
    /// CPU time of this process in it: also that of storing what was made.
    pub cpu_seconds: f64,
    /// The most bytes of values that were in memory at once, as far as their types tell.
    pub peak_bytes: u64,
    /// Work of everything that ran.
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

    /// The exit code of a run: 0 good, 1 a node failed, 3 degraded, 130 stopped.
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

/// A plan in one line.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Forecast {
    /// Nodes that may run. Fewer do where a result comes out equal.
    pub open: usize,
    /// Nodes that are wanted.
    pub wanted: usize,
    /// What those that may run took the last time, together.
    pub seconds: f64,
    /// Of them, those that never ran.
    pub untimed: usize,
}
