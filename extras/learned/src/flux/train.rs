//! Training of a LoRA on pairs of pictures, with a frozen base model. As in the paper LightHarmony3D, the method is
//! DreamBooth (Ruiz et al. 2023) with one fixed prompt. The loss is the same as in the training of the base model
//! (flow matching, Esser et al. 2024).

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{DType, Tensor, Var};

use super::backward::Given;
use super::conv::Edge;
use super::error::{Error, Result};
use super::kontext::Kontext;
use super::latents::pack;
use super::linear::Update;
use super::modules::{linears, piece_rows};
use super::names::Layout;
use super::noise::{normal, normals, uniform};
use super::rope::grid;
use super::source::Source;
use super::watch::Watch;

/// Settings of the training of a LoRA.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrainSettings {
    /// Rank of every update.
    pub rank: usize,
    /// Determines the scale of each update, which is `alpha / rank * up * down`.
    pub alpha: f64,
    /// Learning rate. Each step changes a weight by about this amount.
    pub rate: f64,
    /// The strength of guidance during training; 1 for the published model.
    pub guidance: f32,
    /// Seed of the initial weights, the noise, and the order of the pairs.
    pub seed: u64,
}

/// Latents of a picture and of its target, each of shape channels x height x width.
#[derive(Debug, Clone)]
pub struct Pair {
    from: Tensor,
    to: Tensor,
}

/// An update that is being trained. For each of its two matrices, it also contains the two running means of the
/// Adam optimiser (Kingma and Ba 2015).
struct Adapter {
    /// Name of the layer in `diffusers`, without `transformer.`.
    module: String,
    rows: (usize, usize),
    layer: String,
    /// The matrices `down` and `up`.
    vars: [Var; 2],
    means: [[Tensor; 2]; 2],
}

/// A model and the LoRA that is being trained for it.
pub struct Trainer {
    kontext: Kontext,
    settings: TrainSettings,
    adapters: Vec<Adapter>,
    done: u64,
}

/// True if the layer `module` is trained. All layers of attention and of the perceptrons are trained; layers that
/// compute modulations are not.
fn trained(module: &str) -> bool {
    (module.starts_with("transformer_blocks.") || module.starts_with("single_transformer_blocks."))
        && !module.contains(".norm")
}

impl Trainer {
    /// Adds new updates to the model. Their `down` matrices are random and their `up` matrices are zero, so that
    /// the updates have no effect at first.
    pub fn new(mut kontext: Kontext, settings: TrainSettings) -> Result<Self> {
        let config = kontext.transformer.config().clone();
        let device = kontext.transformer.device().clone();
        let rank = settings.rank;
        if rank == 0 || rank > config.hidden {
            return Err(Error::Mismatch(format!(
                "the rank is {rank}; it must be from 1 to {}",
                config.hidden
            )));
        }
        let mut adapters = Vec::new();
        for (layer, rows, columns) in linears(&config) {
            let pieces = Layout::Diffusers.pieces(&layer);
            let mut start = 0;
            for (module, rows) in pieces.modules.iter().zip(piece_rows(&config, rows, pieces.modules.len())) {
                if trained(module) {
                    let stream = FIRST_WEIGHTS + adapters.len() as u64;
                    let spread = 1.0 / rank as f64;
                    let down = (normals(settings.seed, stream, (1, rank, columns), &device)? * spread)?
                        .squeeze(0)?;
                    let up = Tensor::zeros((rows, rank), DType::F32, &device)?;
                    let zeros =
                        |t: &Tensor| -> Result<[Tensor; 2]> { Ok([t.zeros_like()?, t.zeros_like()?]) };
                    adapters.push(Adapter {
                        module: module.clone(),
                        rows: (start, rows),
                        layer: layer.clone(),
                        means: [zeros(&down)?, zeros(&up)?],
                        vars: [Var::from_tensor(&down)?, Var::from_tensor(&up)?],
                    });
                }
                start += rows;
            }
        }
        let scale = settings.alpha / rank as f64;
        for layer in kontext.transformer.linears() {
            let name = layer.name().to_owned();
            for adapter in adapters.iter().filter(|adapter| adapter.layer == name) {
                let [down, up] = adapter.vars.each_ref().map(|var| var.as_tensor().clone());
                layer.update(Update { start: adapter.rows.0, down, up, scale })?;
            }
        }
        Ok(Self { kontext, settings, adapters, done: 0 })
    }

    /// Encodes two pictures of equal size, each of shape 3 x height x width with values from 0 to 1.
    pub fn pair(&self, from: &Tensor, to: &Tensor, watch: &mut dyn Watch) -> Result<Pair> {
        if from.dims() != to.dims() {
            return Err(Error::Mismatch(format!(
                "the two pictures of a pair differ in shape, {:?} and {:?}",
                to.dims(),
                from.dims()
            )));
        }
        let mut latents =
            |picture: &Tensor| self.kontext.vae.encode(&((picture * 2.0)? - 1.0)?, Edge::Wraps, watch);
        Ok(Pair { from: latents(from)?, to: latents(to)? })
    }

    /// Returns the loss at a noise level, and its gradients. The loss is the mean squared difference between the
    /// predicted velocity and the velocity along the straight path between picture and noise.
    fn gradients(
        &self,
        pair: &Pair,
        level: f32,
        stream: u64,
        watch: &mut dyn Watch,
    ) -> Result<(f32, Vec<Option<Tensor>>)> {
        let (_, height, width) = pair.to.dims3()?;
        let noise = normals(self.settings.seed, stream, pair.to.dims3()?, pair.to.device())?;
        let mixed = ((&pair.to * f64::from(1.0 - level))? + (&noise * f64::from(level))?)?;
        let wanted = pack(&(noise - &pair.to)?)?;
        let made = wanted.dim(0)?;
        let tokens = Tensor::cat(&[pack(&mixed)?, pack(&pair.from)?], 0)?;
        let places: Vec<_> =
            [0.0, 1.0].into_iter().flat_map(|frame| grid(frame, height / 2, width / 2)).collect();
        let (prompt, guidance) = (&self.kontext.prompt, self.settings.guidance);
        let given = Given { tokens: &tokens, places: &places, prompt, time: level, guidance };
        let loss = |velocity: &Tensor| -> Result<Tensor> {
            Ok((velocity.narrow(0, 0, made)? - &wanted)?.sqr()?.mean_all()?)
        };
        let vars: Vec<Var> = self.adapters.iter().flat_map(|adapter| adapter.vars.clone()).collect();
        self.kontext.transformer.gradients(&given, &vars, &loss, watch)
    }

    /// The current loss of a pair, averaged over four noise levels. The noise is the same in every call, so the
    /// result can be used to monitor the training.
    pub fn loss(&self, pair: &Pair, watch: &mut dyn Watch) -> Result<f32> {
        let mut sum = 0.0;
        for (i, level) in [0.2, 0.4, 0.6, 0.8].into_iter().enumerate() {
            sum += self.gradients(pair, level, PROBES + i as u64, watch)?.0;
        }
        Ok(sum / 4.0)
    }

    /// Performs one training step on a pair and returns the loss of the pair at a random noise level. The level is
    /// drawn from a logit-normal distribution.
    pub fn step(&mut self, pair: &Pair, watch: &mut dyn Watch) -> Result<f32> {
        let level = 1.0 / (1.0 + libm::exp(-normal(self.settings.seed, LEVELS, self.done)));
        let (loss, gradients) = self.gradients(pair, level as f32, self.done, watch)?;
        // The gradients, taken as one vector, are limited to length 1, so that a rare large gradient does no harm.
        let mut square = 0.0;
        for gradient in gradients.iter().flatten() {
            square += f64::from(gradient.sqr()?.sum_all()?.to_scalar::<f32>()?);
        }
        if !square.is_finite() || !loss.is_finite() {
            return Err(Error::Mismatch(format!(
                "the training failed, because the loss is {loss}; use a lower learning rate"
            )));
        }
        let clip = 1.0 / square.sqrt().max(1.0);
        self.done += 1;
        let (first, second) = (0.9, 0.999);
        let settled = |decay: f64| 1.0 - libm::pow(decay, self.done as f64);
        let (settled_first, settled_second) = (settled(first), settled(second));
        let all = self.adapters.iter_mut().flat_map(|adapter| adapter.vars.iter().zip(&mut adapter.means));
        for ((var, [mean, spread]), gradient) in all.zip(gradients) {
            let Some(gradient) = gradient else { continue };
            let gradient = (gradient * clip)?;
            *mean = ((&*mean * first)? + (&gradient * (1.0 - first))?)?;
            *spread = ((&*spread * second)? + (gradient.sqr()? * (1.0 - second))?)?;
            let length = ((&*spread / settled_second)?.sqrt()? + 1e-8)?;
            let change = ((&*mean / settled_first)? / length)?;
            var.set(&(var.as_tensor() - (change * self.settings.rate)?)?)?;
        }
        Ok(loss)
    }

    /// Number of steps that have been performed.
    pub fn done(&self) -> u64 {
        self.done
    }

    /// Index of the pair to use in the next step, where `count` is the number of pairs. Each round of `count` steps
    /// uses every pair once, in an order that differs from round to round.
    pub fn next(&self, count: usize) -> usize {
        let (round, turn) = (self.done / count as u64, self.done % count as u64);
        let mut order: Vec<usize> = (0..count).collect();
        for i in (1..count).rev() {
            let other = uniform(self.settings.seed, ORDER + round, i as u64) * (i + 1) as f64;
            order.swap(i, other as usize);
        }
        order[turn as usize]
    }

    /// Writes the LoRA in the layout of `diffusers` and peft, which [`Lora`](super::Lora) can read.
    pub fn save(&self, path: &Path) -> Result<()> {
        let tensors = self.adapters.iter().flat_map(|adapter| {
            let [down, up] = adapter.vars.each_ref().map(|var| var.as_tensor().clone());
            let name = |part: &str| format!("transformer.{}.{part}.weight", adapter.module);
            [(name("lora_A"), down), (name("lora_B"), up)]
        });
        let mut modules: Vec<&str> = self.adapters.iter().map(|adapter| adapter.module.as_str()).collect();
        modules.sort_unstable();
        let metadata = serde_json::json!({
            "transformer.peft_type": "LORA",
            "transformer.r": self.settings.rank,
            "transformer.lora_alpha": self.settings.alpha,
            // peft reads these without checking whether they exist.
            "transformer.rank_pattern": {},
            "transformer.alpha_pattern": {},
            "transformer.target_modules": modules,
            "transformer.bias": "none",
            "transformer.lora_dropout": 0.0,
        });
        let header = [("format", "pt".to_owned()), ("lora_adapter_metadata", metadata.to_string())];
        write(path, tensors.collect(), &header)
    }

    /// Writes the state that is needed to continue the training later. `learned_from` identifies the model and the
    /// pairs.
    pub fn save_state(&self, path: &Path, learned_from: &str) -> Result<()> {
        let mut tensors = Vec::new();
        for (i, adapter) in self.adapters.iter().enumerate() {
            for (j, (var, means)) in adapter.vars.iter().zip(&adapter.means).enumerate() {
                tensors.push((format!("{i}.{j}.value"), var.as_tensor().clone()));
                tensors.push((format!("{i}.{j}.mean"), means[0].clone()));
                tensors.push((format!("{i}.{j}.spread"), means[1].clone()));
            }
        }
        let settings = format!("{:?}", self.settings);
        let from = learned_from.to_owned();
        write(path, tensors, &[("done", self.done.to_string()), ("settings", settings), ("from", from)])
    }

    /// Continues from a state that [`Trainer::save_state`] wrote with the same settings and data. The result is the
    /// same as if the training had not been interrupted.
    pub fn load_state(&mut self, path: &Path, learned_from: &str) -> Result<()> {
        let source = Source::open(path)?;
        let said = source.metadata().get("settings");
        let settings = format!("{:?}", self.settings);
        if said != Some(&settings) {
            let said = said.map_or("unknown settings", String::as_str);
            return Err(source.wrong(format!(
                "the file belongs to a training run with other settings (in the file: {said}; now: {settings}); remove the file to start again"
            )));
        }
        if source.metadata().get("from").map(String::as_str) != Some(learned_from) {
            return Err(source.wrong("the file belongs to a training run with different panoramas or a different width, prompt or model; remove the file to start again"));
        }
        let done = source.metadata().get("done").and_then(|text| text.parse().ok());
        self.done =
            done.ok_or_else(|| source.wrong("the file does not contain the number of finished steps"))?;
        let device = self.kontext.transformer.device();
        for (i, adapter) in self.adapters.iter_mut().enumerate() {
            for (j, (var, means)) in adapter.vars.iter().zip(&mut adapter.means).enumerate() {
                let read = |part: &str| -> Result<Tensor> {
                    let name = format!("{i}.{j}.{part}");
                    if source.shape(&name) != Some(var.dims()) {
                        return Err(source.wrong(format!("the shape of `{name}` does not match the model")));
                    }
                    source.read_f32(&name, device)
                };
                var.set(&read("value")?)?;
                *means = [read("mean")?, read("spread")?];
            }
        }
        Ok(())
    }
}

// Streams of random numbers. The steps use the streams from 0 up.
const FIRST_WEIGHTS: u64 = 1 << 40;
const LEVELS: u64 = 1 << 41;
const PROBES: u64 = 1 << 42;
const ORDER: u64 = 1 << 43;

/// Writes a safetensors file completely or not at all. The same tensors always give the same bytes.
fn write(path: &Path, tensors: Vec<(String, Tensor)>, metadata: &[(&str, String)]) -> Result<()> {
    let tensors: BTreeMap<String, Tensor> = tensors.into_iter().collect();
    let text: serde_json::Map<_, _> =
        metadata.iter().map(|(key, value)| ((*key).to_owned(), value.as_str().into())).collect();
    let mut header = serde_json::Map::from_iter([("__metadata__".to_owned(), text.into())]);
    let mut data = Vec::new();
    for (name, tensor) in &tensors {
        let start = data.len();
        for value in tensor.flatten_all()?.to_vec1::<f32>()? {
            data.extend(value.to_le_bytes());
        }
        let entry = serde_json::json!({ "dtype": "F32", "shape": tensor.dims(), "data_offsets": [start, data.len()] });
        header.insert(name.clone(), entry);
    }
    let mut text = serde_json::Value::from(header).to_string();
    // Readers map files into memory and want numbers aligned.
    text.extend(std::iter::repeat_n(' ', text.len().next_multiple_of(8) - text.len()));
    let bytes = [&(text.len() as u64).to_le_bytes()[..], text.as_bytes(), &data].concat();
    let temporary = path.with_added_extension("tmp");
    std::fs::write(&temporary, bytes).map_err(Error::io(&temporary))?;
    std::fs::rename(&temporary, path).map_err(Error::io(path))
}
