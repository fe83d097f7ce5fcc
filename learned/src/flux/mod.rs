//! Flux.1 Kontext, with which the paper predicts what a panorama looks like at a darker exposure: an image-editing
//! diffusion model, a LoRA that teaches it this one edit, and a fixed prompt. The weights are the user's to supply.

use candle_core::Tensor;

mod attention;
mod backward;
mod block;
mod config;
mod conv;
mod error;
mod gguf;
mod kontext;
mod latents;
mod linear;
mod loader;
mod lora;
mod memory;
mod names;
mod noise;
mod norm;
mod prompt;
mod rope;
mod schedule;
mod source;
mod train;
mod transformer;
mod vae;
mod watch;

pub use backward::Given;
pub use config::Config;
pub use conv::Edge;
pub use error::{Error, Result};
pub use kontext::{Files, Kontext, Settings};
pub use latents::{half_turned, pack, unpack};
pub use linear::{Linear, Matrix, Update};
pub use loader::Tally;
pub use lora::Lora;
pub use memory::Memory;
pub use names::Layout;
pub use noise::normals;
pub use prompt::Prompt;
pub use rope::{Place, grid};
pub use schedule::noise_levels;
pub use source::{Entry, Format, Source, Stored, shards};
pub use train::{Pair, TrainSettings, Trainer};
pub use transformer::Transformer;
pub use vae::{Vae, VaeConfig};
pub use watch::Watch;

pub use candle_core::{DType, Device};

/// Which files a user must supply, where they are, and what they cost: for the message that misses one.
pub const WHERE: &str = "the weights are yours to supply: Flux.1 Kontext [dev] from \
    huggingface.co/black-forest-labs/FLUX.1-Kontext-dev, under its non-commercial licence, which you accept there: \
    `flux1-kontext-dev.safetensors` (23.8 GB; a GGUF of it has 6.7 GB with four bits a weight) and `ae.safetensors` \
    (0.3 GB); the encoded prompt (4 MB) and a LoRA for exposure (`train-exposure --backend flux-kontext`). It needs \
    the transformer's size in memory and 7 GB more. docs/kontext.md tells each";

/// A GPU where the build knows one (feature `cuda`) and there is one; else the CPU.
pub fn device() -> Result<Device> {
    Ok(Device::cuda_if_available(0)?)
}

/// A picture from its samples: 3 planes of height x width, in 0..1.
pub fn picture(planes: &[f32], (width, height): (usize, usize), device: &Device) -> Result<Tensor> {
    Ok(Tensor::from_slice(planes, (3, height, width), device)?)
}

/// The samples of a picture: 3 planes of height x width.
pub fn samples(picture: &Tensor) -> Result<Vec<f32>> {
    Ok(picture.flatten_all()?.to_vec1()?)
}
