//! Graph files as text: parsing, includes, overlays, and mistakes with their positions.

pub(crate) mod diag;
pub(crate) mod document;
pub(crate) mod edit;
pub(crate) mod graph_text;
pub(crate) mod include;
pub(crate) mod overlay;
pub(crate) mod scan;
pub(crate) mod source;
pub(crate) mod subgraph;
pub(crate) mod syntax;
pub(crate) mod values;
