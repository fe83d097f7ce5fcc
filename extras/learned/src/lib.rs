//! Code that needs a tensor library: training of the exposure network that `nodes` ships, and the diffusion backend
//! of `predict-exposure`. This crate is not part of a default build; the feature `learned` of `lightharmony` adds
//! it.
//!
//! The crate does not depend on graphs or images: `nodes` passes arrays to it.

pub mod exposure;
pub mod flux;
