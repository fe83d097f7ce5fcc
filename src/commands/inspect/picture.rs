//! The size and brightness of a picture.

use scene::error::Error;
use scene::io::picture::of_bytes;
use scene::math::color::luminance;
use scene::math::num;
use scene::types::Picture;
use serde::Serialize;

/// The size and brightness of a picture.
#[derive(Debug, Serialize, PartialEq)]
pub(super) struct Inspection {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    pub channels: usize,
    /// `linear`, `srgb` or `data`, as the file defines it.
    pub encoding: &'static str,
    /// The brightest pixel; only for linear pictures.
    pub peak: Option<Peak>,
    /// Mean luminance; only for linear pictures.
    pub mean: Option<f64>,
}

/// The brightest pixel.
#[derive(Debug, Serialize, PartialEq)]
pub(super) struct Peak {
    /// Column, from the left.
    pub x: usize,
    /// Row, from the top.
    pub y: usize,
    /// Linear luminance; 1 is white.
    pub luminance: f64,
}

/// Reads a picture of any format.
///
/// # Errors
/// The error of `load-image`, also for files that are not pictures.
pub(super) fn inspect(name: &str, bytes: &[u8]) -> Result<Inspection, Error> {
    let picture = of_bytes(name, bytes)?;
    let (width, height, channels) = picture.size();
    let encoding = picture.encoding();
    let linear = matches!(picture, Picture::Linear(_)) && channels >= 3;
    let mut found = Inspection { width, height, channels, encoding, peak: None, mean: None };
    if !linear {
        return Ok(found);
    }
    let mut sum = 0.0;
    for (at, pixel) in picture.samples().chunks_exact(channels).enumerate() {
        let luminance = f64::from(luminance([pixel[0], pixel[1], pixel[2]]));
        sum += luminance;
        if found.peak.as_ref().is_none_or(|peak| luminance > peak.luminance) {
            found.peak = Some(Peak { x: at % width, y: at / width, luminance });
        }
    }
    found.mean = Some(sum / (width * height).max(1) as f64);
    Ok(found)
}

/// Formats a luminance, with its distance from white in stops.
pub(super) fn brightness(luminance: f64) -> String {
    match luminance {
        l if l > 0.0 => {
            let stops = num::f64::log2(l);
            let way = if stops < 0.0 { "below" } else { "above" };
            format!("{l:.3}, {:.1} stops {way} white", stops.abs())
        }
        _ => "0".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brightest_pixel_is_found() {
        // One row of two pixels in RGBE: 0.5 and 8.
        let mut file = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n".to_vec();
        file.extend([128, 128, 128, 128, 128, 128, 128, 132]);
        let found = inspect("a.hdr", &file).expect("a picture");
        assert_eq!((found.width, found.height, found.channels), (2, 1, 3));
        let peak = found.peak.expect("light");
        assert_eq!((peak.x, peak.y), (1, 0));
        assert!(
            (peak.luminance - 8.0).abs() < 0.1 && (found.mean.unwrap_or(0.0) - 4.25).abs() < 0.1,
            "{peak:?}"
        );
        assert_eq!(brightness(8.0), "8.000, 3.0 stops above white");
        assert!(inspect("a.ply", b"ply\n").is_err());
    }
}
