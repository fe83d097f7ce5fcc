//! The error of a node that cannot compute its outputs.

use std::any::Any;
use std::error::Error as StdError;
use std::panic::{AssertUnwindSafe, catch_unwind};

use cache::Digest;

/// The failure of a node: a message, the responsible field, and advice.
///
/// Any error of the standard library or of another crate becomes a `NodeError` by `?`. A kind rarely needs an error
/// type of its own.
///
/// ```
/// use engine::NodeError;
///
/// fn exposure(text: &str) -> Result<f64, NodeError> {
///     let seconds: f64 = text.trim().parse()?;
///     if seconds <= 0.0 {
///         let what = format!("the exposure is {seconds} s, but it must be positive");
///         return Err(NodeError::new(what).at("path").hint("correct the first line of the file"));
///     }
///     Ok(seconds)
/// }
///
/// assert_eq!(exposure(" 0.5\n")?, 0.5);
/// assert_eq!(exposure("fast").expect_err("a word").message(), "invalid float literal");
/// let error = exposure("-1").expect_err("negative");
/// assert_eq!(error.advice(), Some("correct the first line of the file"));
/// # Ok::<(), NodeError>(())
/// ```
#[derive(Debug)]
pub struct NodeError {
    pub(crate) kind: NodeErrorKind,
    pub(crate) field: Option<&'static str>,
    pub(crate) hint: Option<String>,
}

#[derive(Debug)]
pub(crate) enum NodeErrorKind {
    Cancelled,
    /// Another node or process is computing a part with this key. The node is tried again later.
    Busy(Digest),
    Failed(String),
}

impl NodeError {
    /// An error with a message.
    pub fn new(message: impl Into<String>) -> Self {
        Self { kind: NodeErrorKind::Failed(message.into()), field: None, hint: None }
    }

    /// The error of a node that stopped because the run was cancelled.
    pub fn cancelled() -> Self {
        Self { kind: NodeErrorKind::Cancelled, field: None, hint: None }
    }

    /// The error of a node that needs a part which is being computed elsewhere.
    pub(crate) fn busy(key: Digest) -> Self {
        Self { kind: NodeErrorKind::Busy(key), field: None, hint: None }
    }

    /// Names the responsible parameter or input. The report underlines the text of this field.
    pub fn at(mut self, field: &'static str) -> Self {
        self.field.get_or_insert(field);
        self
    }

    /// Adds advice.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint.get_or_insert(hint.into());
        self
    }

    /// The advice, if there is any.
    pub fn advice(&self) -> Option<&str> {
        self.hint.as_deref()
    }

    /// True if the run was cancelled, as opposed to a failure.
    pub fn is_cancelled(&self) -> bool {
        matches!(self.kind, NodeErrorKind::Cancelled)
    }

    /// The message without the field and the advice.
    pub fn message(&self) -> &str {
        match &self.kind {
            NodeErrorKind::Cancelled => "stopped",
            NodeErrorKind::Busy(_) => "a part of the node is being computed elsewhere",
            NodeErrorKind::Failed(message) => message,
        }
    }
}

impl std::fmt::Display for NodeError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.message())
    }
}

/// Converts an error of any type into the failure of a node. The message includes its chain of causes.
impl<E: StdError + Send + Sync + 'static> From<E> for NodeError {
    fn from(error: E) -> Self {
        let mut message = error.to_string();
        let mut cause = error.source();
        while let Some(inner) = cause {
            let text = inner.to_string();
            if !message.contains(&text) {
                message.push_str(": ");
                message.push_str(&text);
            }
            cause = inner.source();
        }
        Self::new(message)
    }
}

/// Turns a panic in the code of a kind into an error.
pub(crate) fn guarded<T>(code: impl FnOnce() -> Result<T, NodeError>) -> Result<T, NodeError> {
    catch_unwind(AssertUnwindSafe(code)).unwrap_or_else(|panic| {
        Err(NodeError::new(format!("the code of this kind panicked: {}", panic_text(&*panic)))
            .hint("this is a bug in lightharmony, not a mistake in the graph; please report it"))
    })
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or(panic.downcast_ref::<&str>().copied())
        .unwrap_or("no message")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_are_reported_in_words() {
        let panic = catch_unwind(|| panic!("row {}", 7)).expect_err("it panics");
        assert_eq!(panic_text(&*panic), "row 7");
    }
}
