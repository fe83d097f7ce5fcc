//! Tolerances of contact.

/// Largest error of a mesh that is assumed by default, in metres.
pub(crate) const LARGEST: f64 = 0.05;
/// Maximum distance between two surfaces that touch, in metres.
pub(crate) const TOUCHING: f64 = 0.01;
/// Roughness below which a mesh is not corrected, in metres.
pub(crate) const SMOOTHEST: f64 = 1e-4;
