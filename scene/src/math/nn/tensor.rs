//! Feature maps.

/// Feature maps in f32: channel by channel, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Number of feature maps.
    pub channels: usize,
    /// Height of each map, in pixels.
    pub height: usize,
    /// Width of each map, in pixels.
    pub width: usize,
    /// The values, in the order of map, row and column.
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
