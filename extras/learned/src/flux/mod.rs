//! Flux.1 Kontext, an image-editing diffusion model. The paper that lightharmony implements, LightHarmony3D, uses
//! it to predict how a panorama looks at a darker exposure. A LoRA specializes the model for this edit, and the
//! prompt is fixed. The user supplies the weights.

use candle_core::Tensor;

mod attention;
mod backward;
mod block;
mod config;
mod conv;
mod entry;
mod error;
mod gguf;
mod kontext;
mod latents;
mod linear;
mod loader;
mod lora;
mod memory;
mod modules;
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
pub use entry::{Entry, Format};
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
pub use source::{Source, Stored, shards};
pub use train::{Pair, TrainSettings, Trainer};
pub use transformer::Transformer;
pub use vae::{Vae, VaeConfig};
pub use watch::Watch;

pub use candle_core::{DType, Device};

/// Returns a GPU if the build supports GPUs (feature `cuda`) and a GPU is present; otherwise, the CPU.
pub fn device() -> Result<Device> {
    Ok(Device::cuda_if_available(0)?)
}

/// Converts samples to a picture. The samples are from 0 to 1, in 3 planes of height x width.
pub fn picture(planes: &[f32], (width, height): (usize, usize), device: &Device) -> Result<Tensor> {
    Ok(Tensor::from_slice(planes, (3, height, width), device)?)
}

/// The samples of a picture, as 3 planes of height x width.
pub fn samples(picture: &Tensor) -> Result<Vec<f32>> {
    Ok(picture.flatten_all()?.to_vec1()?)
}
