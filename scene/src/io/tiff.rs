//! TIFF: reading of grey and RGB pictures of 8 or 16 bits, or of floats, with or without alpha. The crate `tiff`
//! decodes the samples.

use std::io::{Read, Seek};

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{ExtraSamples, Tag};
use tiff::{ColorType, TiffError};

use super::believable::believable;
use super::icc;
use super::progress::{Progress, TrackedReader};
use super::source_colour::SourceColour;
use super::tiff_tags;
use super::turn::Turn;
use crate::error::Error;

/// Version of DNG, a format of raw pictures.
const DNG_VERSION: Tag = Tag::Unknown(50_706);

/// A decoded TIFF, as stored.
#[derive(Debug, Clone, PartialEq)]
pub struct Tiff {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples per pixel: 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha.
    pub channels: usize,
    /// Samples, row by row. Integer codes are scaled to the range 0 to 1.
    pub samples: Vec<f32>,
    /// True if the file holds floats, which are light unless a profile says something else.
    pub floats: bool,
    /// True if the colours are multiplied by alpha.
    pub premultiplied: bool,
    /// How the file says that its colours are encoded; `None` if it does not say.
    pub colour: Option<SourceColour>,
    /// True if the file states that its colours are sRGB.
    pub is_srgb: bool,
    /// True if the file has pages after the first.
    pub has_more_pages: bool,
    /// Other content of the file that is not used.
    pub ignored: Vec<String>,
    /// The turn that makes the picture upright.
    pub(super) turn: Turn,
}

/// Size and samples of a picture from its directory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shape {
    pub(super) size: [u64; 2],
    pub(super) channels: u64,
    /// Bits per sample.
    pub(super) bits: u64,
    pub(super) turn: Turn,
}

/// True if a file begins like a TIFF or a BigTIFF. Raw pictures of most cameras do, too.
pub fn is_tiff(bytes: &[u8]) -> bool {
    ["II*\0", "MM\0*", "II+\0", "MM\0+"].iter().any(|magic| bytes.starts_with(magic.as_bytes()))
}

/// Reads the directory of a TIFF; `None` if it is not a picture that [`read_for`] reads.
pub(super) fn shape(reader: impl Read + Seek) -> Option<Shape> {
    let mut decoder = Decoder::new(reader).ok()?;
    let (width, height) = decoder.dimensions().ok()?;
    let color = decoder.colortype().ok()?;
    let channels = channels_of(color)?;
    let turn = turn_of(&mut decoder);
    Some(Shape { size: [width.into(), height.into()], channels, bits: color.bit_depth().into(), turn })
}

/// Samples per pixel of a colour type that is read.
fn channels_of(color: ColorType) -> Option<u64> {
    match color {
        ColorType::Gray(_) => Some(1),
        ColorType::RGB(_) => Some(3),
        ColorType::RGBA(_) => Some(4),
        ColorType::Multiband { num_samples: 2, .. } => Some(2),
        _ => None,
    }
}

fn turn_of<R: Read + Seek>(decoder: &mut Decoder<R>) -> Turn {
    let tag = decoder.find_tag_unsigned::<u16>(Tag::Orientation).ok().flatten();
    tag.map_or(Turn::UPRIGHT, Turn::of_tag)
}

/// Reads the first picture of a TIFF.
///
/// # Errors
/// [`Error::Format`] if the file is damaged, [`Error::Unsupported`] for raw pictures of cameras and other kinds of
/// samples.
pub fn read_for(file: &str, bytes: &[u8], progress: Progress<'_>) -> Result<Tiff, Error> {
    let unread = || tiff_tags::unread(bytes).map(|what| Error::unsupported(file, what));
    let bad = |error: TiffError| {
        // Tags of samples that are not read may also seem to contradict each other.
        let by_tags = matches!(error, TiffError::UnsupportedError(_) | TiffError::FormatError(_));
        by_tags.then(unread).flatten().unwrap_or_else(|| match error {
            TiffError::UnsupportedError(what) => {
                Error::unsupported(file, format!("a TIFF of this kind: {what}"))
            }
            error => Error::format(file, format!("not a complete TIFF: {error}")),
        })
    };
    let decoder = Decoder::new(TrackedReader::new(bytes, progress)).map_err(bad)?;
    // LZW and deflate expand a byte to less than 1400.
    let most = bytes.len().saturating_mul(1400);
    let mut limits = Limits::default();
    limits.decoding_buffer_size = most;
    limits.intermediate_buffer_size = most;
    limits.ifd_value_size = icc::LARGEST.min(bytes.len());
    let mut decoder = decoder.with_limits(limits);
    refuse_raw(file, &mut decoder)?;
    let (width, height) = decoder.dimensions().map_err(bad)?;
    let color = decoder.colortype().map_err(bad)?;
    let Some(channels) = channels_of(color) else {
        let other =
            || Error::unsupported(file, format!("a TIFF of the type {}; save it as RGB", named(color)));
        return Err(unread().unwrap_or_else(other));
    };
    let bits = color.bit_depth();
    if bits < 8 {
        let what = format!("a TIFF of {bits} bits per sample; save it with 8 or 16 bits, or floats");
        return Err(Error::unsupported(file, what));
    }
    believable(file, width.into(), height.into(), channels, bytes.len(), 1400)?;
    let alpha = decoder.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples).ok().flatten().unwrap_or_default();
    let premultiplied = alpha.first() == Some(&ExtraSamples::AssociatedAlpha.to_u16());
    let profile = decoder.find_tag(Tag::IccProfile).ok().flatten().and_then(|value| value.into_u8_vec().ok());
    let turn = turn_of(&mut decoder);
    let (mut ignored, has_more_pages) = (Vec::new(), decoder.more_images());
    let mut decoded = DecodingResult::U8(Vec::new());
    let layout = decoder.read_image_to_buffer(&mut decoded).map_err(bad)?;
    let is_planar = layout.planes > 1;
    let (samples, floats) = numbers(file, decoded, progress)?;
    let (width, height, channels) = (width as usize, height as usize, channels as usize);
    if samples.len() != width * height * channels {
        return Err(Error::format(file, "the number of samples differs from the number in the header"));
    }
    let samples =
        if is_planar { interleaved(&samples, width * height, channels, progress)? } else { samples };
    let meaning = profile.as_deref().map(icc::meaning).unwrap_or_default();
    let is_srgb = profile.is_some() && meaning == icc::Meaning::default();
    ignored.extend(meaning.ignored);
    let colour = meaning.profile.map(|profile| SourceColour::Icc(Box::new(profile)));
    Ok(Tiff {
        width,
        height,
        channels,
        samples,
        floats,
        premultiplied: premultiplied && channels.is_multiple_of(2),
        colour,
        is_srgb,
        has_more_pages,
        ignored,
        turn,
    })
}

/// Refuses raw pictures of cameras, whose first directory describes sensor data or a preview.
fn refuse_raw<R: Read + Seek>(file: &str, decoder: &mut Decoder<R>) -> Result<(), Error> {
    let number =
        |decoder: &mut Decoder<R>, tag| decoder.find_tag_unsigned::<u32>(tag).ok().flatten().unwrap_or(0);
    let is_dng = decoder.find_tag(DNG_VERSION).ok().flatten().is_some();
    let is_preview = number(decoder, Tag::NewSubfileType) & 1 == 1;
    // Colour filter arrays, and linear sensor data.
    let is_sensor = matches!(number(decoder, Tag::PhotometricInterpretation), 32_803 | 34_892);
    if is_dng || is_preview || is_sensor {
        let what = "a raw picture from a camera; develop it and export it as TIFF, PNG (16 bits) or OpenEXR";
        return Err(Error::unsupported(file, what));
    }
    Ok(())
}

/// Name of a colour type, for errors.
fn named(color: ColorType) -> String {
    match color {
        ColorType::CMYK(_) | ColorType::CMYKA(_) => "CMYK".to_owned(),
        ColorType::Palette(_) => "palette".to_owned(),
        ColorType::YCbCr(_) => "YCbCr".to_owned(),
        ColorType::Lab(_) => "CIE Lab".to_owned(),
        other => format!("{other:?}"),
    }
}

/// The samples as floats, and whether the file holds floats.
fn numbers(file: &str, decoded: DecodingResult, progress: Progress<'_>) -> Result<(Vec<f32>, bool), Error> {
    fn all<T: Copy>(
        from: &[T],
        progress: Progress<'_>,
        number: impl Fn(T) -> f32,
    ) -> Result<Vec<f32>, Error> {
        let mut to = Vec::with_capacity(from.len());
        progress.over(from, |piece| to.extend(piece.iter().map(|v| number(*v))))?;
        Ok(to)
    }
    Ok(match decoded {
        DecodingResult::U8(codes) => (all(&codes, progress, |v| f32::from(v) / 255.0)?, false),
        DecodingResult::U16(codes) => (all(&codes, progress, |v| f32::from(v) / 65_535.0)?, false),
        DecodingResult::F16(floats) => (all(&floats, progress, |v| v.to_f32())?, true),
        DecodingResult::F32(floats) => (floats, true),
        DecodingResult::F64(floats) => (all(&floats, progress, |v| v as f32)?, true),
        _ => {
            let what = "a TIFF of signed, or of 32-bit or 64-bit integers; save it with 16 bits or floats";
            return Err(Error::unsupported(file, what));
        }
    })
}

/// Interleaves planes of `pixels` samples each.
fn interleaved(
    planes: &[f32],
    pixels: usize,
    channels: usize,
    progress: Progress<'_>,
) -> Result<Vec<f32>, Error> {
    let mut samples = Vec::with_capacity(planes.len());
    let at: Vec<usize> = (0..pixels).collect();
    progress.over(&at, |piece| {
        samples.extend(piece.iter().flat_map(|at| (0..channels).map(move |c| planes[c * pixels + at])));
    })?;
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use tiff::encoder::{TiffEncoder, colortype};

    use super::*;

    fn read(bytes: &[u8]) -> Result<Tiff, String> {
        read_for("a.tif", bytes, Progress::UNTRACKED).map_err(|e| e.to_string())
    }

    /// A TIFF of 3 x 2 pixels, with further short tags.
    fn file<C: colortype::ColorType>(samples: &[C::Inner], tags: &[(Tag, u16)]) -> Vec<u8>
    where
        [C::Inner]: tiff::encoder::TiffValue,
    {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).expect("a header");
        let mut image = encoder.new_image::<C>(3, 2).expect("a picture");
        for (tag, value) in tags {
            image.encoder().write_tag(*tag, *value).expect("a tag");
        }
        image.write_data(samples).expect("data");
        bytes.into_inner()
    }

    #[test]
    fn codes_of_8_and_16_bits_and_floats_are_read() {
        let codes: Vec<u8> = (0..18).map(|v| v * 15).collect();
        let tiff = read(&file::<colortype::RGB8>(&codes, &[])).expect("reads");
        assert_eq!((tiff.width, tiff.height, tiff.channels, tiff.floats), (3, 2, 3, false));
        assert!(tiff.samples.iter().zip(&codes).all(|(v, code)| *v == f32::from(*code) / 255.0));
        let wide = read(&file::<colortype::Gray16>(&[0, 1, 2, 65_535, 4, 32_768], &[])).expect("reads");
        assert_eq!((wide.channels, wide.samples[3], wide.samples[5]), (1, 1.0, 32_768.0 / 65_535.0));
        let light: Vec<f32> = (0..24).map(|v| v as f32 - 0.5).collect();
        let floats = read(&file::<colortype::RGBA32Float>(&light, &[])).expect("reads");
        assert_eq!((floats.channels, floats.floats, &floats.samples), (4, true, &light));
        assert!(!floats.premultiplied && floats.colour.is_none());
    }

    /// The tag of the alpha channel and that of the orientation are read.
    #[test]
    fn tags_are_read() {
        let codes = [7_u8; 24];
        for (value, premultiplied) in [(1, true), (2, false)] {
            let tiff = read(&file::<colortype::RGBA8>(&codes, &[(Tag::ExtraSamples, value)])).expect("reads");
            assert_eq!((tiff.channels, tiff.premultiplied), (4, premultiplied));
        }
        let turned = file::<colortype::RGB8>(&codes[..18], &[(Tag::Orientation, 6)]);
        assert_eq!(read(&turned).expect("reads").turn, Turn::of_tag(6));
        let shape = shape(Cursor::new(&turned)).expect("has a shape");
        assert_eq!(shape, Shape { size: [3, 2], channels: 3, bits: 8, turn: Turn::of_tag(6) });
    }

    #[test]
    fn raw_pictures_and_other_samples_are_refused_by_name() {
        let codes = [7_u8; 18];
        for (tags, says) in [
            (&[(DNG_VERSION, 1)][..], "a raw picture from a camera"),
            (&[(Tag::NewSubfileType, 1)][..], "a raw picture from a camera"),
        ] {
            let error = read(&file::<colortype::RGB8>(&codes, tags)).expect_err("is raw");
            assert!(error.contains(says), "{error}");
        }
        let cmyk = read(&file::<colortype::CMYK8>(&[7; 24], &[])).expect_err("is CMYK");
        assert!(cmyk.contains("CMYK colours; save it as RGB"), "{cmyk}");
        let wide = read(&file::<colortype::Gray32>(&[7; 6], &[])).expect_err("has 32 bits");
        assert!(wide.contains("32-bit"), "{wide}");
        // Two bits per sample: the value of the tag BitsPerSample.
        let mut few = file::<colortype::Gray8>(&[7; 6], &[]);
        let tag = [2, 1, 3, 0, 1, 0, 0, 0, 8];
        let at = few.windows(tag.len()).position(|window| window == tag).expect("has the tag");
        few[at + tag.len() - 1] = 2;
        let few = read(&few).expect_err("has 2 bits");
        assert!(few.contains("2 bits per sample; save it with 8 or 16 bits"), "{few}");
    }

    #[test]
    fn no_cut_or_flip_panics_and_every_cut_is_an_error() {
        let bytes = file::<colortype::RGB16>(&[9; 18], &[(Tag::Orientation, 3)]);
        for end in 0..bytes.len() {
            let cut = read(&bytes[..end]);
            // The directory is at the end of the file, and its last four bytes say that no other follows.
            assert!(cut.is_err() || end + 4 >= bytes.len(), "cut at {end}");
            let _ = shape(Cursor::new(&bytes[..end]));
        }
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut hurt = bytes.clone();
                hurt[at] ^= 1 << bit;
                drop(read(&hurt));
            }
        }
    }
}
