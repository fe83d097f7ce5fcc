//! Decodes pictures of any format: PNG, JPEG, TIFF, OpenEXR or Radiance HDR, detected by their first bytes.

mod encoding;
mod layers;
mod rasters;
mod size;
#[cfg(test)]
mod tests;

use engine::Notes;

pub use self::encoding::{FileEncoding, Orientation};
use self::layers::{layer, report_choice, report_pixels, stated};
use self::rasters::{Decoded, of_raster, of_tiff, oriented, report_turn};
pub use self::size::{floats_of, head_of, size, upright_size};
use super::foreign::{other_picture, refuse_foreign};
use super::progress::Progress;
use super::source_colour::SourceColour;
use super::tiff::is_tiff;
use super::{exr, hdr, jpeg, png, tiff};
use crate::error::Error;
use crate::types::{Data, Image, Linear, Picture, Srgb};

/// Decodes a picture as the kind `load-image` does with default parameters.
///
/// # Errors
/// If the bytes are not a complete picture.
pub fn of_bytes(name: &str, bytes: &[u8]) -> Result<Picture, Error> {
    decode(FileEncoding::Auto, "", name, bytes, &mut Notes::none(), Progress::UNTRACKED)
}

/// Decodes a picture as it is stored, with the given encoding. From an OpenEXR file, the given layer is read. A
/// picture that is not stored upright is reported.
///
/// # Errors
/// If the bytes are not a complete picture of a format that is read, or have no such layer.
pub fn decode(
    encoding: FileEncoding,
    of_layer: &str,
    name: &str,
    bytes: &[u8],
    notes: &mut Notes,
    progress: Progress<'_>,
) -> Result<Picture, Error> {
    decode_turned(encoding, Orientation::Stored, of_layer, name, bytes, notes, progress)
}

/// Like [`decode`], with a choice of the orientation.
pub fn decode_turned(
    encoding: FileEncoding,
    orientation: Orientation,
    of_layer: &str,
    name: &str,
    bytes: &[u8],
    notes: &mut Notes,
    progress: Progress<'_>,
) -> Result<Picture, Error> {
    let mut decoded = match bytes {
        [0x89, b'P', b'N', b'G', ..] => {
            let raster = oriented(png::read_stored(name, bytes, progress)?, orientation, notes, progress)?;
            of_raster(raster, encoding, notes, progress)?
        }
        [0xff, 0xd8, ..] => {
            let raster = oriented(jpeg::read_stored(name, bytes, progress)?, orientation, notes, progress)?;
            of_raster(raster, encoding, notes, progress)?
        }
        _ if is_tiff(bytes) => {
            let mut picture = tiff::read_for(name, bytes, progress)?;
            if orientation == Orientation::Stored {
                picture.ignored.extend(picture.turn.ignored());
            } else {
                report_turn(picture.turn, notes);
                let size = [picture.width, picture.height];
                let samples = std::mem::take(&mut picture.samples);
                let (size, samples) = picture.turn.upright(size, picture.channels, samples, progress)?;
                [picture.width, picture.height] = size;
                picture.samples = samples;
            }
            of_tiff(picture, encoding, notes, progress)?
        }
        [b'#', b'?', ..] => {
            let picture = hdr::read_for(name, bytes, progress)?;
            for line in &picture.ignored {
                notes.decision(
                    "header-ignored",
                    format!("the line `{line}` of the header is not understood and is ignored"),
                );
            }
            report_pixels(1.0 / picture.pixel_aspect, notes);
            let colour = stated(picture.primaries, encoding, notes);
            Decoded { size: (picture.width, picture.height, 3), samples: picture.rgb, colour, linear: true }
        }
        [0x76, 0x2f, 0x31, 0x01, ..] => {
            let opened = exr::open(name, bytes, of_layer)?;
            report_choice(&opened, of_layer.is_empty(), notes);
            let found = layer(name, &opened)?;
            let (width, height) = opened.size();
            let samples = opened.interleaved(&found, progress)?;
            // Vectors are not colours.
            let vector = found.last().is_some_and(|name| name.ends_with('Z'));
            let colour = stated(opened.primaries().filter(|_| !vector), encoding, notes);
            Decoded { size: (width, height, found.len()), samples, colour, linear: true }
        }
        _ => {
            refuse_foreign(name, bytes)?;
            return Err(match other_picture(name, bytes) {
                Some(format) => {
                    Error::unsupported(name, format!("a {format} picture; save it as PNG or JPEG"))
                }
                None => {
                    Error::format(name, "the file is not a PNG, JPEG, TIFF, OpenEXR or Radiance HDR picture")
                }
            });
        }
    };
    let (width, height, channels) = decoded.size;
    let data = encoding == FileEncoding::Data;
    let mut samples = finite(std::mem::take(&mut decoded.samples), data, notes, progress)?;
    // A declared space replaces what the file says.
    let source = encoding.space().map(SourceColour::Space).or(decoded.colour);
    let linear = source.as_ref().map_or(decoded.linear, SourceColour::is_scene);
    if let Some(source) = source.filter(|source| !data && !source.is_working()) {
        source.convert(&mut samples, channels, progress)?;
        let beyond = samples.iter_mut().filter(|v| !v.is_finite());
        // NaN becomes 0.
        let beyond = beyond.map(|v| *v = v.clamp(0.0, 65_504.0).max(0.0)).count();
        if beyond > 0 {
            let text = format!(
                "samples of `{name}` are beyond the range of the colour space, and became 0 or 65504 (count: {beyond}); is `encoding` the space of the file?"
            );
            notes.warning("beyond-colour-space", text);
        }
    }
    Ok(if data {
        Image::<Data>::from_samples(width, height, channels, samples).into()
    } else if linear {
        Image::<Linear>::from_samples(width, height, channels, samples).into()
    } else {
        Image::<Srgb>::from_samples(width, height, channels, samples).into()
    })
}

/// Replaces NaN with 0 and, unless the picture is data, infinite samples with the largest 16-bit float.
fn finite(
    mut samples: Vec<f32>,
    data: bool,
    notes: &mut Notes,
    progress: Progress<'_>,
) -> Result<Vec<f32>, Error> {
    let (mut lost, mut capped) = (0, 0);
    for row in samples.chunks_mut(1 << 20) {
        progress.report(1.0)?;
        for v in row.iter_mut().filter(|v| !v.is_finite()) {
            if v.is_nan() {
                lost += 1;
                *v = 0.0;
            } else if !data {
                capped += 1;
                *v = 65_504.0_f32.copysign(*v);
            }
        }
    }
    notes.count("not-a-number", lost, "of the samples had the value NaN, which was replaced with 0");
    notes.count(
        "infinite",
        capped,
        "of the samples had an infinite value, which was replaced with 65504, the largest 16-bit float",
    );
    Ok(samples)
}
