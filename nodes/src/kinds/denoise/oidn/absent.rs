//! Stand-in for builds without Open Image Denoise. Every call returns an error that names the missing feature.

use engine::{Context, NodeError, Notes, SourceFile};

use super::super::means::{Field, VALUES};
use super::super::view::ViewLayers;

pub(in super::super) fn sources() -> Result<Vec<SourceFile>, NodeError> {
    Err(NodeError::new("this build lacks the feature `oidn`, which loads Open Image Denoise")
        .at("method")
        .hint("build it with `--features oidn`, or use `Means`"))
}

pub(in super::super) fn report(_: &mut Notes) -> Result<(), NodeError> {
    sources().map(|_| ())
}

pub(in super::super) fn bytes(_: usize) -> u64 {
    0
}

pub(in super::super) fn filter(
    _: &ViewLayers<'_>,
    _: [&Field; 2],
    _: &Context,
) -> Result<[Vec<[f32; VALUES]>; 2], NodeError> {
    sources().map(|_| Default::default())
}
