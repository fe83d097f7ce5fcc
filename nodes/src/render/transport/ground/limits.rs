//! How far a mesh may be wrong, and how near two surfaces are that touch.

/// The largest error of a mesh that is believed without being told, in metres.
pub(crate) const LARGEST: f64 = 0.05;
/// How near to the base of an object the top of another is that it rests on, in metres.
pub(crate) const TOUCHING: f64 = 0.01;
/// A mesh smoother than this is taken as it is, in metres.
pub(crate) const SMOOTHEST: f64 = 1e-4;
