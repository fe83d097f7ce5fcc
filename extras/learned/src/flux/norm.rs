//! Norms, computed in f32 at least, whatever the type of their input.

use candle_core::{D, DType, Tensor};

use super::error::Result;

const EPSILON: f64 = 1e-6;

/// The type that sums are made in: f32, or f64 where all is.
pub fn wide(dtype: DType) -> DType {
    if dtype == DType::F64 { DType::F64 } else { DType::F32 }
}

/// Each token to mean 0 and variance 1, then `(1 + scale) x + shift` with one vector for all tokens.
pub fn modulated(x: &Tensor, scale: &Tensor, shift: &Tensor) -> Result<Tensor> {
    let dtype = wide(x.dtype());
    let wide = x.to_dtype(dtype)?;
    let centred = wide.broadcast_sub(&wide.mean_keepdim(D::Minus1)?)?;
    let variance = centred.sqr()?.mean_keepdim(D::Minus1)?;
    let normal = centred.broadcast_div(&(variance + EPSILON)?.sqrt()?)?;
    let scaled = normal.broadcast_mul(&(scale.to_dtype(dtype)? + 1.0)?)?;
    Ok(scaled.broadcast_add(&shift.to_dtype(dtype)?)?.to_dtype(x.dtype())?)
}

/// Each vector along the last axis to root mean square 1, then times `scale`.
pub fn root_mean_square(x: &Tensor, scale: &Tensor) -> Result<Tensor> {
    let dtype = wide(x.dtype());
    let wide = x.to_dtype(dtype)?;
    let square = (wide.sqr()?.mean_keepdim(D::Minus1)? + EPSILON)?;
    Ok(wide.broadcast_div(&square.sqrt()?)?.broadcast_mul(&scale.to_dtype(dtype)?)?.to_dtype(x.dtype())?)
}

/// Channels x height x width: each group of channels to mean 0 and variance 1, then an own scale and shift
/// for each channel.
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
