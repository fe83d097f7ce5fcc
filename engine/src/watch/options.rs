//! Options of a watch, and the graphs that it runs.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::graph::graph::Graph;
use crate::text::diag::{Diagnostics, Mistake};

/// A snapshot of the watched graph: the result of reading it once.
pub struct Load {
    /// The graph and the indices of its targets, or its mistakes. An empty list of targets stands for the default
    /// targets.
    pub graph: Result<(Arc<Graph>, Vec<usize>), Refusal>,
    /// The files of the graph itself, whether they exist or not.
    pub texts: Vec<PathBuf>,
}

/// Reason why a graph cannot run.
#[derive(Debug, Clone, PartialEq)]
pub struct Refusal {
    /// The mistakes with their positions.
    pub list: Vec<Mistake>,
    /// The mistakes as formatted text.
    pub text: String,
    /// Files that the graph names. A change to one of them may resolve the mistakes.
    pub files: Vec<PathBuf>,
}

impl Refusal {
    /// The refusal of a graph with these mistakes. If `colour` is true, the text contains colour codes for
    /// terminals.
    pub fn mistakes(diagnostics: &Diagnostics, colour: bool) -> Self {
        let (list, files) = (diagnostics.mistakes(), diagnostics.files.clone());
        Self { list, text: diagnostics.render(colour), files }
    }

    /// A refusal for any other reason, such as a file that cannot be read.
    pub fn other(text: String) -> Self {
        Self { list: Vec::new(), text, files: Vec::new() }
    }
}

/// Options of a watch.
#[derive(Debug, Clone)]
pub struct WatchOptions {
    /// Folder for the output files of sinks.
    pub out: PathBuf,
    /// The parameter that previews limit.
    pub refine: Option<&'static str>,
    /// True to inspect the files every half second instead of using notifications.
    pub poll: bool,
    /// Time that must pass without further changes before a change is handled.
    pub settle: Duration,
    /// Time to wait before mistakes are reported, since a file of the graph may be only partly written.
    pub patience: Duration,
}

impl Default for WatchOptions {
    fn default() -> Self {
        Self {
            out: PathBuf::from("out"),
            refine: Some("samples"),
            poll: false,
            settle: Duration::from_millis(25),
            patience: Duration::from_millis(200),
        }
    }
}
