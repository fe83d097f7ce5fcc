//! Whether the bytes of a picture can hold the samples that its header claims.

use crate::error::Error;

/// Maximum number of samples of a picture.
const SAMPLE_LIMIT: u64 = 1 << 31;

/// Checks that a picture is not empty, and that its bytes can hold its samples. `ratio` is the largest number of
/// samples per byte in this format.
pub fn believable(
    file: &str,
    width: u64,
    height: u64,
    channels: u64,
    bytes: usize,
    ratio: u64,
) -> Result<(), Error> {
    let samples = width.checked_mul(height).and_then(|n| n.checked_mul(channels));
    let most = (bytes as u64).saturating_mul(ratio).min(SAMPLE_LIMIT);
    match samples {
        Some(0) => Err(Error::format(file, format!("the picture is empty: {width}x{height} pixels"))),
        Some(n) if n <= most => Ok(()),
        _ => Err(Error::format(
            file,
            format!("the header claims {width}x{height} pixels, which {bytes} bytes cannot hold"),
        )),
    }
}
