//! Errors of the benchmark.

use std::fmt;

/// A mistake in a file of a set.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Mistake {
    /// Path of the file, relative to the set.
    pub file: String,
    /// Field of the file, such as `pose.scale`; empty for the file as a whole.
    pub field: String,
    /// The problem, and what to do.
    pub text: String,
}

impl fmt::Display for Mistake {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.field.as_str() {
            "" => write!(f, "{}: {}", self.file, self.text),
            field => write!(f, "{}, `{field}`: {}", self.file, self.text),
        }
    }
}

/// All mistakes of a set, in the order in which its files are read.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Mistakes(pub Vec<Mistake>);

impl Mistakes {
    /// Adds a mistake. `field` is empty for the file as a whole.
    pub fn add(&mut self, file: &str, field: &str, text: impl Into<String>) {
        self.0.push(Mistake { file: file.to_owned(), field: field.to_owned(), text: text.into() });
    }
}

impl fmt::Display for Mistakes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, mistake) in self.0.iter().enumerate() {
            let line = if at == 0 { "" } else { "\n" };
            write!(f, "{line}  {mistake}")?;
        }
        Ok(())
    }
}

/// Errors that end a benchmark before it begins to render.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The set has mistakes.
    #[error("the set `{folder}` cannot be used (mistakes: {}); docs/benchmark.md describes the format:\n{mistakes}", mistakes.0.len())]
    Set {
        /// Folder of the set.
        folder: String,
        /// The mistakes.
        mistakes: Mistakes,
    },
    /// A case was requested by a name that the set does not have.
    #[error("the set has no case `{name}`{}; its cases are {known}", near.as_ref().map(|near| format!(" (did you mean `{near}`?)")).unwrap_or_default())]
    NoCase {
        /// The name.
        name: String,
        /// The most similar name of a case.
        near: Option<String>,
        /// Names of all cases.
        known: String,
    },
    /// No case can be run.
    #[error("none of the cases can be run:\n{0}")]
    NoneLeft(String),
    /// The graph of the method cannot be used.
    #[error("the graph `{file}` cannot be used as a method: {why}")]
    Method {
        /// Path of the graph.
        file: String,
        /// The reason, and what to do.
        why: String,
    },
    /// The folder of pictures of other methods cannot be used.
    #[error("the pictures in `{folder}` cannot be used (mistakes: {}):\n{mistakes}", mistakes.0.len())]
    Pictures {
        /// Folder that was given.
        folder: String,
        /// The mistakes.
        mistakes: Mistakes,
    },
    /// A picture of the set cannot be decoded.
    #[error("cannot read `{path}`: {why}")]
    Picture {
        /// Path of the file.
        path: String,
        /// The reason.
        why: String,
    },
    /// An output file cannot be written.
    #[error("{0}")]
    Write(#[from] cache::Error),
}
