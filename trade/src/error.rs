//! Errors that occur when a graph is measured.

use engine::Diagnostics;

/// Errors that occur when a graph is measured.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The graph has mistakes.
    #[error("{0}")]
    Graph(Diagnostics),
    /// There is no metric with this name.
    #[error("`{text}` is not a measure of error; write one of {known}, {regions}")]
    Metric {
        /// The text that the user wrote.
        text: String,
        /// The names of all metrics.
        known: String,
        /// Description of the prefixes that select a region.
        regions: &'static str,
    },
    /// A bound on an error cannot be parsed.
    #[error(
        "`{text}` is not a bound on an error; write METRIC=VALUE, such as flip=0.02; VALUE is 0 or more, METRIC is one of \
         {known}, {regions}"
    )]
    Bound {
        /// The text that the user wrote.
        text: String,
        /// The names of all metrics.
        known: String,
        /// Description of the prefixes that select a region.
        regions: &'static str,
    },
    /// None of the selected nodes outputs a picture.
    #[error(
        "none of the selected nodes outputs a picture, so there is nothing to compare; use `--only` to select a node that outputs one"
    )]
    NoPicture,
    /// No knob changes any of the pictures. The text contains their names.
    #[error(
        "no knob changes `{0}`, so every setting gives the same picture; `lightharmony knobs` lists the knobs, and the \
         graph's own `reference` preset may set any other field"
    )]
    NoKnob(String),
    /// The metric is not defined for these pictures.
    #[error("`{metric}` cannot be computed for at least one of the pictures; this metric needs {needs}")]
    NotComputed {
        /// The metric, as the user wrote it.
        metric: String,
        /// Requirement of the metric, in words.
        needs: &'static str,
    },
    /// The graph cannot be measured at a setting.
    #[error("the graph cannot be measured with the setting `{setting}`:\n{why}")]
    Setting {
        /// The name of the setting.
        setting: String,
        /// The reason.
        why: String,
    },
}
