//! Linear layers and their low-rank updates. The weights stay in memory in the type that they have in the file.

use candle_core::quantized::QTensor;
use candle_core::{DType, Tensor};

use super::error::{Error, Result};

/// The weights of a layer, in the type that they have in the file. They are converted to the type of the
/// computation for each use, which costs little compared with the matrix product. The conversion is exact, unlike a
/// product that is computed with quantised numbers.
#[derive(Debug)]
pub enum Matrix {
    /// Weights that are not quantised.
    Plain(Tensor),
    /// Weights that are quantised in blocks.
    Blocks(QTensor),
}

impl Matrix {
    /// The number of rows and the number of columns.
    fn size(&self) -> Result<(usize, usize)> {
        Ok(match self {
            Self::Plain(tensor) => tensor.dims2()?,
            Self::Blocks(tensor) => tensor.shape().dims2()?,
        })
    }

    fn widened(&self, dtype: DType) -> Result<Tensor> {
        Ok(match self {
            Self::Plain(tensor) => tensor.to_dtype(dtype)?,
            Self::Blocks(tensor) => tensor.dequantize(&tensor.device())?.to_dtype(dtype)?,
        })
    }

    /// Returns a copy of the weights in f32.
    pub(crate) fn to_f32(&self) -> Result<Tensor> {
        self.widened(DType::F32)
    }
}

/// A low-rank update: `scale * up * down` is added to some rows of a layer's weights.
#[derive(Debug, Clone)]
pub struct Update {
    /// Index of the first row that the update changes.
    pub start: usize,
    /// The matrix `down`, in f32, of shape rank x columns.
    pub down: Tensor,
    /// The matrix `up`, in f32, of shape rows x rank.
    pub up: Tensor,
    /// Factor by which the update is multiplied: `strength * alpha / rank`.
    pub scale: f64,
}

/// A linear layer and its low-rank updates. The updates are applied separately and are not merged into the weights.
/// This costs slightly more work, in proportion to the rank. In return, the updates are not rounded to the type of
/// the weights, and quantised weights and training need no special case.
#[derive(Debug)]
pub struct Linear {
    name: String,
    weight: Matrix,
    bias: Tensor,
    updates: Vec<Update>,
}

impl Linear {
    /// Creates a layer. `weight` has the shape rows x columns; `bias` has one number per row, in f32.
    pub fn new(name: &str, weight: Matrix, bias: Tensor) -> Self {
        Self { name: name.to_owned(), weight, bias, updates: Vec::new() }
    }

    /// The name of the layer, such as `double_blocks.0.img_attn.qkv`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Adds an update. Returns an error if the shapes of its matrices do not fit the layer.
    pub fn update(&mut self, update: Update) -> Result<()> {
        let (rows, columns) = self.weight.size()?;
        let ((up, rank), (down_rank, down)) = (update.up.dims2()?, update.down.dims2()?);
        if update.start + up > rows || rank != down_rank || down != columns {
            let name = &self.name;
            return Err(Error::Mismatch(format!(
                "an update with matrices of {up} x {rank} and {down_rank} x {down} does not fit the layer `{name}`, which has {rows} x {columns} weights"
            )));
        }
        self.updates.push(update);
        Ok(())
    }

    /// Applies the layer to `x`, which has the shape tokens x columns. The result has the shape tokens x rows and
    /// the type of `x`.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let dtype = x.dtype();
        let y = x.matmul(&self.weight.widened(dtype)?.t()?)?;
        let y = y.broadcast_add(&self.bias.to_dtype(dtype)?)?;
        if self.updates.is_empty() {
            return Ok(y);
        }
        // All updates are applied as one: the `down` matrices are stacked, and the `up` matrices placed side by
        // side, each at its rows.
        let rows = y.dim(1)?;
        let mut downs = Vec::new();
        let mut ups = Vec::new();
        for Update { start, down, up, scale } in &self.updates {
            downs.push(down.clone());
            let below = rows - start - up.dim(0)?;
            ups.push((up.pad_with_zeros(0, *start, below)? * *scale)?);
        }
        let low = x.to_dtype(DType::F32)?.matmul(&Tensor::cat(&downs, 0)?.t()?)?;
        let delta = low.matmul(&Tensor::cat(&ups, 1)?.t()?)?;
        Ok((y + delta.to_dtype(dtype)?)?)
    }
}
