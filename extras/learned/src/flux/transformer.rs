//! The network that predicts the velocity of a noisy picture (Flux.1 Kontext, Black Forest Labs, 2025).

use candle_core::{DType, Device, Tensor};

use super::block::{Double, Shared, Single, modulation, silu};
use super::config::Config;
use super::error::{Error, Result};
use super::linear::Linear;
use super::loader::{Loader, Tally};
use super::lora::Lora;
use super::norm::modulated;
use super::prompt::Prompt;
use super::rope::{Place, Rotations};
use super::source::Source;
use super::watch::Watch;

/// Two linear layers with the activation function silu between them. They compute the embedding of a number or of a
/// vector.
struct Embedder {
    inward: Linear,
    outward: Linear,
}

impl Embedder {
    fn load(loader: &mut Loader<'_>, name: &str, columns: usize, hidden: usize) -> Result<Self> {
        Ok(Self {
            inward: loader.linear(&format!("{name}.in_layer"), hidden, columns)?,
            outward: loader.linear(&format!("{name}.out_layer"), hidden, hidden)?,
        })
    }

    fn linears(&mut self) -> impl Iterator<Item = &mut Linear> {
        [&mut self.inward, &mut self.outward].into_iter()
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.outward.forward(&silu(&self.inward.forward(x)?)?)
    }
}

/// The transformer of Flux.1 Kontext.
pub struct Transformer {
    config: Config,
    device: Device,
    dtype: DType,
    img_in: Linear,
    txt_in: Linear,
    time_in: Embedder,
    vector_in: Embedder,
    guidance_in: Option<Embedder>,
    pub(super) doubles: Vec<Double>,
    pub(super) singles: Vec<Single>,
    last_modulation: Linear,
    last: Linear,
}

impl Transformer {
    /// Checks that a file contains exactly the keys that the model needs, and counts the weights. No weights are
    /// read.
    pub fn survey(source: &Source) -> Result<(Config, Tally)> {
        let (layout, config) = Config::of(source)?;
        let mut loader = Loader::survey(source, layout);
        Self::of(&mut loader, config.clone(), &Device::Cpu, DType::F32)?;
        Ok((config, loader.finish()?))
    }

    /// Reads the weights, which stay in memory in the type that they have in the file. `dtype` is the type of the
    /// computation: f32, or bf16 on a GPU.
    pub fn load(source: &Source, device: &Device, dtype: DType) -> Result<Self> {
        Self::survey(source)?;
        let (layout, config) = Config::of(source)?;
        let mut loader = Loader::new(source, layout, device);
        let transformer = Self::of(&mut loader, config, device, dtype)?;
        loader.finish()?;
        Ok(transformer)
    }

    fn of(loader: &mut Loader<'_>, config: Config, device: &Device, dtype: DType) -> Result<Self> {
        let Config { hidden, in_channels, .. } = config;
        let guidance = config.guidance.then(|| Embedder::load(loader, "guidance_in", config.time, hidden));
        Ok(Self {
            guidance_in: guidance.transpose()?,
            img_in: loader.linear("img_in", hidden, in_channels)?,
            txt_in: loader.linear("txt_in", hidden, config.context)?,
            time_in: Embedder::load(loader, "time_in", config.time, hidden)?,
            vector_in: Embedder::load(loader, "vector_in", config.pooled, hidden)?,
            doubles: (0..config.double_blocks)
                .map(|i| Double::load(loader, &config, i))
                .collect::<Result<_>>()?,
            singles: (0..config.single_blocks)
                .map(|i| Single::load(loader, &config, i))
                .collect::<Result<_>>()?,
            last_modulation: loader.linear("final_layer.adaLN_modulation.1", 2 * hidden, hidden)?,
            last: loader.linear("final_layer.linear", in_channels, hidden)?,
            device: device.clone(),
            dtype,
            config,
        })
    }

    /// The sizes of the transformer.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The device on which the weights are stored.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Every linear layer.
    pub fn linears(&mut self) -> impl Iterator<Item = &mut Linear> {
        let embedders = [&mut self.time_in, &mut self.vector_in].into_iter().chain(&mut self.guidance_in);
        [&mut self.img_in, &mut self.txt_in, &mut self.last_modulation, &mut self.last]
            .into_iter()
            .chain(embedders.flat_map(Embedder::linears))
            .chain(self.doubles.iter_mut().flat_map(Double::linears))
            .chain(self.singles.iter_mut().flat_map(Single::linears))
    }

    /// Adds a LoRA. At `strength` 1, it has the effect for which it was trained. The effects of several LoRAs add
    /// up.
    pub fn attach(&mut self, lora: &Lora, strength: f64) -> Result<()> {
        for layer in self.linears() {
            for mut update in lora.updates(layer.name()) {
                update.scale *= strength;
                layer.update(update)?;
            }
        }
        Ok(())
    }

    /// Predicts the velocity of every token of the new picture, in f32. The result has the shape tokens x
    /// in_channels. `tokens` contains the tokens of the new picture followed by the tokens of the original picture,
    /// and `places` contains the place of each of these tokens. `time` is the noise level of the new picture: 1 for
    /// pure noise, 0 for no noise.
    pub fn forward(
        &self,
        tokens: &Tensor,
        places: &[Place],
        prompt: &Prompt,
        time: f32,
        guidance: f32,
        watch: &mut dyn Watch,
    ) -> Result<Tensor> {
        let Begun { rotations, mood, mut txt, mut img } =
            self.begin(tokens, places, prompt, time, guidance, watch)?;
        let shared = Shared { mood, rotations: &rotations, head: self.config.head() };
        for (k, block) in self.doubles.iter().enumerate() {
            watch.check()?;
            (txt, img) = block.forward(&txt, &img, &shared, watch)?;
            watch.value(&format!("step0.transformer_blocks.{k}.txt"), &txt);
            watch.value(&format!("step0.transformer_blocks.{k}.img"), &img);
        }
        let (texts, pictures) = (txt.dim(0)?, img.dim(0)?);
        let mut both = Tensor::cat(&[&txt, &img], 0)?;
        for (k, block) in self.singles.iter().enumerate() {
            watch.check()?;
            both = block.forward(&both, &shared, watch)?;
            let name = |part: &str| format!("step0.single_transformer_blocks.{k}.{part}");
            watch.value(&name("txt"), &both.narrow(0, 0, texts)?);
            watch.value(&name("img"), &both.narrow(0, texts, pictures)?);
        }
        self.end(&both.narrow(0, texts, pictures)?, &shared, watch)
    }

    /// Computes the inputs of the first block.
    pub(super) fn begin(
        &self,
        tokens: &Tensor,
        places: &[Place],
        prompt: &Prompt,
        time: f32,
        guidance: f32,
        watch: &mut dyn Watch,
    ) -> Result<Begun> {
        let texts = prompt.text.dim(0)?;
        if tokens.dim(0)? != places.len() {
            return Err(Error::Mismatch(format!(
                "there are {} tokens, but {} positions",
                tokens.dim(0)?,
                places.len()
            )));
        }
        let all: Vec<Place> = std::iter::repeat_n([0.0; 3], texts).chain(places.iter().copied()).collect();
        let rotations = Rotations::new(&all, self.config.axes, &self.device)?;
        watch.value("step0.pos_embed.cos", &rotations.cos);
        watch.value("step0.pos_embed.sin", &rotations.sin);
        let embedded = |t: f32| -> Result<Tensor> {
            Ok(time_embedding(t, self.config.time, &self.device)?.to_dtype(self.dtype)?)
        };
        let mut mood = self.time_in.forward(&embedded(time)?)?;
        if let Some(layer) = &self.guidance_in {
            mood = (mood + layer.forward(&embedded(guidance)?)?)?;
        }
        mood = (mood + self.vector_in.forward(&prompt.pooled.to_dtype(self.dtype)?)?)?;
        watch.value("step0.time_text_embed", &mood);
        let img = self.img_in.forward(&tokens.to_dtype(self.dtype)?)?;
        let txt = self.txt_in.forward(&prompt.text.to_dtype(self.dtype)?)?;
        watch.value("step0.x_embedder", &img);
        watch.value("step0.context_embedder", &txt);
        Ok(Begun { rotations, mood: silu(&mood)?, txt, img })
    }

    /// Computes the velocity from the output of the last block.
    pub(super) fn end(&self, img: &Tensor, shared: &Shared<'_>, watch: &mut dyn Watch) -> Result<Tensor> {
        let [shift, scale] = modulation(&self.last_modulation, &shared.mood)?;
        let img = modulated(img, &scale, &shift)?;
        watch.value("step0.norm_out", &img);
        Ok(self.last.forward(&img)?.to_dtype(DType::F32)?)
    }
}

/// Inputs of the first block.
pub(super) struct Begun {
    pub rotations: Rotations,
    pub mood: Tensor,
    pub txt: Tensor,
    pub img: Tensor,
}

/// Embedding of a noise level, of shape 1 x width: the cosines and then the sines of 1000 `t`, at frequencies from
/// 1 down to 1/10000. Angles are rounded to f32 as in the reference implementation, because an f32 angle of 1000
/// radians is accurate only to 6e-5.
fn time_embedding(t: f32, width: usize, device: &Device) -> Result<Tensor> {
    let half = width / 2;
    let ln = libm::log(10_000.0) as f32;
    let angles = (0..half).map(|i| {
        let frequency = libm::exp(f64::from(-ln * i as f32 / half as f32)) as f32;
        f64::from(t * 1000.0 * frequency)
    });
    let (mut values, sines): (Vec<f32>, Vec<f32>) =
        angles.map(|angle| (libm::cos(angle) as f32, libm::sin(angle) as f32)).unzip();
    values.extend(sines);
    Ok(Tensor::from_vec(values, (1, width), device)?)
}
