//! [`Prompt`]: the encoded prompt, read from a file.

use std::path::Path;

use candle_core::{Device, Tensor};

use super::config::Config;
use super::error::Result;
use super::source::Source;

/// Text input of the transformer. The prompt is always the same, so the text encoders (9.8 GB) need to be run only
/// once. Another program runs them and stores their output (4 MB).
#[derive(Debug, Clone)]
pub struct Prompt {
    /// The tokens of the prompt, encoded by T5-XXL: tokens x context, f32.
    pub text: Tensor,
    /// The whole prompt as one vector, encoded by CLIP-L: 1 x pooled, f32.
    pub pooled: Tensor,
}

/// Maximum number of text tokens. The model was trained with at most this number of tokens.
const MAX_TOKENS: usize = 512;

impl Prompt {
    /// Reads the encoded prompt from a safetensors file. The tensors are called `t5` (tokens x context) and `clip`
    /// (pooled), or `prompt_embeds` and `pooled_prompt_embeds` as in `diffusers`. A leading axis of length 1 is
    /// ignored.
    pub fn read(path: &Path, config: &Config, device: &Device) -> Result<Self> {
        let source = Source::open(path)?;
        let find = |names: [&'static str; 2]| names.into_iter().find(|name| source.shape(name).is_some());
        let (Some(text), Some(pooled)) =
            (find(["t5", "prompt_embeds"]), find(["clip", "pooled_prompt_embeds"]))
        else {
            return Err(source.wrong("the file contains no prompt: the tensors `t5` and `clip` are required"));
        };
        let sized = |name: &str, width: usize, most: usize| -> Result<Tensor> {
            let shape = source.shape(name).unwrap_or_default();
            let tokens = shape.iter().rev().skip(1).product::<usize>();
            if shape.last() != Some(&width) || !(1..=most).contains(&tokens) {
                let what =
                    format!("`{name}` has shape {shape:?}; it must have 1 to {most} rows of {width} numbers");
                return Err(source.wrong(what));
            }
            Ok(source.read_f32(name, device)?.reshape((tokens, width))?)
        };
        Ok(Self { text: sized(text, config.context, MAX_TOKENS)?, pooled: sized(pooled, config.pooled, 1)? })
    }
}
