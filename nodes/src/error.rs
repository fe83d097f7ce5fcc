//! What can go wrong with the data of a scene.

/// An error of a kind or of a file format. It says what is wrong with which file and what to do; the
/// engine adds the node and the place in the graph file.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file that is not what it claims to be, or holds what cannot be used.
    #[error("`{file}`: {what}")]
    Format {
        /// The file as the graph names it.
        file: String,
        /// What is wrong, with the place in the file where it has one.
        what: String,
    },
    /// A file that uses a feature we do not support; names the feature.
    #[error("`{file}`: not supported: {feature}")]
    Unsupported {
        /// The file as the graph names it.
        file: String,
        /// The feature, and what to do instead.
        feature: String,
    },
    /// The run was asked to stop, which the engine takes for the node's end whatever the node says of it.
    #[error("stopped")]
    Stopped,
    /// Inputs that do not belong together.
    #[error("{0}")]
    Mismatch(String),
}

impl Error {
    /// A [`Error::Format`].
    pub fn format(file: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Format { file: file.into(), what: what.into() }
    }

    /// A [`Error::Unsupported`].
    pub fn unsupported(file: impl Into<String>, feature: impl Into<String>) -> Self {
        Self::Unsupported { file: file.into(), feature: feature.into() }
    }
}
