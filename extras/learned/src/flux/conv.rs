//! Convolutions of pictures, with an option to treat the left and right edges as neighbours.

use candle_core::Tensor;

use super::error::Result;
use super::watch::Watch;

/// Values with which a picture is padded beyond its left and right edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edge {
    /// Zeros.
    Zeros,
    /// The pixels at the opposite edge, as required for a panorama.
    Wraps,
}

/// Maximum number of elements of the matrix into which a convolution unrolls its input: 268 MB in f32. Without this
/// limit, the decoder of the published model would need 4.8 GB for a picture of 1440 x 720.
pub(crate) const MAX_UNROLLED: usize = 1 << 26;

/// A convolution with a kernel of 1 x 1 or 3 x 3.
#[derive(Debug)]
pub struct Conv {
    weight: Tensor,
    bias: Tensor,
    stride: usize,
}

impl Conv {
    /// Creates a convolution. `weight` has the shape outputs x inputs x size x size; `bias` has one number per
    /// output.
    pub fn new(weight: Tensor, bias: Tensor, stride: usize) -> Result<Self> {
        let outputs = bias.elem_count();
        Ok(Self { weight, bias: bias.reshape((outputs, 1, 1))?, stride })
    }

    /// Convolves `x`, whose shape is channels x height x width. A 3 x 3 kernel reads one pixel beyond each edge if
    /// the stride is 1. If the stride is 2, it reads one pixel beyond the right and bottom edges only.
    pub fn forward(&self, x: &Tensor, edge: Edge, watch: &mut dyn Watch) -> Result<Tensor> {
        let size = self.weight.dim(3)?;
        let before = if size == 3 && self.stride == 1 { 1 } else { 0 };
        let after = if size == 3 { 1 } else { 0 };
        let padded = padded(x, before, after, edge)?;
        let (inputs, height, width) = padded.dims3()?;
        let (rows, columns) = ((height - size) / self.stride + 1, (width - size) / self.stride + 1);
        let band = (MAX_UNROLLED / (columns * inputs * size * size)).clamp(1, rows);
        let mut bands = Vec::new();
        for start in (0..rows).step_by(band) {
            watch.check()?;
            let seen = (band.min(rows - start) - 1) * self.stride + size;
            let part = padded.narrow(1, start * self.stride, seen)?.contiguous()?.unsqueeze(0)?;
            bands.push(part.conv2d(&self.weight, 0, self.stride, 1, 1)?.squeeze(0)?);
        }
        let all = if bands.len() == 1 { bands.remove(0) } else { Tensor::cat(&bands, 1)? };
        Ok(all.broadcast_add(&self.bias)?)
    }
}

/// Adds `before` pixels at the top and left, and `after` pixels at the bottom and right.
fn padded(x: &Tensor, before: usize, after: usize, edge: Edge) -> Result<Tensor> {
    let tall = x.pad_with_zeros(1, before, after)?;
    Ok(match edge {
        Edge::Zeros => tall.pad_with_zeros(2, before, after)?,
        Edge::Wraps => {
            let width = tall.dim(2)?;
            let (left, right) = (tall.narrow(2, width - before, before)?, tall.narrow(2, 0, after)?);
            Tensor::cat(&[&left, &tall, &right], 2)?
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flux::noise::normals;
    use candle_core::Device;

    /// A direct implementation of the definition of a convolution, in f64.
    fn reference(x: &[Vec<Vec<f32>>], w: &[Vec<Vec<f32>>], stride: usize, wraps: bool) -> Vec<Vec<f64>> {
        let (height, width) = (x[0].len() as isize, x[0][0].len() as isize);
        let before = if stride == 1 { 1 } else { 0 };
        let pixel = |row: isize, column: isize| {
            let mut sum = 0.0;
            for (c, kernel) in w.iter().enumerate() {
                for (dy, line) in kernel.iter().enumerate() {
                    for (dx, weight) in line.iter().enumerate() {
                        let y = row * stride as isize + dy as isize - before;
                        let u = column * stride as isize + dx as isize - before;
                        let u = if wraps { u.rem_euclid(width) } else { u };
                        if (0..height).contains(&y) && (0..width).contains(&u) {
                            sum += f64::from(x[c][y as usize][u as usize]) * f64::from(*weight);
                        }
                    }
                }
            }
            sum
        };
        let n = |size: isize| size / stride as isize;
        (0..n(height)).map(|row| (0..n(width)).map(|column| pixel(row, column)).collect()).collect()
    }

    #[test]
    fn is_what_the_definition_says_at_every_edge_and_stride() -> Result<()> {
        let x = normals(1, 0, (2, 6, 8), &Device::Cpu)?;
        let w = normals(1, 1, (2, 3, 3), &Device::Cpu)?;
        for (stride, edge) in [(1, Edge::Zeros), (1, Edge::Wraps), (2, Edge::Zeros), (2, Edge::Wraps)] {
            let bias = Tensor::new(&[0.5_f32], &Device::Cpu)?;
            let conv = Conv::new(w.unsqueeze(0)?, bias, stride)?;
            let got = conv.forward(&x, edge, &mut ())?.squeeze(0)?.to_vec2::<f32>()?;
            let wanted = reference(&x.to_vec3()?, &w.to_vec3()?, stride, edge == Edge::Wraps);
            assert_eq!((got.len(), got[0].len()), (wanted.len(), wanted[0].len()));
            for (got, wanted) in got.iter().flatten().zip(wanted.iter().flatten()) {
                assert!((f64::from(*got) - wanted - 0.5).abs() < 1e-5, "{got} {wanted} {edge:?} {stride}");
            }
        }
        Ok(())
    }
}
