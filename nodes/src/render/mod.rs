//! Renderers that kinds share: Gaussian splats, and light transport.

pub(crate) mod fusion;
pub mod splat;
pub mod transport;
