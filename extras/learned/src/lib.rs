//! Code that needs a tensor library: training of the exposure network that `nodes` ships, and the diffusion backend
//! of `predict-exposure`. Nothing here is in a default build; the feature `learned` of `lightharmony` brings it in.
//!
//! The crate knows tensors and files of weights, and neither graphs nor images: `nodes` hands it arrays.

pub mod exposure;
pub mod flux;
