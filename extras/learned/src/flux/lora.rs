//! LoRA files. They contain low-rank updates of the transformer, `alpha / rank * up * down` (Hu et al. 2022).

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{Device, Tensor};

use super::config::Config;
use super::error::{Result, some_of};
use super::linear::Update;
use super::loader::swapped;
use super::modules::{linears, piece_rows};
use super::names::Layout;
use super::source::Source;

/// The updates in one LoRA file, keyed by the name of the layer that they change.
#[derive(Debug)]
pub struct Lora {
    updates: BTreeMap<String, Vec<Update>>,
}

/// The part of the model that one module of a LoRA file changes: a range of rows of a layer.
#[derive(Clone)]
struct Target {
    module: String,
    start: usize,
    rows: usize,
    columns: usize,
    swapped: bool,
}

/// Names of the tensors of one module, as found in a LoRA file; `None` for a tensor that was not found.
#[derive(Default)]
struct ModuleTensors {
    down: Option<String>,
    up: Option<String>,
    alpha: Option<String>,
}

/// Prefixes of module names in files of `diffusers`, peft, kohya and other trainers.
const PREFIXES: [&str; 5] =
    ["transformer.", "base_model.model.", "diffusion_model.", "lora_unet_", "lora_transformer_"];

impl Lora {
    /// Reads a LoRA file in one of these layouts: `diffusers` and peft (`transformer.<module>.lora_A.weight`),
    /// kohya (`lora_unet_<module>.lora_down.weight`), or the names of the model's authors with either of these
    /// endings. A key that belongs to no layer of the model is an error, because its update would silently have no
    /// effect. The value of alpha is the tensor `<module>.alpha` if it exists, else `lora_alpha` in the header,
    /// else the rank, which gives a scale of 1.
    pub fn read(path: &Path, config: &Config, device: &Device) -> Result<Self> {
        let source = Source::open(path)?;
        let targets = targets(config);
        let mut found: BTreeMap<&str, ModuleTensors> = BTreeMap::new();
        let mut unknown = Vec::new();
        for key in source.entries().keys() {
            let Some((stem, ending)) = stem(key).filter(|(stem, _)| targets.contains_key(*stem)) else {
                unknown.push(key);
                continue;
            };
            let module = found.entry(stem).or_default();
            let slot = match ending {
                Ending::Down => &mut module.down,
                Ending::Up => &mut module.up,
                Ending::Alpha => &mut module.alpha,
            };
            if slot.replace(key.clone()).is_some() {
                return Err(source.wrong(format!(
                    "`{key}` and another tensor both define the same matrix, or the alpha, of a layer"
                )));
            }
        }
        if !unknown.is_empty() {
            return Err(source.wrong(format!(
                "the file contains tensors that change no layer of this model: {}. Is the file a LoRA for Flux.1?",
                some_of(&unknown)
            )));
        }
        if found.is_empty() {
            return Err(source.wrong("the file contains no update"));
        }
        let header = header_alpha(&source)?;
        let mut updates: BTreeMap<String, Vec<Update>> = BTreeMap::new();
        for (stem, module) in found {
            let Some(target) = targets.get(stem) else { continue };
            let update = target.update(&source, stem, &module, header, device)?;
            updates.entry(target.module.clone()).or_default().push(update);
        }
        Ok(Self { updates })
    }

    /// The updates of the layer `module`.
    pub fn updates(&self, module: &str) -> Vec<Update> {
        self.updates.get(module).cloned().unwrap_or_default()
    }

    /// Number of layers that the file changes.
    pub fn layers(&self) -> usize {
        self.updates.len()
    }
}

impl Target {
    fn update(
        &self,
        source: &Source,
        stem: &str,
        module: &ModuleTensors,
        header: Option<f64>,
        device: &Device,
    ) -> Result<Update> {
        let (Some(down), Some(up)) = (&module.down, &module.up) else {
            return Err(source.wrong(format!("one of the two matrices of `{stem}` is missing")));
        };
        let rank = match (source.shape(down), source.shape(up)) {
            (Some(&[rank, columns]), Some(&[rows, up_rank]))
                if rank == up_rank && rank > 0 && columns == self.columns && rows == self.rows =>
            {
                rank
            }
            (down, up) => {
                let (rows, columns) = (self.rows, self.columns);
                let (up, down) = (up.unwrap_or_default(), down.unwrap_or_default());
                return Err(source.wrong(format!(
                    "the matrices of the update of `{stem}` have shapes {up:?} and {down:?}; the layer has {rows} x {columns} weights"
                )));
            }
        };
        let alpha = match &module.alpha {
            Some(key) => {
                let values = source.read_f32(key, &Device::Cpu)?.flatten_all()?.to_vec1::<f32>()?;
                match values.as_slice() {
                    [alpha] if alpha.is_finite() => f64::from(*alpha),
                    _ => return Err(source.wrong(format!("`{key}` must be a single finite number"))),
                }
            }
            None => header.unwrap_or(rank as f64),
        };
        let matrix = |key: &str| -> Result<Tensor> {
            let tensor = source.read_f32(key, device)?;
            let sum = tensor.abs()?.sum_all()?.to_scalar::<f32>()?;
            if sum.is_finite() {
                Ok(tensor)
            } else {
                Err(source.wrong(format!("`{key}` contains NaN or infinity")))
            }
        };
        let up = matrix(up)?;
        Ok(Update {
            start: self.start,
            down: matrix(down)?,
            up: if self.swapped { swapped(&up)? } else { up },
            scale: alpha / rank as f64,
        })
    }
}

#[derive(Clone, Copy)]
enum Ending {
    Down,
    Up,
    Alpha,
}

/// Splits the name of a tensor into the name of the module, without a trainer's prefix, and the ending. Returns
/// `None` if the ending is unknown.
fn stem(key: &str) -> Option<(&str, Ending)> {
    const ENDINGS: [(&str, Ending); 5] = [
        (".lora_A.weight", Ending::Down),
        (".lora_down.weight", Ending::Down),
        (".lora_B.weight", Ending::Up),
        (".lora_up.weight", Ending::Up),
        (".alpha", Ending::Alpha),
    ];
    let (mut stem, ending) =
        ENDINGS.into_iter().find_map(|(text, ending)| Some((key.strip_suffix(text)?, ending)))?;
    while let Some(rest) = PREFIXES.iter().find_map(|prefix| stem.strip_prefix(prefix)) {
        stem = rest;
    }
    Some((stem, ending))
}

/// The target of each module name that a LoRA file can contain. The names include the names of both layouts, with
/// dots and with underscores.
fn targets(config: &Config) -> BTreeMap<String, Target> {
    let mut targets = BTreeMap::new();
    for (module, rows, columns) in linears(config) {
        for layout in [Layout::Original { prefix: "" }, Layout::Diffusers] {
            let pieces = layout.pieces(&module);
            let mut start = 0;
            for (name, rows) in pieces.modules.iter().zip(piece_rows(config, rows, pieces.modules.len())) {
                let target = Target { module: module.clone(), start, rows, columns, swapped: pieces.swapped };
                targets.insert(name.replace('.', "_"), target.clone());
                targets.insert(name.clone(), target);
                start += rows;
            }
        }
    }
    targets
}

/// Reads `lora_alpha` from the header. The library peft writes it into the JSON text `lora_adapter_metadata`.
fn header_alpha(source: &Source) -> Result<Option<f64>> {
    let Some(text) = source.metadata().get("lora_adapter_metadata") else { return Ok(None) };
    let json: serde_json::Value = serde_json::from_str(text).map_err(|error| {
        source.wrong(format!("`lora_adapter_metadata` in the header is not valid JSON: {error}"))
    })?;
    let field = |name: &str| json.get(format!("transformer.{name}")).or_else(|| json.get(name));
    for (unsupported, what) in [("use_dora", "DoRA"), ("use_rslora", "a scale of alpha / sqrt(rank)")] {
        if field(unsupported).and_then(serde_json::Value::as_bool) == Some(true) {
            return Err(source.wrong(format!(
                "the file uses {what}, which is not supported; train without `{unsupported}`"
            )));
        }
    }
    for pattern in ["alpha_pattern", "rank_pattern"] {
        let listed = field(pattern).and_then(serde_json::Value::as_object).is_some_and(|map| !map.is_empty());
        if pattern == "alpha_pattern" && listed {
            return Err(source.wrong(
                "the file sets alpha separately for some layers (`alpha_pattern`), which is not supported",
            ));
        }
    }
    Ok(field("lora_alpha").and_then(serde_json::Value::as_f64))
}
