//! Errors of measuring a graph.

use engine::Diagnostics;

/// Errors of measuring a graph.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The graph has mistakes, which this variant contains.
    #[error("{0}")]
    Graph(Diagnostics),
    /// A measure of error with this name does not exist.
    #[error("`{text}` is not a measure of error; write one of {known}, {regions}")]
    Metric {
        /// Text as it was written.
        text: String,
        /// Names of the measures.
        known: String,
        /// Regions that may precede the name of a measure.
        regions: &'static str,
    },
    /// A bound on an error cannot be parsed.
    #[error(
        "`{text}` is not a bound on an error; write METRIC=VALUE, such as flip=0.02; VALUE is 0 or more, METRIC is one of \
         {known}, {regions}"
    )]
    Bound {
        /// Text as it was written.
        text: String,
        /// Names of the measures.
        known: String,
        /// The regions that may precede the name of a measure.
        regions: &'static str,
    },
    /// None of the selected nodes outputs a picture.
    #[error(
        "none of the selected nodes outputs a picture, so there is nothing to compare; select one that does with `--only`"
    )]
    NoPicture,
    /// No knob changes these pictures.
    #[error(
        "no knob changes `{0}`, so every setting gives the same picture; `lightharmony knobs` lists the knobs, and the \
         graph's own `reference` preset may set any other field"
    )]
    NoKnob(String),
    /// The metric is not defined for these pictures.
    #[error("`{metric}` cannot be computed for every picture here; it needs {needs}")]
    NotComputed {
        /// The metric as it was written.
        metric: String,
        /// The requirement of the metric.
        needs: &'static str,
    },
    /// The graph cannot be measured with a setting.
    #[error("the graph cannot be measured with the setting {setting}:\n{why}")]
    Setting {
        /// The setting in words.
        setting: String,
        /// The reason.
        why: String,
    },
}
