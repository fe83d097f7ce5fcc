//! A pixel after fusion.

/// Luminance of one pixel after fusion, and its source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fused {
    /// Absolute luminance E'_N of the paper.
    pub(super) luminance: f64,
    /// Index of the exposure that contributed most. The index of the base is the number of exposures.
    pub(super) source: usize,
    /// True if the darkest exposure is white here, so that the light is a lower bound.
    pub(super) saturated: bool,
}
