//! Errors of kinds and file formats.

/// An error of a kind or of a file format. It contains the file, the problem and a remedy; the
/// engine adds the node and the place in the graph file.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An invalid file, or one with unusable content.
    #[error("`{file}`: {what}")]
    Format {
        /// The file as the graph names it.
        file: String,
        /// The problem, with its position in the file if known.
        what: String,
    },
    /// A file that uses an unsupported feature, which the error names.
    #[error("`{file}` is not supported: {feature}")]
    Unsupported {
        /// The file as the graph names it.
        file: String,
        /// The feature, and what to do instead.
        feature: String,
    },
    /// The run was cancelled.
    #[error("stopped")]
    Stopped,
    /// Inputs that are inconsistent with each other.
    #[error("{0}")]
    Mismatch(String),
}

impl Error {
    /// Creates an [`Error::Format`].
    pub fn format(file: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Format { file: file.into(), what: what.into() }
    }

    /// Creates an [`Error::Unsupported`].
    pub fn unsupported(file: impl Into<String>, feature: impl Into<String>) -> Self {
        Self::Unsupported { file: file.into(), feature: feature.into() }
    }
}
