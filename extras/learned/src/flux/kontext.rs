//! Editing of a picture. First, the picture is encoded to latents. Then noise is converted to new latents in
//! several steps, with the latents of the picture as a second input. Finally, the new latents are decoded to a
//! picture.

use std::path::PathBuf;

use candle_core::{DType, Device, Tensor};

use super::conv::Edge;
use super::error::{Error, Result};
use super::latents::{half_turned, pack, unpack};
use super::lora::Lora;
use super::noise::normals;
use super::prompt::Prompt;
use super::rope::grid;
use super::schedule::noise_levels;
use super::source::Source;
use super::transformer::Transformer;
use super::vae::Vae;
use super::watch::Watch;

/// The files of a model.
#[derive(Debug, Clone)]
pub struct Files {
    /// The transformer: a GGUF file, or a safetensors file with the tensor names of the model's authors or of
    /// `diffusers`. If the model is split into several safetensors files (shards), this is the path of the first
    /// shard.
    pub transformer: PathBuf,
    /// The autoencoder, a safetensors file.
    pub vae: PathBuf,
    /// The encoded prompt; see [`Prompt::read`].
    pub prompt: PathBuf,
    /// LoRAs, each with its strength.
    pub loras: Vec<(PathBuf, f64)>,
}

/// Settings of an edit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Number of steps from noise to picture.
    pub steps: usize,
    /// Strength with which the model follows the prompt. The strength is an input of the network.
    pub guidance: f32,
    /// Seed of the noise.
    pub seed: u64,
    /// True if the left and right edges of the picture are neighbours. Convolutions then wrap around. Attention
    /// still treats the edges as far apart, so every step is computed twice: once on the picture, and once on the
    /// picture rotated by half a turn. Each part of the result comes from the pass in which it is closer to the
    /// middle, with a smooth transition.
    pub seamless: bool,
}

impl Settings {
    fn edge(&self) -> Edge {
        if self.seamless { Edge::Wraps } else { Edge::Zeros }
    }
}

/// Flux.1 Kontext with its LoRAs and its prompt.
pub struct Kontext {
    pub(super) transformer: Transformer,
    pub(super) vae: Vae,
    pub(super) prompt: Prompt,
}

impl Kontext {
    /// Loads all files. `dtype` is the number type in which the transformer computes.
    pub fn load(files: &Files, device: &Device, dtype: DType) -> Result<Self> {
        // Small files are read first, so that errors in them are reported before 24 GB are read.
        let source = Source::open(&files.transformer)?;
        let (config, _) = Transformer::survey(&source)?;
        let prompt = Prompt::read(&files.prompt, &config, device)?;
        let mut loras = Vec::new();
        for (path, strength) in &files.loras {
            loras.push((Lora::read(path, &config, device)?, *strength));
        }
        let vae = Vae::load(&files.vae, device, DType::F32)?;
        if vae.config().latents * 4 != config.in_channels {
            return Err(Error::file(
                &files.vae,
                format!(
                    "the latents of the autoencoder have {} channels, but `{}` needs {}",
                    vae.config().latents,
                    files.transformer.display(),
                    config.in_channels / 4
                ),
            ));
        }
        let mut transformer = Transformer::load(&source, device, dtype)?;
        for (lora, strength) in &loras {
            transformer.attach(lora, *strength)?;
        }
        Ok(Self { transformer, vae, prompt })
    }

    /// The noise from which the edit of a picture of this size starts. Different pairs of `seed` and `stream` give
    /// different noise.
    pub fn noise(&self, width: usize, height: usize, seed: u64, stream: u64) -> Result<Tensor> {
        let shape = (self.vae.config().latents, height / 8, width / 8);
        normals(seed, stream, shape, self.transformer.device())
    }

    /// Edits a picture. Returns a picture of the same size, with values from 0 to 1. `picture` has the shape 3 x
    /// height x width and display-encoded values from 0 to 1. Width and height must be multiples of 16; the width
    /// of a seamless picture must be a multiple of 32. `noise` comes from [`Kontext::noise`].
    pub fn edit(
        &self,
        picture: &Tensor,
        noise: &Tensor,
        settings: &Settings,
        watch: &mut dyn Watch,
    ) -> Result<Tensor> {
        let (_, height, width) = picture.dims3()?;
        let unit = if settings.seamless { 32 } else { 16 };
        if height == 0 || width == 0 || height % 16 != 0 || width % unit != 0 {
            return Err(Error::Mismatch(format!(
                "cannot edit a picture of {width} x {height} pixels: the height must be a multiple of 16, and the width a multiple of {unit}"
            )));
        }
        // Encoding and decoding take about as long as a step.
        let whole = (settings.steps + 2) as f64;
        let condition = self.vae.encode(&((picture * 2.0)? - 1.0)?, settings.edge(), watch)?;
        let latents = self.denoise(
            &condition,
            noise,
            settings,
            &mut Span { watch, from: 1.0 / whole, to: 1.0 - 1.0 / whole },
        )?;
        let made = self.decode(&latents, settings, watch)?;
        watch.value("image_out", &made);
        watch.progress(1.0);
        Ok(made)
    }

    /// Decodes latents to a picture, with values from 0 to 1.
    pub fn decode(&self, latents: &Tensor, settings: &Settings, watch: &mut dyn Watch) -> Result<Tensor> {
        let made = self.vae.decode(latents, settings.edge(), watch)?;
        if !made.abs()?.sum_all()?.to_scalar::<f32>()?.is_finite() {
            let what = "the output of the model contains NaN or infinity; its weights, the LoRA or the prompt may be damaged";
            return Err(Error::Mismatch(what.to_owned()));
        }
        Ok(((made * 0.5)? + 0.5)?.clamp(0.0, 1.0)?)
    }

    /// Turns noise into the latents of an edited picture. `condition` contains the latents of the original picture.
    /// All latents have the shape channels x height x width.
    pub fn denoise(
        &self,
        condition: &Tensor,
        noise: &Tensor,
        settings: &Settings,
        watch: &mut dyn Watch,
    ) -> Result<Tensor> {
        let (_, height, width) = condition.dims3()?;
        let (rows, columns, made) = (height / 2, width / 2, height / 2 * (width / 2));
        let (condition, mut tokens) = (pack(condition)?, pack(noise)?);
        watch.value("cond_packed", &condition);
        let places: Vec<_> = [0.0, 1.0].into_iter().flat_map(|frame| grid(frame, rows, columns)).collect();
        let levels = noise_levels(settings.steps, made);
        for (step, pair) in levels.windows(2).enumerate() {
            watch.progress(step as f64 / settings.steps as f64);
            let mut velocity = |tokens: &Tensor, condition: &Tensor| -> Result<Tensor> {
                let both = Tensor::cat(&[tokens, condition], 0)?;
                let guidance = settings.guidance;
                let out = self.transformer.forward(&both, &places, &self.prompt, pair[0], guidance, watch)?;
                watch.value(&format!("transformer_out_step{step}"), &out);
                Ok(out.narrow(0, 0, made)?)
            };
            let mut way = velocity(&tokens, &condition)?;
            if settings.seamless {
                let turned = |t: &Tensor| half_turned(t, rows, columns);
                let other = turned(&velocity(&turned(&tokens)?, &turned(&condition)?)?)?;
                let share = middle(rows, columns, way.device())?;
                way = (&other + (way - &other)?.broadcast_mul(&share)?)?;
            }
            // Computed in f32, like the levels.
            tokens = (tokens + (way * f64::from(pair[1] - pair[0]))?)?;
            watch.value(&format!("latents_after_step{step}"), &tokens);
        }
        unpack(&tokens, rows, columns)
    }

    /// Darkens a picture step by step. Returns `passes` pictures: the first is an edit of `picture`, and each
    /// further picture is an edit of the picture before it.
    pub fn darker(
        &self,
        picture: &Tensor,
        passes: usize,
        settings: &Settings,
        watch: &mut dyn Watch,
    ) -> Result<Vec<Tensor>> {
        let (_, height, width) = picture.dims3()?;
        let mut made: Vec<Tensor> = Vec::new();
        for pass in 0..passes {
            let noise = self.noise(width, height, settings.seed, pass as u64)?;
            let from = made.last().unwrap_or(picture);
            let share = |pass: usize| pass as f64 / passes as f64;
            let mut part = Span { watch, from: share(pass), to: share(pass + 1) };
            let next = self.edit(from, &noise, settings, &mut part)?;
            made.push(next);
        }
        Ok(made)
    }
}

/// Observer of one part of a computation. Maps the progress of the part, from 0 to 1, to the range from `from` to
/// `to` of the whole computation.
struct Span<'a> {
    watch: &'a mut dyn Watch,
    from: f64,
    to: f64,
}

impl Watch for Span<'_> {
    fn check(&mut self) -> Result<()> {
        self.watch.check()
    }

    fn progress(&mut self, done: f64) {
        self.watch.progress(self.from + (self.to - self.from) * done);
    }

    fn value(&mut self, name: &str, value: &Tensor) {
        self.watch.value(name, value);
    }
}

/// Weights of tokens, with the shape tokens x 1. They are 1 in the middle columns and 0 at the outer columns, with
/// ramps between. The ramps are an eighth of the width wide and centred a quarter of the width from the edges. The
/// weights of two tokens that are half a turn apart add up to 1.
fn middle(rows: usize, columns: usize, device: &Device) -> Result<Tensor> {
    let share = |column: usize| {
        let from_edge = column.min(columns - 1 - column) as f64 + 0.5;
        let (quarter, ramp) = (columns as f64 / 4.0, columns as f64 / 8.0);
        ((from_edge - quarter) / ramp + 0.5).clamp(0.0, 1.0) as f32
    };
    let line: Vec<f32> = (0..columns).map(share).collect();
    Ok(Tensor::from_vec(line.repeat(rows), (rows * columns, 1), device)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_halves_complete_each_other() -> Result<()> {
        for columns in [4, 8, 18, 90] {
            let share = middle(3, columns, &Device::Cpu)?;
            let sum = (&share + half_turned(&share, 3, columns)?)?.flatten_all()?.to_vec1::<f32>()?;
            assert!(sum.iter().all(|sum| (sum - 1.0).abs() < 1e-6), "{columns}: {sum:?}");
            assert_eq!(share.flatten_all()?.to_vec1::<f32>()?[0], 0.0);
        }
        Ok(())
    }
}
