//! Code that needs a tensor library: training of the learned prediction of hidden light ([`training`]), and the
//! diffusion model of `predict-exposure` ([`diffusion`]) with the training of its LoRA ([`lora`]). This crate is not
//! part of a default build; the feature `learned` of `lightharmony` adds it.
//!
//! [`exposure`] and [`flux`] do not depend on graphs or images; the other modules pass arrays to them.

pub mod diffusion;
pub mod exposure;
pub mod flux;
pub mod lora;
pub mod training;
