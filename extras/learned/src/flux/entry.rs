//! Descriptions of the tensors in a file.

use candle_core::DType;
use candle_core::quantized::GgmlDType;

/// The format in which the numbers of a tensor are stored in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Plain numbers.
    Plain(DType),
    /// Blocks of quantised numbers.
    Blocks(GgmlDType),
}

/// Shape and location of a tensor in a file.
#[derive(Debug, Clone)]
pub struct Entry {
    /// Lengths of the axes, the outermost axis first, as in PyTorch.
    pub shape: Vec<usize>,
    /// Format in which the numbers are stored.
    pub format: Format,
    /// Index of the file that contains the tensor, among the files of the [`Source`](super::Source).
    pub(crate) file: usize,
    /// Offset of the data from the start of the file, in bytes.
    pub(crate) start: u64,
    /// Length of the data in bytes.
    pub bytes: u64,
}
