//! The autoencoder of Flux.1. It converts between pictures and latents. The width and height of latents are an
//! eighth of the width and height of the picture.

use std::path::Path;

use candle_core::{DType, Device, Tensor};
use serde::Deserialize;

use super::attention::{MAX_SCORES, attention};
use super::conv::{Conv, Edge};
use super::error::Result;
use super::linear::{Linear, Matrix};
use super::loader::{Loader, Tally};
use super::names::Layout;
use super::norm::group;
use super::source::Source;
use super::watch::Watch;

/// The sizes of an autoencoder, derived from its file.
#[derive(Debug, Clone, PartialEq)]
pub struct VaeConfig {
    /// Number of channels at each of the picture sizes inside the network, starting with the full size.
    pub widths: Vec<usize>,
    /// Number of residual blocks that the encoder has at each picture size. The decoder has one more at each size.
    pub blocks: usize,
    /// Number of channels of the latents.
    pub latents: usize,
    /// Number of groups of channels in each group norm.
    pub groups: usize,
    /// Scale of the latents. The latents are (mean - `shift`) * `scale`, where the mean is the output of the
    /// encoder.
    pub scale: f64,
    /// Shift of the latents; see [`VaeConfig::scale`].
    pub shift: f64,
}

/// The fields that are read from the `config.json` of `diffusers`.
#[derive(Deserialize)]
struct File {
    norm_num_groups: usize,
    scaling_factor: f64,
    shift_factor: f64,
}

impl VaeConfig {
    /// The sizes of the autoencoder of Flux.1.
    pub fn flux() -> Self {
        Self {
            widths: vec![128, 256, 512, 512],
            blocks: 2,
            latents: 16,
            groups: 32,
            scale: 0.3611,
            shift: 0.1159,
        }
    }

    /// Derives the sizes from the shapes in the header. The number of groups, the scale and the shift are not in
    /// the header: they are read from the `config.json` next to the file. If there is no such file, the values of
    /// Flux.1 are used.
    fn of(source: &Source) -> Result<(Names, Self)> {
        let original = source.shape("encoder.down.0.block.0.conv1.weight").is_some();
        let mut names = Names { original, levels: 0 };
        let rows =
            |names: &Names, name: &str| source.shape(&format!("{}.weight", names.of(name)))?.first().copied();
        let mut widths = Vec::new();
        while let Some(width) = rows(&names, &format!("encoder.down.{}.block.0.conv1", widths.len())) {
            widths.push(width);
        }
        names.levels = widths.len();
        let blocks =
            (0..).take_while(|j| rows(&names, &format!("encoder.down.0.block.{j}.conv1")).is_some()).count();
        let file = source.path().with_file_name("config.json");
        let json = std::fs::read(file).ok().and_then(|text| serde_json::from_slice::<File>(&text).ok());
        let json = json.unwrap_or(File { norm_num_groups: 32, scaling_factor: 0.3611, shift_factor: 0.1159 });
        let config = Self {
            widths,
            blocks,
            latents: rows(&names, "encoder.conv_out").unwrap_or(0) / 2,
            groups: json.norm_num_groups,
            scale: json.scaling_factor,
            shift: json.shift_factor,
        };
        let groups = config.groups;
        if config.widths.len() != LEVELS || config.latents == 0 {
            return Err(source.wrong(
                "the file is not an autoencoder of Flux.1: it needs `encoder.down.0.block.0.conv1.weight` and three further levels, or `encoder.down_blocks.0.resnets.0.conv1.weight`",
            ));
        }
        if groups == 0 || config.widths.iter().any(|width| width % groups != 0) || config.scale == 0.0 {
            return Err(source.wrong(format!(
                "the channel counts {:?} must be multiples of the number of groups ({groups}), and the scale ({}) must not be 0",
                config.widths, config.scale
            )));
        }
        Ok((names, config))
    }
}

/// Number of picture sizes inside the network. Width and height are halved three times, to an eighth of the full
/// size.
const LEVELS: usize = 4;

/// Converts the names of parts to the names used in a file. This crate uses the names of the model's authors; a
/// file may use the names of `diffusers`.
struct Names {
    original: bool,
    levels: usize,
}

impl Names {
    fn of(&self, name: &str) -> String {
        if self.original {
            return name.to_owned();
        }
        let mut words = Vec::new();
        let mut parts = name.split('.').peekable();
        while let Some(part) = parts.next() {
            let mut index = || parts.next().unwrap_or_default().to_owned();
            match part {
                "down" => words.extend(["down_blocks".to_owned(), index()]),
                // The authors number levels by size, `diffusers` in the order of use.
                "up" => {
                    let level: usize = index().parse().unwrap_or(0);
                    words.extend(["up_blocks".to_owned(), (self.levels.max(1) - 1 - level).to_string()]);
                }
                "block" => words.extend(["resnets".to_owned(), index()]),
                _ => words.push(match part {
                    "mid" => "mid_block".to_owned(),
                    "block_1" => "resnets.0".to_owned(),
                    "block_2" => "resnets.1".to_owned(),
                    "attn_1" => "attentions.0".to_owned(),
                    "norm" => "group_norm".to_owned(),
                    "q" | "k" | "v" => format!("to_{part}"),
                    "proj_out" => "to_out.0".to_owned(),
                    "nin_shortcut" => "conv_shortcut".to_owned(),
                    "downsample" => "downsamplers.0".to_owned(),
                    "upsample" => "upsamplers.0".to_owned(),
                    "norm_out" => "conv_norm_out".to_owned(),
                    other => other.to_owned(),
                }),
            }
        }
        words.join(".")
    }
}

/// Requests the parts of an autoencoder from a loader.
struct Parts<'a, 'b> {
    loader: &'a mut Loader<'b>,
    names: &'a Names,
    groups: usize,
    dtype: DType,
}

impl Parts<'_, '_> {
    fn tensor(&mut self, name: &str, shape: &[usize]) -> Result<Tensor> {
        Ok(self.loader.tensor(name, shape)?.to_dtype(self.dtype)?)
    }

    fn conv(
        &mut self,
        name: &str,
        outputs: usize,
        inputs: usize,
        size: usize,
        stride: usize,
    ) -> Result<Conv> {
        let name = self.names.of(name);
        let weight = self.tensor(&format!("{name}.weight"), &[outputs, inputs, size, size])?;
        Conv::new(weight, self.tensor(&format!("{name}.bias"), &[outputs])?, stride)
    }

    fn norm(&mut self, name: &str, channels: usize) -> Result<Norm> {
        let name = self.names.of(name);
        Ok(Norm {
            groups: self.groups,
            scale: self.tensor(&format!("{name}.weight"), &[channels])?,
            shift: self.tensor(&format!("{name}.bias"), &[channels])?,
        })
    }

    /// Loads a linear layer that is applied to each pixel. In the authors' files, such a layer is a convolution
    /// with a 1 x 1 kernel.
    fn pixelwise(&mut self, name: &str, channels: usize) -> Result<Linear> {
        let name = self.names.of(name);
        let shape: &[usize] =
            if self.names.original { &[channels, channels, 1, 1] } else { &[channels, channels] };
        let weight = self.tensor(&format!("{name}.weight"), shape)?.reshape((channels, channels))?;
        let bias = self.tensor(&format!("{name}.bias"), &[channels])?;
        Ok(Linear::new(&name, Matrix::Plain(weight), bias))
    }

    fn residual(&mut self, name: &str, inputs: usize, outputs: usize) -> Result<Residual> {
        let shortcut =
            (inputs != outputs).then(|| self.conv(&format!("{name}.nin_shortcut"), outputs, inputs, 1, 1));
        Ok(Residual {
            shortcut: shortcut.transpose()?,
            norms: [
                self.norm(&format!("{name}.norm1"), inputs)?,
                self.norm(&format!("{name}.norm2"), outputs)?,
            ],
            convs: [
                self.conv(&format!("{name}.conv1"), outputs, inputs, 3, 1)?,
                self.conv(&format!("{name}.conv2"), outputs, outputs, 3, 1)?,
            ],
        })
    }

    fn middle(&mut self, side: &str, channels: usize) -> Result<Vec<Stage>> {
        let name = format!("{side}.mid.attn_1");
        let mut layer = |part: &str| self.pixelwise(&format!("{name}.{part}"), channels);
        let [q, k, v, out] = [layer("q")?, layer("k")?, layer("v")?, layer("proj_out")?];
        let attention = Attention { norm: self.norm(&format!("{name}.norm"), channels)?, q, k, v, out };
        Ok(vec![
            Stage::Residual(self.residual(&format!("{side}.mid.block_1"), channels, channels)?),
            Stage::Attention(Box::new(attention)),
            Stage::Residual(self.residual(&format!("{side}.mid.block_2"), channels, channels)?),
        ])
    }
}

struct Norm {
    groups: usize,
    scale: Tensor,
    shift: Tensor,
}

impl Norm {
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        group(x, self.groups, &self.scale, &self.shift)
    }
}

struct Residual {
    norms: [Norm; 2],
    convs: [Conv; 2],
    shortcut: Option<Conv>,
}

struct Attention {
    norm: Norm,
    q: Linear,
    k: Linear,
    v: Linear,
    out: Linear,
}

enum Stage {
    Conv(Conv),
    Residual(Residual),
    Attention(Box<Attention>),
    /// Doubles width and height by repeating each pixel.
    Double,
    /// The norm before the last convolution.
    Last(Norm),
}

impl Stage {
    fn forward(&self, x: &Tensor, edge: Edge, watch: &mut dyn Watch) -> Result<Tensor> {
        Ok(match self {
            Self::Conv(conv) => conv.forward(x, edge, watch)?,
            Self::Residual(block) => {
                let mut inner = x.clone();
                for (norm, conv) in block.norms.iter().zip(&block.convs) {
                    inner = conv.forward(&norm.forward(&inner)?.silu()?, edge, watch)?;
                }
                match &block.shortcut {
                    Some(conv) => (conv.forward(x, edge, watch)? + inner)?,
                    None => (x + inner)?,
                }
            }
            Self::Attention(block) => {
                let (channels, height, width) = x.dims3()?;
                let pixels = block.norm.forward(x)?.reshape((channels, height * width))?.t()?.contiguous()?;
                let one_head =
                    |layer: &Linear| -> Result<Tensor> { Ok(layer.forward(&pixels)?.unsqueeze(0)?) };
                let mixed = attention(
                    &one_head(&block.q)?,
                    &one_head(&block.k)?,
                    &one_head(&block.v)?,
                    MAX_SCORES,
                    watch,
                )?;
                (x + block.out.forward(&mixed)?.t()?.reshape((channels, height, width))?)?
            }
            Self::Double => {
                let (_, height, width) = x.dims3()?;
                x.unsqueeze(0)?.upsample_nearest2d(height * 2, width * 2)?.squeeze(0)?
            }
            Self::Last(norm) => norm.forward(x)?.silu()?,
        })
    }
}

/// The autoencoder of Flux.1.
pub struct Vae {
    config: VaeConfig,
    encoder: Vec<Stage>,
    decoder: Vec<Stage>,
}

impl Vae {
    /// Checks every key of a file. Returns the sizes of the autoencoder, and the number and sizes of its tensors.
    /// No weights are read.
    pub fn survey(path: &Path) -> Result<(VaeConfig, Tally)> {
        let source = Source::open(path)?;
        let (names, config) = VaeConfig::of(&source)?;
        let mut loader = Loader::survey(&source, Layout::Diffusers);
        Self::of(&mut loader, &names, config.clone(), DType::F32)?;
        Ok((config, loader.finish()?))
    }

    /// Reads the weights from a file in the layout of `diffusers` or of the model's authors (`ae.safetensors`).
    /// `dtype` is the type of the computation, f32 or f64, since 16-bit types overflow in this network.
    pub fn load(path: &Path, device: &Device, dtype: DType) -> Result<Self> {
        Self::survey(path)?;
        let source = Source::open(path)?;
        let (names, config) = VaeConfig::of(&source)?;
        let mut loader = Loader::new(&source, Layout::Diffusers, device);
        let vae = Self::of(&mut loader, &names, config, dtype)?;
        loader.finish()?;
        Ok(vae)
    }

    fn of(loader: &mut Loader<'_>, names: &Names, config: VaeConfig, dtype: DType) -> Result<Self> {
        let mut parts = Parts { loader, names, groups: config.groups, dtype };
        let VaeConfig { widths, blocks, latents, .. } = &config;
        let (blocks, latents) = (*blocks, *latents);
        let mut channels = widths[0];
        let mut encoder = vec![Stage::Conv(parts.conv("encoder.conv_in", channels, 3, 3, 1)?)];
        for (i, &width) in widths.iter().enumerate() {
            for j in 0..blocks {
                encoder.push(Stage::Residual(parts.residual(
                    &format!("encoder.down.{i}.block.{j}"),
                    channels,
                    width,
                )?));
                channels = width;
            }
            if i + 1 < widths.len() {
                let name = format!("encoder.down.{i}.downsample.conv");
                encoder.push(Stage::Conv(parts.conv(&name, width, width, 3, 2)?));
            }
        }
        encoder.extend(parts.middle("encoder", channels)?);
        encoder.push(Stage::Last(parts.norm("encoder.norm_out", channels)?));
        encoder.push(Stage::Conv(parts.conv("encoder.conv_out", 2 * latents, channels, 3, 1)?));

        let mut decoder = vec![Stage::Conv(parts.conv("decoder.conv_in", channels, latents, 3, 1)?)];
        decoder.extend(parts.middle("decoder", channels)?);
        for (i, &width) in widths.iter().enumerate().rev() {
            for j in 0..=blocks {
                decoder.push(Stage::Residual(parts.residual(
                    &format!("decoder.up.{i}.block.{j}"),
                    channels,
                    width,
                )?));
                channels = width;
            }
            if i > 0 {
                decoder.push(Stage::Double);
                let name = format!("decoder.up.{i}.upsample.conv");
                decoder.push(Stage::Conv(parts.conv(&name, width, width, 3, 1)?));
            }
        }
        decoder.push(Stage::Last(parts.norm("decoder.norm_out", channels)?));
        decoder.push(Stage::Conv(parts.conv("decoder.conv_out", 3, channels, 3, 1)?));
        Ok(Self { config, encoder, decoder })
    }

    /// The sizes of the autoencoder.
    pub fn config(&self) -> &VaeConfig {
        &self.config
    }

    /// Encodes a picture of shape 3 x height x width with values from -1 to 1. The width and height of the latents
    /// are an eighth of the width and height of the picture. The encoder computes a distribution and returns its
    /// mean, so that the same picture always gives the same latents.
    pub fn encode(&self, picture: &Tensor, edge: Edge, watch: &mut dyn Watch) -> Result<Tensor> {
        let mut x = picture.clone();
        for stage in &self.encoder {
            x = stage.forward(&x, edge, watch)?;
        }
        let latents = self.config.latents;
        let mean = x.narrow(0, 0, latents)?;
        watch.value("vae.encode.mean", &mean);
        watch.value("vae.encode.logvar", &x.narrow(0, latents, latents)?);
        let scaled = ((mean - self.config.shift)? * self.config.scale)?;
        watch.value("vae.latents_scaled", &scaled);
        Ok(scaled)
    }

    /// Decodes latents to a picture with values from about -1 to 1.
    pub fn decode(&self, latents: &Tensor, edge: Edge, watch: &mut dyn Watch) -> Result<Tensor> {
        let mut x = ((latents / self.config.scale)? + self.config.shift)?;
        for stage in &self.decoder {
            x = stage.forward(&x, edge, watch)?;
        }
        Ok(x)
    }
}
