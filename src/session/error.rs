//! Why a verb ends before it has begun its work.

use std::fmt::Display;
use std::path::Path;

use engine::Diagnostics;

/// Why a verb ends before it has begun its work. Exit code 2.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The graph file has mistakes, which are printed with their places.
    #[error("{0}")]
    Graph(Diagnostics),
    /// The command line, or a file that it names, is not usable. The text says what is wrong and what to write instead.
    #[error("{0}")]
    Usage(String),
    /// The cache, or a file to write, failed: the text has the path and the reason of the system.
    #[error("{0}")]
    Cache(String),
    /// Standard output cannot be written.
    #[error("cannot write: {0}")]
    Output(#[from] std::io::Error),
}

impl Error {
    /// A mistake of the user, with what to write instead.
    pub fn usage(text: impl Into<String>) -> Self {
        Self::Usage(text.into())
    }

    /// A file that cannot be read: `what` is its role, such as `overlay`.
    pub fn unreadable(what: &str, path: &Path, source: &std::io::Error) -> Self {
        Self::Usage(format!("cannot read the {what} `{}`: {source}", path.display()))
    }

    /// A file and why it cannot be used.
    pub fn of_file(path: &Path, source: &dyn Display) -> Self {
        Self::Usage(format!("`{}`: {source}", path.display()))
    }
}

impl From<engine::NodeError> for Error {
    fn from(error: engine::NodeError) -> Self {
        Self::Usage(error.to_string())
    }
}

impl From<ctrlc::Error> for Error {
    fn from(error: ctrlc::Error) -> Self {
        Self::Usage(match error {
            ctrlc::Error::System(cause) => format!(
                "cannot start the thread that listens for Ctrl-C: {cause}; the number of processes may be limited \
                 (`ulimit -u`)"
            ),
            other => format!("cannot listen for Ctrl-C: {other}"),
        })
    }
}

impl From<trade::Error> for Error {
    fn from(error: trade::Error) -> Self {
        match error {
            trade::Error::Graph(mistakes) => Self::Graph(mistakes),
            other => Self::Usage(other.to_string()),
        }
    }
}

impl From<cache::Error> for Error {
    fn from(error: cache::Error) -> Self {
        Self::Cache(causes(error))
    }
}

/// The chain of causes: what was tried on which path, and the reason of the system.
pub(super) fn causes(error: cache::Error) -> String {
    engine::NodeError::from(error).to_string()
}
