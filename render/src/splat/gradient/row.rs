//! Splats of a view, with the sums of their pixels.

use super::super::project::Footprint;
use super::sums::Sums;

/// A splat that was blended into at least one pixel.
pub struct Row<'a> {
    /// Index of the splat in the scene.
    pub splat: usize,
    /// Footprint of the splat.
    pub(super) footprint: &'a Footprint,
    /// Sums over all pixels of the view.
    pub sums: &'a Sums,
}
