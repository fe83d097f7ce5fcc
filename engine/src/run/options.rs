//! What a run is asked for and what it comes to.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::run::event::Totals;
use crate::text::diag::Diagnostics;

/// What a run is asked for beside the graph.
#[derive(Debug, Clone, Default)]
pub struct RunOptions {
    /// Folder that sinks write under.
    pub out: PathBuf,
    /// The files that the graph itself was read from, which no sink may write over.
    pub texts: Vec<PathBuf>,
    /// The nodes that are wanted; none stands for [`Graph::targets`](crate::Graph::targets).
    pub only: Vec<usize>,
    /// Set from outside to stop the run; what is finished by then is kept.
    pub cancel: Arc<AtomicBool>,
    /// Nodes that do less than the graph file says, in a run that a better one follows: they and what is
    /// made from them are not remembered as the last run, and files made from them are marked as previews.
    pub rough: Vec<usize>,
    /// Whether to tell what each thread does when, as [`Event::Span`](crate::Event::Span)s.
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
