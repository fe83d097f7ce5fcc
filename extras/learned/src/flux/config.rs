//! The sizes of the transformer, derived from its weights file.

use std::path::Path;

use serde::Deserialize;

use super::error::{Error, Result};
use super::names::Layout;
use super::source::Source;

/// The sizes of a transformer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Config {
    /// Number of channels of a token inside the blocks.
    pub hidden: usize,
    /// Number of attention heads. Each head has `hidden / heads` channels.
    pub heads: usize,
    /// Number of units in the hidden layer of each perceptron.
    pub mlp: usize,
    /// Number of channels of a picture token. A token represents four latent pixels.
    pub in_channels: usize,
    /// Number of channels of a text token.
    pub context: usize,
    /// Length of the vector that represents the text as a whole.
    pub pooled: usize,
    /// Length of the embedding of a noise level.
    pub time: usize,
    /// Three even numbers: the channels per head that encode the frame, the row and the column of a token, in this
    /// order.
    pub axes: [usize; 3],
    /// True if the guidance strength is an input of the network.
    pub guidance: bool,
    /// Number of blocks in which text and picture have separate weights.
    pub double_blocks: usize,
    /// Number of blocks in which text and picture share weights.
    pub single_blocks: usize,
}

/// The fields that are read from the `config.json` of `diffusers`.
#[derive(Deserialize)]
struct File {
    attention_head_dim: usize,
    axes_dims_rope: [usize; 3],
    guidance_embeds: bool,
    in_channels: usize,
    joint_attention_dim: usize,
    num_attention_heads: usize,
    num_layers: usize,
    num_single_layers: usize,
    pooled_projection_dim: usize,
}

/// Maximum number of blocks of each kind that are looked for in a file.
const MAX_BLOCKS: usize = 1000;

impl Config {
    /// The sizes of the published model, which has 12 billion weights.
    pub const fn kontext() -> Self {
        Self {
            hidden: 3072,
            heads: 24,
            mlp: 12288,
            in_channels: 64,
            context: 4096,
            pooled: 768,
            time: 256,
            axes: [16, 56, 56],
            guidance: true,
            double_blocks: 19,
            single_blocks: 38,
        }
    }

    /// Number of channels per head.
    pub const fn head(&self) -> usize {
        self.hidden / self.heads
    }

    /// Derives the layout and the sizes from the shapes in the headers. Only [`axes`](Self::axes) are not in the
    /// headers: they are read from the `config.json` next to the file, which must agree with the headers. If there
    /// is no `config.json`, the axes of the published model are used. They are valid only for heads with the same
    /// number of channels as in the published model.
    pub fn of(source: &Source) -> Result<(Layout, Self)> {
        let layout = ["", "model.diffusion_model."]
            .into_iter()
            .map(|prefix| Layout::Original { prefix })
            .chain([Layout::Diffusers])
            .find(|layout| source.shape(&format!("{}.weight", layout.pieces("img_in").modules[0])).is_some())
            .ok_or_else(|| {
                source.wrong(
                    "the file is not a Flux transformer: it contains neither `img_in.weight` nor `x_embedder.weight`",
                )
            })?;
        let matrix = |module: &str| -> Result<(usize, usize)> {
            let name = format!("{}.weight", layout.pieces(module).modules[0]);
            match source.shape(&name) {
                Some(&[rows, columns]) if rows > 0 && columns > 0 => Ok((rows, columns)),
                Some(shape) => {
                    Err(source.wrong(format!("`{name}` has shape {shape:?}; it must be a matrix")))
                }
                None => Err(source.wrong(format!("`{name}` is missing"))),
            }
        };
        let blocks = |first: &str, module: &str| {
            let there = |i: &usize| {
                let name = format!("{}.weight", layout.pieces(&format!("{first}.{i}.{module}")).modules[0]);
                source.shape(&name).is_some()
            };
            (0..MAX_BLOCKS).take_while(there).count()
        };
        let (hidden, in_channels) = matrix("img_in")?;
        let norm = layout.scale("double_blocks.0.img_attn.norm.query_norm");
        let head = match source.shape(&norm) {
            Some(&[head]) if head > 0 && hidden % head == 0 => head,
            Some(shape) => {
                return Err(source.wrong(format!(
                    "`{norm}` has shape {shape:?}; it must have a single axis, whose length divides {hidden}, the width of the model"
                )));
            }
            None => return Err(source.wrong(format!("`{norm}` is missing"))),
        };
        let mut config = Self {
            hidden,
            heads: hidden / head,
            mlp: matrix("double_blocks.0.img_mlp.0")?.0,
            in_channels,
            context: matrix("txt_in")?.1,
            pooled: matrix("vector_in.in_layer")?.1,
            time: matrix("time_in.in_layer")?.1,
            axes: Self::kontext().axes,
            guidance: matrix("guidance_in.in_layer").is_ok(),
            double_blocks: blocks("double_blocks", "img_mlp.0"),
            single_blocks: blocks("single_blocks", "linear2"),
        };
        config.check(source.path())?;
        if let Some(axes) = config.beside(source.path())? {
            config.axes = axes;
        }
        if config.axes.iter().fold(0, |sum: usize, axis| sum.saturating_add(*axis)) != head
            || config.axes.iter().any(|axis| axis % 2 != 0)
        {
            return Err(source.wrong(format!(
                "the attention heads of the model have {head} channels, but the RoPE axes are {:?}; these must be even numbers that add up to the number of channels. Put the `config.json` of the model, which lists the correct axes, next to the weights file",
                config.axes
            )));
        }
        Ok((layout, config))
    }

    fn check(&self, file: &Path) -> Result<()> {
        if !self.in_channels.is_multiple_of(4) || !self.time.is_multiple_of(2) {
            let (channels, time) = (self.in_channels, self.time);
            return Err(Error::file(
                file,
                format!(
                    "the tokens of the model have {channels} channels, which must be a multiple of 4, and the time embeddings have {time} channels, which must be a multiple of 2"
                ),
            ));
        }
        Ok(())
    }

    /// Reads the axes from the `config.json` next to `file`. Returns `None` if there is no `config.json`, or if it
    /// does not describe a transformer.
    fn beside(&self, file: &Path) -> Result<Option<[usize; 3]>> {
        let path = file.with_file_name("config.json");
        let Ok(text) = std::fs::read(&path) else { return Ok(None) };
        let Ok(json) = serde_json::from_slice::<File>(&text) else { return Ok(None) };
        let said = Self {
            hidden: json.num_attention_heads.saturating_mul(json.attention_head_dim),
            heads: json.num_attention_heads,
            in_channels: json.in_channels,
            context: json.joint_attention_dim,
            pooled: json.pooled_projection_dim,
            guidance: json.guidance_embeds,
            double_blocks: json.num_layers,
            single_blocks: json.num_single_layers,
            ..self.clone()
        };
        if said != *self {
            let what = format!(
                "this file describes a model whose layer sizes differ from those in `{}`; use the `config.json` that belongs to the model file",
                file.display()
            );
            return Err(Error::file(&path, what));
        }
        Ok(Some(json.axes_dims_rope))
    }
}
