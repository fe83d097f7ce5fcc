//! Forward pass of small convolutional networks. Every sum has a fixed order, so it gives the same bits on every
//! machine and for any number of threads. No tensor library is used, since in such libraries the order depends on
//! the machine.

mod conv;
mod weights;

pub use conv::{Conv, max_pool, relu};
pub use weights::Weights;

/// Feature maps in f32: channel by channel, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Number of maps.
    pub channels: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// All values.
    pub data: Vec<f32>,
}

impl Tensor {
    /// A tensor of zeros.
    pub fn new(channels: usize, height: usize, width: usize) -> Self {
        Self { channels, height, width, data: vec![0.0; channels * height * width] }
    }

    /// Row `y` of a channel.
    pub fn row(&self, channel: usize, y: usize) -> &[f32] {
        &self.data[(channel * self.height + y) * self.width..][..self.width]
    }
}
