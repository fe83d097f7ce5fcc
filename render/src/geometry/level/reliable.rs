//! Whether a floor is seen clearly enough.

use super::profile::Profile;

/// Minimum concentration in layers of a fully reliable estimate. Evenly spread splats with random orientations
/// reach 0.01.
pub(super) const LEAST_LAYERING: f64 = 0.045;
/// Minimum number of patches of the floor for a fully reliable estimate.
pub(super) const LEAST_OBSERVATIONS: f64 = 150.0;

/// True if a floor, given by its concentration in layers and its profile, is seen clearly enough to be reliable.
pub(super) fn is_reliable(layering: f64, profile: &Profile) -> bool {
    layering >= LEAST_LAYERING && profile.observations >= LEAST_OBSERVATIONS
}
