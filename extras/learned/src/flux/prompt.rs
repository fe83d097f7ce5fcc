//! The encoded prompt.

use std::path::Path;

use candle_core::{Device, Tensor};

use super::config::Config;
use super::error::Result;
use super::source::Source;

/// Text input of the transformer. The prompt is always the same, so its encoders (9.8 GB) are run once, elsewhere,
/// and only their output is kept (4 MB).
#[derive(Debug, Clone)]
pub struct Prompt {
    /// Tokens of text (of T5-XXL), tokens x context, f32.
    pub text: Tensor,
    /// The text in one vector (of CLIP-L), 1 x pooled, f32.
    pub pooled: Tensor,
}

/// Maximum number of tokens of text in the training of the model.
const MAX_TOKENS: usize = 512;

impl Prompt {
    /// Reads a safetensors file with `t5` (tokens x context) and `clip` (pooled), or with `prompt_embeds` and
    /// `pooled_prompt_embeds` as `diffusers` names them; a leading axis of 1 is ignored.
    pub fn read(path: &Path, config: &Config, device: &Device) -> Result<Self> {
        let source = Source::open(path)?;
        let find = |names: [&'static str; 2]| names.into_iter().find(|name| source.shape(name).is_some());
        let (Some(text), Some(pooled)) =
            (find(["t5", "prompt_embeds"]), find(["clip", "pooled_prompt_embeds"]))
        else {
            return Err(source.wrong("contains no prompt: the tensors `t5` and `clip` are required"));
        };
        let sized = |name: &str, width: usize, most: usize| -> Result<Tensor> {
            let shape = source.shape(name).unwrap_or_default();
            let tokens = shape.iter().rev().skip(1).product::<usize>();
            if shape.last() != Some(&width) || !(1..=most).contains(&tokens) {
                let what = format!("`{name}` has shape {shape:?}; it needs 1 to {most} rows of {width}");
                return Err(source.wrong(what));
            }
            Ok(source.read_f32(name, device)?.reshape((tokens, width))?)
        };
        Ok(Self { text: sized(text, config.context, MAX_TOKENS)?, pooled: sized(pooled, config.pooled, 1)? })
    }
}
