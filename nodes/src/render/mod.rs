//! Renderers that kinds share: Gaussian splats, and light transport.

pub mod splat;
pub mod transport;
