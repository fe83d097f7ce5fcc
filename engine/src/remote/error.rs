//! Errors in actions.

use std::io;
use std::path::{Path, PathBuf};

use cache::Digest;

use crate::value::error::NodeError;
use crate::value::units::bytes_text;

/// An error while an action is written or run, or while its outputs are added to the store.
#[derive(Debug, thiserror::Error)]
pub enum ActionError {
    /// A file or folder cannot be read or written.
    #[error("cannot {what} `{}`: {source}", .path.display())]
    Io {
        /// The operation, such as `read`.
        what: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] cache::Error),
    /// The file is not an action file, or has the format of another version.
    #[error("`{}` is not an action of this version of lightharmony: {why}", .path.display())]
    Format {
        /// The action file.
        path: PathBuf,
        /// The reason.
        why: String,
    },
    /// This program does not have the kind of the action, or has another version of it.
    #[error("the action needs {wanted}, but this program has {found}")]
    Kind {
        /// The kind, version and profile of the action.
        wanted: String,
        /// The kind, version and profile of this program.
        found: String,
    },
    /// The node runs a program that is installed on this machine, so it is never computed elsewhere.
    #[error("`{kind}` runs a program that is installed on this machine, so it is not computed elsewhere")]
    Program {
        /// The kind.
        kind: String,
    },
    /// The action contradicts itself or its kind.
    #[error("the action is not valid: {0}")]
    Invalid(String),
    /// The content of a file does not match the digest that the action states.
    #[error("the content of `{}` does not match the digest {}", .path.display(), .digest.short())]
    Content {
        /// The file.
        path: PathBuf,
        /// The stated digest.
        digest: Digest,
    },
    /// The key that is computed from the action is not the key that the action states.
    #[error("the key of the content of the action is {}, but the action states the key {}", .found.short(), .stated.short())]
    Key {
        /// The key in the action.
        stated: Digest,
        /// The key that is computed from the action.
        found: Digest,
    },
    /// The node needs more memory than the budget allows.
    #[error("`{kind}` needs about {} of memory, but the budget is {}; raise `--memory`", bytes_text(*.needs), bytes_text(*.budget))]
    Memory {
        /// The kind of the node.
        kind: String,
        /// Estimated memory need in bytes, including the inputs.
        needs: u64,
        /// The budget in bytes.
        budget: u64,
    },
    /// The code of the node failed.
    #[error("`{kind}`: {error}")]
    Failed {
        /// The kind of the node.
        kind: String,
        /// The error of the code.
        error: NodeError,
    },
    /// The node cannot become an action, for example because one of its inputs is not known.
    #[error("`{node}` cannot become an action: {why}")]
    Unsuitable {
        /// The name of the node.
        node: String,
        /// The reason.
        why: String,
    },
    /// The folder does not contain valid outputs of the action.
    #[error("the outputs in `{}` cannot be used: {why}", .folder.display())]
    Outputs {
        /// The folder of the outputs.
        folder: PathBuf,
        /// The reason.
        why: String,
    },
}

impl ActionError {
    /// Returns a function that adds the operation and the path to an error of the operating system.
    pub(crate) fn io(what: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { what, path: path.to_owned(), source }
    }

    /// True if the code of the node failed, as opposed to a problem with the action or with files.
    pub fn is_of_node(&self) -> bool {
        matches!(self, Self::Failed { .. } | Self::Memory { .. })
    }

    /// True if the action was cancelled.
    pub fn is_cancelled(&self) -> bool {
        matches!(self, Self::Failed { error, .. } if error.is_cancelled())
    }
}
