//! Renderers that kinds share: light transport.

pub mod transport;
