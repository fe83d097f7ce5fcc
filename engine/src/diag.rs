//! Diagnostics: what is wrong in a graph file, where, and what to do.

use std::ops::Range;

/// One mistake.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnostic {
    /// Bytes of the text that are underlined.
    pub span: Range<usize>,
    /// What is wrong.
    pub message: String,
    /// What stands under the underline.
    pub label: String,
    /// What to do.
    pub hints: Vec<String>,
}

impl Diagnostic {
    /// A mistake at `span`.
    pub fn new(span: Range<usize>, message: impl Into<String>) -> Self {
        Self { span, message: message.into(), label: String::new(), hints: Vec::new() }
    }
    /// Adds the text under the underline.
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = label.into();
        self
    }
    /// Adds advice.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hints.push(hint.into());
        self
    }
}
