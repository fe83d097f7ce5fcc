//! Loads the parts of a network from a weights file, and checks that every key is used.

use std::collections::BTreeSet;

use candle_core::{DType, Device, Tensor};

use super::entry::Format;
use super::error::{Result, some_of};
use super::linear::{Linear, Matrix};
use super::names::Layout;
use super::source::{Source, Stored};

/// Counts of the weights in a network, from which the required memory is estimated.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Number of tensors that were read.
    pub tensors: u64,
    /// Number of weights in these tensors.
    pub weights: u64,
    /// Number of bytes that stay in memory after loading.
    pub resident: u64,
    /// Number of weights in the largest matrix, which is converted to the type of the computation while it is used.
    pub largest: u64,
}

/// Supplies a network with the tensors of a [`Source`]. The network requests tensors by the names of its parts.
/// [`finish`](Self::finish) reports tensors that are missing, have a wrong shape or were never requested.
pub struct Loader<'a> {
    source: &'a Source,
    layout: Layout,
    device: &'a Device,
    /// True if tensors are only checked and counted, without reading their data.
    survey: bool,
    asked: BTreeSet<String>,
    wrong: Vec<String>,
    tally: Tally,
}

impl<'a> Loader<'a> {
    /// Creates a loader that reads tensors on request.
    pub fn new(source: &'a Source, layout: Layout, device: &'a Device) -> Self {
        let (asked, wrong, tally) = Default::default();
        Self { source, layout, device, survey: false, asked, wrong, tally }
    }

    /// Creates a loader that reads nothing and returns zeros, so that all keys of a file can be checked before any
    /// tensor is read.
    pub fn survey(source: &'a Source, layout: Layout) -> Self {
        Self { survey: true, ..Self::new(source, layout, &Device::Cpu) }
    }

    /// Loads a linear layer from two tensors: `module.weight`, of shape `rows` x `columns`, and `module.bias`, with
    /// `rows` numbers.
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

    /// Reads the scales of a norm, a vector of `length` numbers, in f32.
    pub fn scale(&mut self, module: &str, length: usize) -> Result<Tensor> {
        let key = self.layout.scale(module);
        self.rows(&[key], length, None)?.to_f32()
    }

    /// Reads the tensor with the name `key` in the file, in f32. Its shape must be `shape`.
    pub fn tensor(&mut self, key: &str, shape: &[usize]) -> Result<Tensor> {
        if self.wants(key, |there| there == shape) && !self.survey {
            self.source.read_f32(key, self.device)
        } else {
            nothing(shape)
        }
    }

    /// Reads the tensors called `keys` and concatenates them along their first axis.
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

    /// Looks for the tensor called `key`, and counts it if it exists. Returns true if `fits` accepts the shape of
    /// the tensor. Otherwise, records the problem for [`finish`](Self::finish).
    fn wants(&mut self, key: &str, fits: impl Fn(&[usize]) -> bool) -> bool {
        self.asked.insert(key.to_owned());
        let Some(entry) = self.source.entries().get(key) else {
            self.wrong.push(format!("`{key}` is missing"));
            return false;
        };
        let fit = fits(&entry.shape);
        if !fit {
            self.wrong.push(format!("`{key}` has the wrong shape {:?}", entry.shape));
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

    /// Ends loading. Returns an error if tensors are missing, have a wrong shape or were never requested; the error
    /// names them.
    pub fn finish(self) -> Result<Tally> {
        if !self.wrong.is_empty() {
            let shown = self.wrong.iter().take(6).cloned().collect::<Vec<_>>().join("; ");
            let what = format!(
                "the tensors in the file do not fit this model (problems: {}): {shown}",
                self.wrong.len()
            );
            return Err(self.source.wrong(what));
        }
        let left: Vec<&String> =
            self.source.entries().keys().filter(|key| !self.asked.contains(*key)).collect();
        if !left.is_empty() {
            let what = format!(
                "the file contains tensors that do not belong to this part of the model: {}. Supply a file that contains only this part",
                some_of(&left)
            );
            return Err(self.source.wrong(what));
        }
        Ok(self.tally)
    }
}

/// A tensor of zeros with this shape that takes almost no memory.
fn nothing(shape: &[usize]) -> Result<Tensor> {
    Ok(Tensor::zeros(1, DType::F32, &Device::Cpu)?.broadcast_as(shape)?)
}

/// Swaps the first half of the rows of a tensor with the second half.
pub(crate) fn swapped(tensor: &Tensor) -> Result<Tensor> {
    let half = tensor.dim(0)? / 2;
    Ok(Tensor::cat(&[tensor.narrow(0, half, half)?, tensor.narrow(0, 0, half)?], 0)?)
}
