//! Convolution, activation and pooling.

use engine::{Context, NodeError};

use super::tensor::Tensor;

/// A convolution with zeros beyond the border.
#[derive(Debug, Clone)]
pub struct Conv {
    /// Output channels, input channels, rows, columns of the kernel.
    pub shape: [usize; 4],
    /// The kernel, in the order of `shape`.
    pub weight: Vec<f32>,
    /// Biases, one per output channel; empty if there is no bias.
    pub bias: Vec<f32>,
    /// Distance in input pixels between the windows of adjacent outputs, along both axes.
    pub stride: usize,
    /// Number of rows and columns of zeros that are added on each side of the input.
    pub padding: usize,
}

impl Conv {
    /// Number of rows (or columns) of the output, given the number of rows (or columns) `size` of the input and
    /// `kernel` of the kernel; 0 if the kernel does not fit.
    pub fn output_size(&self, size: usize, kernel: usize) -> usize {
        (size + 2 * self.padding).checked_sub(kernel).map_or(0, |room| room / self.stride + 1)
    }

    /// Applies the convolution. Every output is the bias plus a sum of products, which are added in the order of
    /// input channel, kernel row and kernel column.
    pub fn apply(&self, input: &Tensor, cx: &Context) -> Result<Tensor, NodeError> {
        let [outputs, inputs, rows, columns] = self.shape;
        let (height, width) = (self.output_size(input.height, rows), self.output_size(input.width, columns));
        let lines = cx.for_each_tile(height, |y| {
            let mut out = vec![0.0_f32; outputs * width];
            for (o, line) in out.chunks_exact_mut(width.max(1)).enumerate() {
                line.fill(self.bias.get(o).copied().unwrap_or(0.0));
                for i in 0..inputs {
                    for ky in 0..rows {
                        let from = (y * self.stride + ky).checked_sub(self.padding);
                        let Some(from) = from.filter(|from| *from < input.height) else { continue };
                        let kernel = &self.weight[((o * inputs + i) * rows + ky) * columns..][..columns];
                        self.add_row(line, input.row(i, from), kernel);
                    }
                }
            }
            out
        })?;
        let mut result = Tensor::new(outputs, height, width);
        for (y, line) in lines.iter().enumerate() {
            for (o, row) in line.chunks_exact(width.max(1)).enumerate() {
                result.data[(o * height + y) * width..][..width].copy_from_slice(row);
            }
        }
        Ok(result)
    }

    /// Adds the products of one row of the input and one row of the kernel to `line`, which is a row of the output.
    fn add_row(&self, line: &mut [f32], input: &[f32], kernel: &[f32]) {
        for (kx, weight) in kernel.iter().enumerate() {
            // Outputs whose input column x * stride + kx - padding exists.
            let first = self.padding.saturating_sub(kx).div_ceil(self.stride);
            let Some(start) = (first * self.stride + kx).checked_sub(self.padding) else { continue };
            let (Some(line), Some(input)) = (line.get_mut(first..), input.get(start..)) else { continue };
            if self.stride == 1 {
                for (out, v) in line.iter_mut().zip(input) {
                    *out += weight * v;
                }
            } else {
                for (out, v) in line.iter_mut().zip(input.iter().step_by(self.stride)) {
                    *out += weight * v;
                }
            }
        }
    }
}

/// Clamps all values to at least 0.
pub fn relu(tensor: &mut Tensor) {
    for v in &mut tensor.data {
        *v = v.max(0.0);
    }
}

/// Returns the largest value of each window of `size` x `size` pixels, for windows at steps of `stride` pixels.
/// Windows that extend beyond the border are left out.
pub fn max_pool(input: &Tensor, size: usize, stride: usize) -> Tensor {
    let count = |n: usize| n.checked_sub(size).map_or(0, |room| room / stride + 1);
    let mut out = Tensor::new(input.channels, count(input.height), count(input.width));
    for channel in 0..out.channels {
        for y in 0..out.height {
            for x in 0..out.width {
                let mut largest = f32::NEG_INFINITY;
                for row in 0..size {
                    for v in &input.row(channel, y * stride + row)[x * stride..][..size] {
                        largest = largest.max(*v);
                    }
                }
                out.data[(channel * out.height + y) * out.width + x] = largest;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::context;

    /// A direct implementation of the definition, in f64.
    fn slow(conv: &Conv, input: &Tensor) -> Vec<f64> {
        let [outputs, inputs, rows, columns] = conv.shape;
        let (height, width) = (conv.output_size(input.height, rows), conv.output_size(input.width, columns));
        let at = |c: usize, y: i64, x: i64| {
            let inside = (0..input.height as i64).contains(&y) && (0..input.width as i64).contains(&x);
            if inside { f64::from(input.row(c, y as usize)[x as usize]) } else { 0.0 }
        };
        let mut out = Vec::new();
        for o in 0..outputs {
            for y in 0..height {
                for x in 0..width {
                    let mut sum = f64::from(conv.bias[o]);
                    for i in 0..inputs {
                        for ky in 0..rows {
                            for kx in 0..columns {
                                let weight = conv.weight[((o * inputs + i) * rows + ky) * columns + kx];
                                let place =
                                    |n: usize, k: usize| (n * conv.stride + k) as i64 - conv.padding as i64;
                                sum += f64::from(weight) * at(i, place(y, ky), place(x, kx));
                            }
                        }
                    }
                    out.push(sum);
                }
            }
        }
        out
    }

    #[test]
    fn convolution_is_its_definition_for_any_stride_and_padding() {
        let value = |i: usize| ((i * 7919) % 97) as f32 / 48.0 - 1.0;
        let input = Tensor { channels: 3, height: 9, width: 13, data: (0..351).map(value).collect() };
        for (kernel, stride, padding) in [(1, 1, 0), (3, 1, 1), (5, 1, 2), (3, 2, 1), (11, 4, 2), (5, 3, 0)] {
            let shape = [4, 3, kernel, kernel];
            let weight = (0..shape.iter().product()).map(|i| value(i + 5)).collect();
            let conv = Conv { shape, weight, bias: vec![0.5, -0.25, 0.0, 1.0], stride, padding };
            let found = conv.apply(&input, &context()).expect("runs");
            let wanted = slow(&conv, &input);
            assert_eq!(found.data.len(), wanted.len());
            for (a, b) in found.data.iter().zip(wanted) {
                assert!((f64::from(*a) - b).abs() < 2e-4, "{kernel} {stride} {padding}: {a} {b}");
            }
        }
    }

    #[test]
    fn pooling_takes_the_largest_of_whole_windows() {
        let input = Tensor { channels: 1, height: 3, width: 5, data: (0..15).map(|i| i as f32).collect() };
        assert_eq!(max_pool(&input, 2, 2).data, [6.0, 8.0]);
        assert_eq!(max_pool(&input, 3, 2).data, [12.0, 14.0]);
        assert!(max_pool(&input, 4, 1).data.is_empty());
    }
}
