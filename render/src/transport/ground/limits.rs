//! Tolerances of contact.

/// Maximum error of a mesh, in metres, that is assumed if the user gives none.
pub const LARGEST: f64 = 0.05;
/// Maximum distance at which two surfaces count as touching, in metres.
pub(crate) const TOUCHING: f64 = 0.01;
/// Roughness of a mesh, in metres, below which camera hits on the mesh are not moved.
pub(crate) const SMOOTHEST: f64 = 1e-4;
