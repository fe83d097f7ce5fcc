//! Maps of the sphere, and the layers of the networks that work on them. Every sum has a fixed order.

use super::super::scale;

/// Largest absolute value of an activation. It keeps all results finite for any finite weights, and is far above the
/// activations of trained networks.
const LARGEST: f32 = 1e4;

/// Values on the cells of an equirectangular map, from the zenith down, with the channels of a cell next to each other.
#[derive(Clone)]
pub struct Map {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub values: Vec<f32>,
}

/// An affine map from the channels of a cell, or of its neighbourhood, to other channels.
pub struct Layer {
    /// For each input, the weight of each output.
    weight: Vec<f32>,
    bias: Vec<f32>,
}

/// Leaky ReLU, limited.
pub fn activate(x: f32) -> f32 {
    scale::activate(x).clamp(-LARGEST, LARGEST)
}

impl Layer {
    pub fn new((weight, bias): (Vec<f32>, Vec<f32>)) -> Self {
        Self { weight, bias }
    }

    /// Adds the products of `inputs`, the first of which is number `first` of the layer, to `sums`.
    fn add(&self, sums: &mut [f32], inputs: &[f32], first: usize) {
        let outputs = self.bias.len();
        for (value, weights) in inputs.iter().zip(self.weight[first * outputs..].chunks_exact(outputs)) {
            sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += weight * value);
        }
    }

    /// The outputs for one cell.
    pub fn affine(&self, inputs: &[f32]) -> Vec<f32> {
        let mut sums = self.bias.clone();
        self.add(&mut sums, inputs, 0);
        sums
    }

    /// The outputs for each cell of a map, from the channels of this cell.
    pub fn cells(&self, map: &Map) -> Map {
        let values = map.values.chunks_exact(map.channels).flat_map(|cell| self.affine(cell)).collect();
        Map { channels: self.bias.len(), values, ..*map }
    }

    /// Convolution with 3 by 3 cells. Rows wrap around, and columns continue across a pole on the opposite meridian.
    pub fn convolved(&self, map: &Map) -> Map {
        let Map { width, height, channels, .. } = *map;
        let outputs = self.bias.len();
        let mut values = Vec::with_capacity(width * height * outputs);
        for y in 0..height {
            for x in 0..width {
                let start = values.len();
                values.extend_from_slice(&self.bias);
                for (tap, (row, column)) in (0..3).flat_map(|row| (0..3).map(move |x| (row, x))).enumerate() {
                    let across = y + row == 0 || y + row == height + 1;
                    let y = (y + row).saturating_sub(1).min(height - 1);
                    let x = (x + column + width - 1 + if across { width / 2 } else { 0 }) % width;
                    let cell = &map.values[(y * width + x) * channels..][..channels];
                    self.add(&mut values[start..], cell, tap * channels);
                }
            }
        }
        Map { channels: outputs, values, ..*map }
    }
}

impl Map {
    pub fn activated(mut self) -> Self {
        self.values.iter_mut().for_each(|v| *v = activate(*v));
        self
    }

    /// The sum of two maps of the same shape.
    pub fn plus(mut self, other: &Self) -> Self {
        self.values.iter_mut().zip(&other.values).for_each(|(v, other)| *v += other);
        self
    }

    /// Adds a value to each channel of all cells.
    pub fn plus_everywhere(mut self, channels: &[f32]) -> Self {
        for cell in self.values.chunks_exact_mut(self.channels) {
            cell.iter_mut().zip(channels).for_each(|(v, other)| *v += other);
        }
        self
    }

    /// The mean of each 2 by 2 cells.
    pub fn halved(&self) -> Self {
        let (width, height, channels) = (self.width / 2, self.height / 2, self.channels);
        let mut values = Vec::with_capacity(width * height * channels);
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let at = |y: usize, x: usize| &self.values[(y * self.width + x) * channels..][..channels];
            let [a, b] = [2 * y, 2 * y + 1].map(|y| [at(y, 2 * x), at(y, 2 * x + 1)]);
            values.extend((0..channels).map(|c| 0.25 * (a[0][c] + a[1][c] + b[0][c] + b[1][c])));
        }
        Self { width, height, channels, values }
    }

    /// The map with twice the number of cells in both directions, each value repeated, followed by the channels of
    /// `other`, which has that size.
    pub fn doubled_with(&self, other: &Self) -> Self {
        let channels = self.channels + other.channels;
        let mut values = Vec::with_capacity(other.width * other.height * channels);
        for (at, cell) in other.values.chunks_exact(other.channels).enumerate() {
            let (x, y) = (at % other.width / 2, at / other.width / 2);
            values.extend_from_slice(&self.values[(y * self.width + x) * self.channels..][..self.channels]);
            values.extend_from_slice(cell);
        }
        Self { width: other.width, height: other.height, channels, values }
    }
}
