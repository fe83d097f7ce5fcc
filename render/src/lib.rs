//! What kinds of nodes compute with: renderers of Gaussian splats and of light transport, recovered light, ray casting,
//! and the training of splats.
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
