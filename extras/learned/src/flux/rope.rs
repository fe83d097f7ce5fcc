//! Positions of tokens, and the rotations that encode them for attention.

use candle_core::{DType, Device, Tensor};

use super::error::Result;

/// The place of a token: frame, row and column. Text tokens are at (0, 0, 0), tokens of the new picture have frame
/// 0, and tokens of the original picture have frame 1.
pub type Place = [f32; 3];

/// The places of a grid of tokens in frame `frame`, row by row.
pub fn grid(frame: f32, rows: usize, columns: usize) -> Vec<Place> {
    (0..rows).flat_map(|row| (0..columns).map(move |column| [frame, row as f32, column as f32])).collect()
}

/// Rotations that encode the places of tokens, as cosines and sines. Both tensors are f32 and have the shape tokens
/// x (head / 2). Angles are computed in f64 from f32 places even if the weights are bf16, because the 8 bits of
/// precision of bf16 can distinguish only 256 columns.
#[derive(Debug, Clone)]
pub struct Rotations {
    /// Cosine of the angle by which each pair of channels is rotated.
    pub cos: Tensor,
    /// Sine of the angle by which each pair of channels is rotated.
    pub sin: Tensor,
}

impl Rotations {
    /// The rotations of tokens at these places. `axes` contains the numbers of channels per head that are rotated
    /// by the frame, the row and the column, in this order.
    pub fn new(places: &[Place], axes: [usize; 3], device: &Device) -> Result<Self> {
        const BASE: f64 = 10_000.0;
        let half = axes.iter().sum::<usize>() / 2;
        let (mut cos, mut sin) = (Vec::new(), Vec::new());
        for place in places {
            for (coordinate, width) in place.iter().zip(axes) {
                for pair in 0..width / 2 {
                    let frequency = 1.0 / libm::pow(BASE, (2 * pair) as f64 / width as f64);
                    let (s, c) = libm::sincos(f64::from(*coordinate) * frequency);
                    cos.push(c as f32);
                    sin.push(s as f32);
                }
            }
        }
        let table = |values| Tensor::from_vec(values, (places.len(), half), device);
        Ok(Self { cos: table(cos)?, sin: table(sin)? })
    }

    /// Rotates each pair of neighbouring channels of `x`, which has the shape heads x tokens x head.
    pub fn turn(&self, x: &Tensor) -> Result<Tensor> {
        let (heads, tokens, head) = x.dims3()?;
        let pairs = x.to_dtype(DType::F32)?.reshape((heads, tokens, head / 2, 2))?;
        let (a, b) = (pairs.narrow(3, 0, 1)?.squeeze(3)?, pairs.narrow(3, 1, 1)?.squeeze(3)?);
        let real = (a.broadcast_mul(&self.cos)? - b.broadcast_mul(&self.sin)?)?;
        let imaginary = (a.broadcast_mul(&self.sin)? + b.broadcast_mul(&self.cos)?)?;
        Ok(Tensor::stack(&[real, imaginary], 3)?.reshape((heads, tokens, head))?.to_dtype(x.dtype())?)
    }
}
