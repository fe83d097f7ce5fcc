//! The decision about the surroundings.

use render::transport::ground::probe::Probe;
use render::transport::path::visibility::Rules;

/// Decision about the surroundings, and the facts on which it is based.
pub(super) struct Decided {
    /// Text of the choice of `surroundings` that is equivalent to the decision.
    pub(super) name: String,
    pub(super) rules: Rules,
    pub(super) probe: Option<Probe>,
    /// Share of light that the mesh counts twice by reflecting it, or would count twice if it reflected light.
    /// `None` for a solid mesh.
    pub(super) twice: Option<f64>,
}
