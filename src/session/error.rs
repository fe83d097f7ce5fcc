//! Errors that end a command before it begins its work.

use std::fmt::Display;
use std::path::Path;

use engine::Diagnostics;

/// An error that ends a command before it begins its work. Exit code 2.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The graph file has mistakes, which are printed with their places.
    #[error("{0}")]
    Graph(Diagnostics),
    /// The command line, or a file that it names, cannot be used. The text states the problem and the remedy.
    #[error("{0}")]
    Usage(String),
    /// The cache cannot be used, or a file cannot be written. The text states the path and the error of the system.
    #[error("{0}")]
    Cache(String),
    /// Standard output cannot be written.
    #[error("cannot write: {0}")]
    Output(#[from] std::io::Error),
}

impl Error {
    /// An error about the command line. `text` states the problem and the remedy.
    pub fn usage(text: impl Into<String>) -> Self {
        Self::Usage(text.into())
    }

    /// The error for a file that cannot be read. `what` is its role, such as `overlay`.
    pub fn unreadable(what: &str, path: &Path, source: &std::io::Error) -> Self {
        Self::Usage(format!("cannot read the {what} `{}`: {source}", path.display()))
    }

    /// The error for a file that cannot be used, with the reason.
    pub fn of_file(path: &Path, source: &dyn Display) -> Self {
        Self::Usage(format!("`{}`: {source}", path.display()))
    }
}

impl From<engine::NodeError> for Error {
    fn from(error: engine::NodeError) -> Self {
        Self::Usage(error.to_string())
    }
}

impl From<engine::ActionError> for Error {
    fn from(error: engine::ActionError) -> Self {
        match error {
            engine::ActionError::Write(error) => error.into(),
            other => Self::Usage(other.to_string()),
        }
    }
}

#[cfg(feature = "remote")]
impl From<remote::TrustError> for Error {
    fn from(error: remote::TrustError) -> Self {
        match error {
            remote::TrustError::Write(error) => error.into(),
            other => Self::Usage(other.to_string()),
        }
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

impl From<benchmark::Error> for Error {
    fn from(error: benchmark::Error) -> Self {
        match error {
            benchmark::Error::Write(error) => error.into(),
            other => Self::Usage(other.to_string()),
        }
    }
}

impl From<cache::Error> for Error {
    fn from(error: cache::Error) -> Self {
        Self::Cache(causes(error))
    }
}

/// The text of an error with its causes: the operation, the path and the error of the system.
pub(super) fn causes(error: cache::Error) -> String {
    engine::NodeError::from(error).to_string()
}
