//! Renderers that several kinds use: Gaussian splats, light transport, and the search for places where an object
//! may stand.

pub mod agreement;
pub(crate) mod fusion;
pub mod layout;
pub mod look;
pub mod pick;
pub mod splat;
pub mod transport;
