//! Conversion between latent pixels and tokens. A token is a square of two by two latent pixels.

use candle_core::Tensor;

use super::error::{Error, Result};

/// Converts latents of shape channels x height x width to tokens of shape (height/2 * width/2) x (4 * channels).
/// Height and width must be even.
pub fn pack(latents: &Tensor) -> Result<Tensor> {
    let (channels, height, width) = latents.dims3()?;
    if height % 2 != 0 || width % 2 != 0 {
        return Err(Error::Mismatch(format!(
            "latents of {width} x {height} pixels cannot be converted to tokens: width and height must be even"
        )));
    }
    let squares = latents.reshape((channels, height / 2, 2, width / 2, 2))?.permute((1, 3, 0, 2, 4))?;
    Ok(squares.reshape((height / 2 * (width / 2), 4 * channels))?)
}

/// Converts `rows` x `columns` tokens back to latents; the inverse of [`pack`].
pub fn unpack(tokens: &Tensor, rows: usize, columns: usize) -> Result<Tensor> {
    let channels = tokens.dim(1)? / 4;
    let squares = tokens.reshape((rows, columns, channels, 2, 2))?.permute((2, 0, 3, 1, 4))?;
    Ok(squares.reshape((channels, rows * 2, columns * 2))?)
}

/// Rotates a panorama of `rows` x `columns` tokens by half a turn. Two such rotations give the original again.
/// `columns` must be even.
pub fn half_turned(tokens: &Tensor, rows: usize, columns: usize) -> Result<Tensor> {
    let (count, length) = tokens.dims2()?;
    let half = columns / 2;
    let grid = tokens.reshape((rows, columns, length))?;
    let turned = Tensor::cat(&[grid.narrow(1, half, half)?, grid.narrow(1, 0, half)?], 1)?;
    Ok(turned.reshape((count, length))?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn packing_and_turning_undo_themselves() -> Result<()> {
        let latents = Tensor::arange(0_f32, 3.0 * 4.0 * 8.0, &Device::Cpu)?.reshape((3, 4, 8))?;
        let tokens = pack(&latents)?;
        assert_eq!(tokens.dims(), [8, 12]);
        // The first token: of each channel the corner of two by two.
        let first = tokens.narrow(0, 0, 1)?.flatten_all()?.to_vec1::<f32>()?;
        assert_eq!(first[..8], [0.0, 1.0, 8.0, 9.0, 32.0, 33.0, 40.0, 41.0]);
        assert_eq!(unpack(&tokens, 2, 4)?.to_vec3::<f32>()?, latents.to_vec3::<f32>()?);
        let turned = half_turned(&tokens, 2, 4)?;
        assert_eq!(turned.to_vec2::<f32>()?[0], tokens.to_vec2::<f32>()?[2]);
        assert_eq!(half_turned(&turned, 2, 4)?.to_vec2::<f32>()?, tokens.to_vec2::<f32>()?);
        assert!(pack(&latents.narrow(1, 0, 3)?).is_err());
        Ok(())
    }
}
