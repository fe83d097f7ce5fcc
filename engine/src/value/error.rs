//! How a node says that it cannot give its outputs.

use std::any::Any;
use std::error::Error as StdError;
use std::panic::{AssertUnwindSafe, catch_unwind};

use cache::Digest;

/// Why a node stopped: what is wrong, where in the graph file it was asked for, and what to do.
#[derive(Debug)]
pub struct NodeError {
    pub(crate) kind: NodeErrorKind,
    pub(crate) field: Option<&'static str>,
    pub(crate) hint: Option<String>,
}

#[derive(Debug)]
pub(crate) enum NodeErrorKind {
    Cancelled,
    /// A part of it, of this key, is being computed by another node or process: it is asked again once that is over.
    Busy(Digest),
    Failed(String),
}

impl NodeError {
    /// An error in words.
    pub fn new(message: impl Into<String>) -> Self {
        Self { kind: NodeErrorKind::Failed(message.into()), field: None, hint: None }
    }

    /// The run was asked to stop.
    pub fn cancelled() -> Self {
        Self { kind: NodeErrorKind::Cancelled, field: None, hint: None }
    }

    /// Another computes a part of this key.
    pub(crate) fn busy(key: Digest) -> Self {
        Self { kind: NodeErrorKind::Busy(key), field: None, hint: None }
    }

    /// Names the parameter or input that is to blame, so that its text is underlined.
    pub fn at(mut self, field: &'static str) -> Self {
        self.field.get_or_insert(field);
        self
    }

    /// Says what to do about it.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint.get_or_insert(hint.into());
        self
    }

    /// What to do about it, where that is known.
    pub fn advice(&self) -> Option<&str> {
        self.hint.as_deref()
    }

    /// True for a run that was stopped rather than one that failed.
    pub fn is_cancelled(&self) -> bool {
        matches!(self.kind, NodeErrorKind::Cancelled)
    }

    /// What is wrong, without place or advice.
    pub fn message(&self) -> &str {
        match &self.kind {
            NodeErrorKind::Cancelled => "stopped",
            NodeErrorKind::Busy(_) => "a part of it is being computed elsewhere",
            NodeErrorKind::Failed(message) => message,
        }
    }
}

impl std::fmt::Display for NodeError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.message())
    }
}

/// Any typed error of a crate of kinds becomes a node's failure; its chain of causes is written out.
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

/// Turns a panic of a kind's code into the failure of its node.
pub(crate) fn guarded<T>(code: impl FnOnce() -> Result<T, NodeError>) -> Result<T, NodeError> {
    catch_unwind(AssertUnwindSafe(code)).unwrap_or_else(|panic| {
        Err(NodeError::new(format!("the code of this kind panicked: {}", panic_text(&*panic)))
            .hint("this is a mistake in the program, not in the graph; please report it"))
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
