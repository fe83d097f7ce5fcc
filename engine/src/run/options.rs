//! Options and outcome of a run.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::run::event::Totals;
use crate::text::diag::Diagnostics;

/// Options of a run.
#[derive(Debug, Clone, Default)]
pub struct RunOptions {
    /// Output folder of sinks.
    pub out: PathBuf,
    /// The files of the graph itself, which no sink may overwrite.
    pub texts: Vec<PathBuf>,
    /// Indices of the target nodes. An empty list stands for [`Graph::targets`](crate::Graph::targets).
    pub only: Vec<usize>,
    /// Flag that the caller sets to cancel the run. The results of finished nodes are kept.
    pub cancel: Arc<AtomicBool>,
    /// Nodes that are reduced for a preview. The results of these nodes and of the nodes downstream of them are not
    /// recorded as results of the last run, and their files are marked as previews.
    pub rough: Vec<usize>,
    /// True to report the work of each thread as [`Event::Span`](crate::Event::Span)s.
    pub trace: bool,
}

/// Outcome of a run.
#[derive(Debug)]
pub struct Outcome {
    /// Counts of nodes and work.
    pub totals: Totals,
    /// Failures of nodes, with their positions in the graph file; `None` if no node failed.
    pub failures: Option<Diagnostics>,
}
