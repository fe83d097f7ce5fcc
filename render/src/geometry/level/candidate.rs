//! Directions that may be up.

use super::profile::Profile;

/// Weight of the logarithm of the concentration in layers (see [`axes`](super::axes)) as evidence that an axis is
/// the vertical.
pub(super) const LAYERED: f64 = 6.0;

/// A direction that may be up, with the logarithm of its odds.
pub(super) struct Candidate {
    pub(super) odds: f64,
    pub(super) layering: f64,
    pub(super) profile: Profile,
}
