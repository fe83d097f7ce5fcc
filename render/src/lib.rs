//! Renderers that kinds of nodes use: Gaussian splats and their training, light transport, recovered light, ray casting,
//! and the comparison of meshes and splats.
//!
//! A file imports only from its own module and from those after it in this list: [`train`], [`agreement`],
//! [`look`], [`layout`], [`pick`], [`transport`], [`fusion`], [`splat`], [`light`], [`geometry`].

pub mod agreement;
pub mod fusion;
pub mod geometry;
pub mod layout;
pub mod light;
pub mod look;
pub mod pick;
pub mod splat;
pub mod train;
pub mod transport;
