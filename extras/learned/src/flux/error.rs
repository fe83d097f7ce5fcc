//! Errors of the diffusion backend.

use std::path::{Path, PathBuf};

/// Errors of the diffusion backend. Messages name the file and, where possible, suggest a remedy.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file cannot be read, is damaged, or does not have the expected format.
    #[error("`{}`: {what}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// The problem and the remedy.
        what: String,
    },
    /// Sizes or options that do not match. The text describes the problem.
    #[error("{0}")]
    Mismatch(String),
    /// [`Watch::check`](super::Watch::check) requested to stop.
    #[error("stopped")]
    Stopped,
    /// The tensor library failed, for example because the GPU is out of memory.
    #[error("the tensor library failed: {0}")]
    Tensor(#[from] candle_core::Error),
}

impl Error {
    /// Creates an [`Error::File`].
    pub fn file(file: &Path, what: impl Into<String>) -> Self {
        Self::File { file: file.to_owned(), what: what.into() }
    }

    /// Returns a function that converts an I/O error into an error that names `file`.
    pub(crate) fn io(file: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |error| Self::file(file, error.to_string())
    }
}

/// Result of the functions of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Lists the first few names and counts the others, for a message.
pub(crate) fn some_of<S: AsRef<str>>(names: &[S]) -> String {
    const SHOWN: usize = 6;
    let shown: Vec<String> = names.iter().take(SHOWN).map(|name| format!("`{}`", name.as_ref())).collect();
    let more = names.len().saturating_sub(SHOWN);
    if more == 0 { shown.join(", ") } else { format!("{} and {more} more", shown.join(", ")) }
}
