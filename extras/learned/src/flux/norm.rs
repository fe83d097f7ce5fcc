//! Normalizations. They are computed in f64 for f64 input, and in f32 for any other type.

use candle_core::{D, DType, Tensor};

use super::error::Result;

const EPSILON: f64 = 1e-6;

/// The type in which sums are computed: f64 for f64 input, otherwise f32.
pub fn wide(dtype: DType) -> DType {
    if dtype == DType::F64 { DType::F64 } else { DType::F32 }
}

/// Normalizes each token to mean 0 and variance 1, then applies `(1 + scale) x + shift`. The vectors `scale` and
/// `shift` are the same for all tokens.
pub fn modulated(x: &Tensor, scale: &Tensor, shift: &Tensor) -> Result<Tensor> {
    let dtype = wide(x.dtype());
    let wide = x.to_dtype(dtype)?;
    let centred = wide.broadcast_sub(&wide.mean_keepdim(D::Minus1)?)?;
    let variance = centred.sqr()?.mean_keepdim(D::Minus1)?;
    let normal = centred.broadcast_div(&(variance + EPSILON)?.sqrt()?)?;
    let scaled = normal.broadcast_mul(&(scale.to_dtype(dtype)? + 1.0)?)?;
    Ok(scaled.broadcast_add(&shift.to_dtype(dtype)?)?.to_dtype(x.dtype())?)
}

/// Normalizes each vector along the last axis to root mean square 1, then multiplies it by `scale`.
pub fn root_mean_square(x: &Tensor, scale: &Tensor) -> Result<Tensor> {
    let dtype = wide(x.dtype());
    let wide = x.to_dtype(dtype)?;
    let square = (wide.sqr()?.mean_keepdim(D::Minus1)? + EPSILON)?;
    Ok(wide.broadcast_div(&square.sqrt()?)?.broadcast_mul(&scale.to_dtype(dtype)?)?.to_dtype(x.dtype())?)
}

/// Normalizes each group of channels to mean 0 and variance 1, then applies the scale and shift of each channel.
/// The input has the shape channels x height x width.
pub fn group(x: &Tensor, groups: usize, scale: &Tensor, shift: &Tensor) -> Result<Tensor> {
    let (channels, height, width) = x.dims3()?;
    let rows = x.reshape((groups, channels / groups * height, width))?;
    // Means of rows first, so that sums over a million pixels keep their precision.
    let mean = |t: &Tensor| -> Result<Tensor> { Ok(t.mean_keepdim(2)?.mean_keepdim(1)?) };
    let centred = rows.broadcast_sub(&mean(&rows)?)?;
    let variance = mean(&centred.sqr()?)?;
    let normal = centred.broadcast_div(&(variance + EPSILON)?.sqrt()?)?.reshape((channels, height, width))?;
    let by_channel = |t: &Tensor| t.reshape((channels, 1, 1));
    Ok(normal.broadcast_mul(&by_channel(scale)?)?.broadcast_add(&by_channel(shift)?)?)
}
