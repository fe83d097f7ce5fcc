//! JPEG: reading to 8-bit codes, and writing.

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::believable::believable;
use super::exif::{self, ExifColour};
use super::icc;
use super::png::Raster;
use super::progress::{Progress, TrackedReader, TrackedWriter};
use super::source_colour::SourceColour;
use super::turn::Turn;
use crate::error::Error;

/// Reads a JPEG as RGB codes. The channels of grey pictures are equal.
pub fn read(file: &str, bytes: &[u8]) -> Result<Raster, Error> {
    read_for(file, bytes, Progress::UNTRACKED)
}

/// Like [`read`], with progress and cancellation.
pub fn read_for(file: &str, bytes: &[u8], progress: Progress<'_>) -> Result<Raster, Error> {
    let (mut raster, turn) = read_stored(file, bytes, progress)?;
    raster.ignored.extend(turn.ignored());
    Ok(raster)
}

/// Reads a picture as it is stored, and the turn that makes it upright.
pub(super) fn read_stored(file: &str, bytes: &[u8], progress: Progress<'_>) -> Result<(Raster, Turn), Error> {
    let bad = |e: zune_jpeg::errors::DecodeErrors| Error::format(file, format!("not a complete JPEG: {e}"));
    // Without SIMD: the SIMD paths round differently on different machines.
    let options = DecoderOptions::default()
        .set_use_unsafe(false)
        .set_strict_mode(true)
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_max_width(65_535)
        .set_max_height(65_535);
    let mut decoder = JpegDecoder::new_with_options(TrackedReader::new(bytes, progress), options);
    decoder.decode_headers().map_err(bad)?;
    let Some((width, height)) = decoder.dimensions() else {
        return Err(Error::format(file, "the header does not state the size of the picture"));
    };
    if matches!(decoder.input_colorspace(), Some(ColorSpace::CMYK | ColorSpace::YCCK)) {
        return Err(Error::unsupported(file, "CMYK colours; save the picture as RGB"));
    }
    // A block of 64 samples takes at least 2 bits per component; progressive files may end a band of 32767 blocks
    // with a few bits.
    believable(file, width as u64, height as u64, 3, bytes.len(), 64 * 4096)?;
    if !bytes.trim_ascii_end().ends_with(&[0xff, 0xd9]) && !bytes.windows(2).any(|pair| pair == [0xff, 0xd9])
    {
        return Err(Error::format(file, "not a complete JPEG: it ends without its end marker"));
    }
    let raw = decoder.decode().map_err(bad)?;
    if raw.len() != width * height * 3 {
        return Err(Error::format(file, "the number of samples differs from the number in the header"));
    }
    let mut codes = Vec::with_capacity(raw.len());
    progress.over(&raw, |raw| codes.extend(raw.iter().map(|&code| u16::from(code))))?;
    // A profile defines more than the metadata of the camera.
    let meaning = match (decoder.icc_profile(), decoder.exif().and_then(|exif| exif::colour(exif))) {
        (Some(profile), _) => icc::meaning(&profile),
        (None, Some(ExifColour::AdobeRgb)) => icc::adobe_rgb(),
        (None, Some(ExifColour::Uncalibrated)) => icc::Meaning {
            ignored: Some("a colour space other than sRGB (EXIF) but no ICC profile".to_owned()),
            ..icc::Meaning::default()
        },
        (None, None) => icc::Meaning::default(),
    };
    let raster = Raster {
        width,
        height,
        channels: 3,
        largest: 255,
        codes,
        ignored: Vec::from_iter(meaning.ignored),
        colour: meaning.profile.map(|profile| SourceColour::Icc(Box::new(profile))),
    };
    Ok((raster, decoder.exif().map_or(Turn::UPRIGHT, |exif| Turn::of_exif(exif))))
}

/// Writes 8-bit RGB or grey codes as a JPEG with a quality from 1 to 100 and an optional comment.
pub fn write(raster: &Raster, quality: u8, comment: Option<&str>) -> Result<Vec<u8>, Error> {
    write_for(raster, quality, comment, Progress::UNTRACKED)
}

/// Like [`write()`], with progress and cancellation.
pub fn write_for(
    raster: &Raster,
    quality: u8,
    comment: Option<&str>,
    progress: Progress<'_>,
) -> Result<Vec<u8>, Error> {
    let fail = |e: image::ImageError| Error::Mismatch(format!("cannot encode the picture as JPEG: {e}"));
    let (width, height) = (raster.width as u32, raster.height as u32);
    if width > 65_535 || height > 65_535 {
        return Err(Error::Mismatch(format!("{width}x{height} pixels are too many for JPEG; write a PNG")));
    }
    let raw: Vec<u8> = raster.codes.iter().map(|&code| code as u8).collect();
    let color =
        if raster.channels == 1 { image::ExtendedColorType::L8 } else { image::ExtendedColorType::Rgb8 };
    let mut sunk = TrackedWriter::new(raw.len(), progress);
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut sunk, quality)
        .encode(&raw, width, height, color)
        .map_err(fail)?;
    let mut bytes = sunk.bytes;
    bytes.shrink_to_fit();
    // Comments hold up to 65533 bytes; a longer text is split into several, right after the start marker.
    let mut at = 2;
    for piece in comment.map(str::as_bytes).into_iter().flat_map(|text| text.chunks(65_533)) {
        let mut segment = vec![0xff, 0xfe];
        segment.extend((piece.len() as u16 + 2).to_be_bytes());
        segment.extend(piece);
        let length = segment.len();
        bytes.splice(at..at, segment);
        at += length;
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> Raster {
        let (width, height) = (61, 34);
        let codes =
            (0..width * height).flat_map(|i| [(i % width * 4) as u16, (i / width * 7) as u16, 90]).collect();
        Raster { width, height, channels: 3, largest: 255, codes, ignored: Vec::new(), colour: None }
    }

    #[test]
    fn a_smooth_picture_comes_back_nearly() {
        let bytes = write(&picture(), 95, Some("recipe")).unwrap_or_else(|e| panic!("{e}"));
        assert!(bytes.windows(6).any(|w| w == b"recipe"));
        let back = read("a.jpg", &bytes).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((back.width, back.height, back.channels), (61, 34, 3));
        let largest = back.codes.iter().zip(&picture().codes).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(largest.is_some_and(|d| d <= 14), "{largest:?}");
    }

    #[test]
    fn no_cut_or_flip_panics_and_every_cut_is_an_error() {
        let bytes = write(&picture(), 80, None).unwrap_or_default();
        for end in 0..bytes.len() {
            assert!(read("a.jpg", &bytes[..end]).is_err(), "cut at {end}");
        }
        for at in 0..bytes.len() {
            let mut hurt = bytes.clone();
            hurt[at] ^= 1 << (at % 8);
            drop(read("a.jpg", &hurt));
        }
    }
}
