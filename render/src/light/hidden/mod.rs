//! Light that a panorama hides because it is clipped: which pixels are clipped, how much light they hide, where in a
//! clipped region it is, and which colour it has.
//!
//! [`network`] is the learned prediction, [`region`] a regression per region, [`sun`] the rule for suns, and
//! [`diffusion`] the seam to the diffusion model of the paper. All of them work on the cells of a [`grid`].

pub mod clip;
pub mod clipped;
pub mod diffusion;
pub mod grid;
pub mod network;
pub mod region;
pub mod spread;
pub mod sun;
