//! From a file of weights to the parts of a network, each key accounted for.

use std::collections::BTreeSet;

use candle_core::{DType, Device, Tensor};

use super::error::{Result, some_of};
use super::linear::{Linear, Matrix};
use super::names::Layout;
use super::source::{Format, Source, Stored};

/// Memory of a network once it is loaded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Tensors read.
    pub tensors: u64,
    /// Weights in them.
    pub weights: u64,
    /// Bytes that stay in memory.
    pub resident: u64,
    /// The most weights in one matrix; it is widened to the type of the computation while it is used.
    pub largest: u64,
}

/// Passes the tensors of a [`Source`] to a network that requests them by its own names. Tensors that are missing,
/// have another shape or are never requested are an error at the end, with their names.
pub struct Loader<'a> {
    source: &'a Source,
    layout: Layout,
    device: &'a Device,
    /// Nothing is read; shapes are checked and counted.
    survey: bool,
    asked: BTreeSet<String>,
    wrong: Vec<String>,
    tally: Tally,
}

impl<'a> Loader<'a> {
    /// Reads the tensors as it is asked for them.
    pub fn new(source: &'a Source, layout: Layout, device: &'a Device) -> Self {
        let (asked, wrong, tally) = Default::default();
        Self { source, layout, device, survey: false, asked, wrong, tally }
    }

    /// Reads nothing and gives zeros, so that every key of a file can be checked before the first is read.
    pub fn survey(source: &'a Source, layout: Layout) -> Self {
        Self { survey: true, ..Self::new(source, layout, &Device::Cpu) }
    }

    /// `module.weight` of `rows` x `columns` and, where `bias`, `module.bias`.
    pub fn linear(&mut self, module: &str, rows: usize, columns: usize) -> Result<Linear> {
        let pieces = self.layout.pieces(module);
        let keys = |ending: &str| -> Vec<String> {
            pieces.modules.iter().map(|module| format!("{module}.{ending}")).collect()
        };
        let weight = self.rows(&keys("weight"), rows, Some(columns))?;
        let bias = self.rows(&keys("bias"), rows, None)?.to_f32()?;
        let (weight, bias) = if pieces.swapped {
            (Matrix::Plain(swapped(&weight.to_f32()?)?), swapped(&bias)?)
        } else {
            (weight, bias)
        };
        Ok(Linear::new(module, weight, bias))
    }

    /// The vector of scales of a norm, in f32.
    pub fn scale(&mut self, module: &str, length: usize) -> Result<Tensor> {
        let key = self.layout.scale(module);
        self.rows(&[key], length, None)?.to_f32()
    }

    /// A tensor of exactly this shape, in f32, by the name it has in the file.
    pub fn tensor(&mut self, key: &str, shape: &[usize]) -> Result<Tensor> {
        if self.wants(key, |there| there == shape) && !self.survey {
            self.source.read_f32(key, self.device)
        } else {
            nothing(shape)
        }
    }

    /// Tensors stacked by their first axis.
    fn rows(&mut self, keys: &[String], rows: usize, columns: Option<usize>) -> Result<Matrix> {
        let shape: Vec<usize> = [rows].into_iter().chain(columns).collect();
        let found: usize = keys.iter().filter_map(|key| self.source.shape(key)?.first()).sum();
        let mut sound = true;
        for key in keys {
            sound &= self.wants(key, |there| there.get(1..) == shape.get(1..) && found == rows);
        }
        if self.survey || !sound {
            return nothing(&shape).map(Matrix::Plain);
        }
        let mut parts = Vec::new();
        for key in keys {
            match self.source.read(key, self.device)? {
                Stored::Blocks(tensor) if keys.len() == 1 => return Ok(Matrix::Blocks(tensor)),
                Stored::Blocks(tensor) => parts.push(tensor.dequantize_f16(self.device)?),
                Stored::Plain(tensor) => parts.push(tensor),
            }
        }
        Ok(Matrix::Plain(if parts.len() == 1 { parts.remove(0) } else { Tensor::cat(&parts, 0)? }))
    }

    /// True if there is a fitting tensor of that name, which is counted.
    fn wants(&mut self, key: &str, fits: impl Fn(&[usize]) -> bool) -> bool {
        self.asked.insert(key.to_owned());
        let Some(entry) = self.source.entries().get(key) else {
            self.wrong.push(format!("`{key}` is missing"));
            return false;
        };
        let fit = fits(&entry.shape);
        if !fit {
            self.wrong.push(format!("`{key}` has shape {:?}", entry.shape));
        }
        let weights = entry.shape.iter().map(|n| *n as u64).product();
        self.tally.tensors += 1;
        self.tally.weights += weights;
        // Tensors other than matrices are kept in f32.
        let plain = entry.shape.len() != 2 && matches!(entry.format, Format::Plain(_));
        self.tally.resident += if plain { weights * 4 } else { entry.bytes };
        self.tally.largest = self.tally.largest.max(weights);
        fit
    }

    /// Ends loading: an error names the missing, unfitting and unused tensors.
    pub fn finish(self) -> Result<Tally> {
        if !self.wrong.is_empty() {
            let shown = self.wrong.iter().take(6).cloned().collect::<Vec<_>>().join("; ");
            let what =
                format!("{} of its tensors are not as this model needs them: {shown}", self.wrong.len());
            return Err(self.source.wrong(what));
        }
        let left: Vec<&String> =
            self.source.entries().keys().filter(|key| !self.asked.contains(*key)).collect();
        if !left.is_empty() {
            let what = format!(
                "{} of its tensors belong to no part of this model: {}. Give the file of this part alone",
                left.len(),
                some_of(&left)
            );
            return Err(self.source.wrong(what));
        }
        Ok(self.tally)
    }
}

/// Zeros that take no memory.
fn nothing(shape: &[usize]) -> Result<Tensor> {
    Ok(Tensor::zeros(1, DType::F32, &Device::Cpu)?.broadcast_as(shape)?)
}

/// The second half of the rows before the first.
pub(crate) fn swapped(tensor: &Tensor) -> Result<Tensor> {
    let half = tensor.dim(0)? / 2;
    Ok(Tensor::cat(&[tensor.narrow(0, half, half)?, tensor.narrow(0, 0, half)?], 0)?)
}
