//! WebP: reading to 8-bit codes.

use std::io::Cursor;

use image_webp::{DecodingError, WebPDecoder};

use super::believable::believable;
use super::icc;
use super::png::Raster;
use super::source_colour::SourceColour;
use crate::error::Error;

/// Reads a still WebP, lossy or lossless, as RGB or RGBA codes.
pub fn read(file: &str, bytes: &[u8]) -> Result<Raster, Error> {
    let bad = |e: DecodingError| Error::format(file, format!("not a complete WebP: {e}"));
    let mut decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(bad)?;
    if decoder.is_animated() {
        return Err(Error::unsupported(file, "an animated WebP; save a single frame"));
    }
    let (width, height) = decoder.dimensions();
    let channels = if decoder.has_alpha() { 4 } else { 3 };
    // A flat lossless picture has less than a bit per pixel; the first 64 x 64 pixels are always accepted.
    let most = bytes.len() + 64;
    believable(file, width.into(), height.into(), channels as u64, most, 4096 * 4)?;
    let mut codes = vec![0_u8; width as usize * height as usize * channels];
    decoder.read_image(&mut codes).map_err(bad)?;
    let meaning =
        decoder.icc_profile().map_err(bad)?.map(|profile| icc::meaning(&profile)).unwrap_or_default();
    Ok(Raster {
        width: width as usize,
        height: height as usize,
        channels,
        largest: 255,
        codes: codes.into_iter().map(u16::from).collect(),
        ignored: Vec::from_iter(meaning.ignored),
        colour: meaning.profile.map(|profile| SourceColour::Icc(Box::new(profile))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lossless(width: u32, height: u32, rgba: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        image_webp::WebPEncoder::new(&mut out)
            .encode(rgba, width, height, image_webp::ColorType::Rgba8)
            .unwrap_or_else(|e| panic!("{e}"));
        out
    }

    #[test]
    fn codes_come_back() {
        let rgba: Vec<u8> = (0..5 * 3 * 4).map(|i| i as u8 * 4).collect();
        let raster = read("a.webp", &lossless(5, 3, &rgba)).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((raster.width, raster.height, raster.channels), (5, 3, 4));
        assert_eq!(raster.codes, rgba.iter().map(|&c| u16::from(c)).collect::<Vec<_>>());
    }

    #[test]
    fn cut_and_hurt_files_are_errors_or_pictures_and_never_panic() {
        let whole = lossless(40, 30, &[[10, 20, 30, 255], [200, 100, 50, 255]].concat().repeat(600));
        // The decoder accepts a cut in the last few bytes, which hold no pixel.
        for end in 0..whole.len() - 8 {
            assert!(read("a.webp", &whole[..end]).is_err(), "cut at {end} of {}", whole.len());
        }
        for at in 0..whole.len() {
            let mut hurt = whole.clone();
            hurt[at] ^= 1 << (at % 8);
            drop(read("a.webp", &hurt));
        }
    }
}
