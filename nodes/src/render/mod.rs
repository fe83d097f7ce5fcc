//! Renderers that kinds share: Gaussian splats.

pub mod splat;
