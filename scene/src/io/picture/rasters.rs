//! PNG, JPEG and TIFF: samples, orientation and notes.

use engine::Notes;

use super::encoding::{FileEncoding, Orientation};
use crate::error::Error;
use crate::io::png::Raster;
use crate::io::progress::Progress;
use crate::io::source_colour::SourceColour;
use crate::io::tiff::Tiff;
use crate::io::turn::Turn;

/// A decoded picture before its colours are converted.
pub(super) struct Decoded {
    /// Columns, rows, and samples per pixel.
    pub size: (usize, usize, usize),
    pub samples: Vec<f32>,
    /// The colour that the file states, if it needs a conversion.
    pub colour: Option<SourceColour>,
    /// True if pictures of this format hold linear light unless they state something else.
    pub linear: bool,
}

/// A picture turned upright, or as stored with a description of what is ignored.
pub(super) fn oriented(
    (mut raster, turn): (Raster, Turn),
    orientation: Orientation,
    notes: &mut Notes,
    progress: Progress<'_>,
) -> Result<Raster, Error> {
    if orientation == Orientation::Stored {
        raster.ignored.extend(turn.ignored());
        return Ok(raster);
    }
    report_turn(turn, notes);
    let codes = std::mem::take(&mut raster.codes);
    let (size, codes) = turn.upright([raster.width, raster.height], raster.channels, codes, progress)?;
    [raster.width, raster.height] = size;
    raster.codes = codes;
    Ok(raster)
}

pub(super) fn report_turn(turn: Turn, notes: &mut Notes) {
    if turn != Turn::UPRIGHT {
        notes.decision("turned-upright", "the picture was turned upright, as its metadata (EXIF) say");
    }
}

/// Colours of a TIFF, premultiplied, or its samples as data.
pub(super) fn of_tiff(
    picture: Tiff,
    encoding: FileEncoding,
    notes: &mut Notes,
    progress: Progress<'_>,
) -> Result<Decoded, Error> {
    report_ignored(&picture.ignored, notes);
    if picture.has_more_pages {
        notes.warning("one-page-only", "the file has several pages; the first is read");
    }
    let Tiff { width, height, channels, samples, floats, premultiplied, .. } = picture;
    let alpha = channels.is_multiple_of(2);
    let stays = encoding == FileEncoding::Data || channels == 3 || (channels == 4 && premultiplied);
    let (channels, samples) = if stays {
        (channels, samples)
    } else {
        let mut colours = Vec::with_capacity(width * height * if alpha { 4 } else { 3 });
        progress.over(&samples, |piece| {
            for pixel in piece.chunks_exact(channels) {
                let (rgb, a) = match *pixel {
                    [y] => ([y; 3], 1.0),
                    [y, a] => ([y; 3], a),
                    [r, g, b, ref rest @ ..] => ([r, g, b], rest.first().copied().unwrap_or(1.0)),
                    [] => ([0.0; 3], 1.0),
                };
                let by = if premultiplied { 1.0 } else { a };
                colours.extend(rgb.map(|v| v * by));
                if alpha {
                    colours.push(a);
                }
            }
        })?;
        (if alpha { 4 } else { 3 }, colours)
    };
    let colour = picture.colour.filter(|_| encoding == FileEncoding::Auto);
    report_profile(colour.as_ref(), notes);
    Ok(Decoded { size: (width, height, channels), samples, colour, linear: floats && !picture.is_srgb })
}

/// Warns about content of a file that is not used.
fn report_ignored(ignored: &[String], notes: &mut Notes) {
    for ignored in ignored {
        notes.warning("profile-ignored", format!("the file has {ignored}; this is ignored"));
    }
}

/// Converts integer codes to floats. Colours become RGB or RGBA; data keeps its number of channels.
pub(super) fn of_raster(
    raster: Raster,
    encoding: FileEncoding,
    notes: &mut Notes,
    progress: Progress<'_>,
) -> Result<Decoded, Error> {
    report_ignored(&raster.ignored, notes);
    let (channels, samples) = match encoding {
        FileEncoding::Data => (raster.channels, raster.samples()),
        _ => raster.colours(progress)?,
    };
    let colour = raster.colour.filter(|_| encoding == FileEncoding::Auto);
    report_profile(colour.as_ref(), notes);
    Ok(Decoded { size: (raster.width, raster.height, channels), samples, colour, linear: false })
}

/// Adds a note about the colours that a file states.
fn report_profile(colour: Option<&SourceColour>, notes: &mut Notes) {
    if let Some(colour) = colour {
        let what = match colour {
            SourceColour::Icc(profile) if profile.name.is_empty() => "an ICC profile".to_owned(),
            SourceColour::Icc(profile) => format!("the ICC profile `{}`", profile.name),
            SourceColour::Space(space) => format!("code points (cICP) of {space:?}"),
            SourceColour::Linear(_) | SourceColour::Display(_) => {
                "chromaticities other than those of sRGB".to_owned()
            }
        };
        let (id, as_what) = if colour.is_scene() {
            ("linear-profile", "linear light")
        } else {
            ("profile-applied", "sRGB, without clipping")
        };
        notes.decision(id, format!("the file has {what}, so its colours were converted to {as_what}"));
    }
}
