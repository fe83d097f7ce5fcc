//! Decodes pictures of any format: PNG, JPEG, TIFF, OpenEXR or Radiance HDR, detected by their first bytes.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use engine::{FileHead, Notes};

use super::foreign::{other_picture, refuse_foreign};
use super::head::Head;
use super::png::Raster;
use super::progress::Progress;
use super::source_colour::SourceColour;
use super::tiff::{Tiff, is_tiff};
use super::turn::Turn;
use super::{exr, hdr, jpeg, png, tiff};
use crate::error::Error;
use crate::math::color::space::Space;
use crate::types::{Data, Image, Linear, Picture, Srgb};

engine::choices! {
    /// Meaning of the sample values in a picture file.
    pub enum FileEncoding {
        /// Follows the file: its colour profile (ICC), code points (cICP) or chromaticities. Files that say nothing
        /// are sRGB if they are PNG, JPEG or TIFF of integers, and linear Rec.709 if they are OpenEXR, Radiance or TIFF of
        /// floats.
        Auto,
        /// sRGB.
        Srgb,
        /// Linear light with the primaries of Rec.709.
        Linear,
        /// Data that are not colours: a mask, a depth, a ratio.
        Data,
        /// Rec.709 video, as shown on a display of BT.1886 (gamma 2.4).
        Rec709,
        /// Display P3.
        DisplayP3,
        /// Rec.2020 video, as shown on a display of BT.1886 (gamma 2.4).
        Rec2020,
        /// Linear light with the primaries of P3 and the white of D65.
        LinearP3,
        /// Linear light with the primaries of Rec.2020.
        LinearRec2020,
        /// ACEScg: linear light with the primaries AP1.
        AcesCg,
        /// ACES2065-1: linear light with the primaries AP0.
        Aces2065,
        /// ACEScct: logarithmic, with the primaries AP1.
        AcesCct,
        /// ARRI LogC3 for exposure index 800, with ARRI Wide Gamut 3.
        LogC3,
        /// ARRI LogC4 with ARRI Wide Gamut 4.
        LogC4,
        /// Sony S-Log3 with S-Gamut3.
        SLog3,
        /// Sony S-Log3 with S-Gamut3.Cine.
        SLog3Cine,
        /// Panasonic V-Log with V-Gamut.
        VLog,
        /// DaVinci Intermediate with DaVinci Wide Gamut.
        DaVinci,
    }
}

engine::choices! {
    /// Orientation of a picture whose metadata (EXIF) say that the camera was turned.
    pub enum Orientation {
        /// Turns the picture as its metadata say, so that it is upright.
        Upright,
        /// Keeps the rows and columns of the file.
        Stored,
    }
}

impl FileEncoding {
    /// The colour space that is declared; `None` for `Auto` and `Data`.
    fn space(self) -> Option<Space> {
        Some(match self {
            FileEncoding::Auto | FileEncoding::Data => return None,
            FileEncoding::Srgb => Space::Srgb,
            FileEncoding::Linear => Space::LinearRec709,
            FileEncoding::Rec709 => Space::Rec709,
            FileEncoding::DisplayP3 => Space::DisplayP3,
            FileEncoding::Rec2020 => Space::Rec2020,
            FileEncoding::LinearP3 => Space::LinearP3,
            FileEncoding::LinearRec2020 => Space::LinearRec2020,
            FileEncoding::AcesCg => Space::AcesCg,
            FileEncoding::Aces2065 => Space::Aces2065,
            FileEncoding::AcesCct => Space::AcesCct,
            FileEncoding::LogC3 => Space::LogC3,
            FileEncoding::LogC4 => Space::LogC4,
            FileEncoding::SLog3 => Space::SLog3,
            FileEncoding::SLog3Cine => Space::SLog3Cine,
            FileEncoding::VLog => Space::VLog,
            FileEncoding::DaVinci => Space::DaVinci,
        })
    }
}

/// Reads the head of a picture; `None` for files that are not pictures.
pub fn head_of(file: &FileHead<'_>) -> Option<Head> {
    file.open().and_then(|mut reader| Head::read(&mut reader))
}

/// Two sizes in bytes: the peak memory for reading a picture, including the bytes of the file, and the size of the
/// resulting floats.
pub fn floats_of(file: &FileHead<'_>) -> [u64; 2] {
    let [reading, floats] = head_of(file).map_or([0; 2], |head| head.as_floats());
    [reading.saturating_add(file.bytes), floats]
}

/// Width and height of the picture in a file when it is upright, from its header; `None` for files that are not
/// pictures.
pub fn upright_size(path: &Path) -> Option<[u64; 2]> {
    let head = Head::read(&mut BufReader::new(File::open(path).ok()?))?;
    let [width, height] = head.size;
    Some(if head.is_quarter_turned { [height, width] } else { [width, height] })
}

/// Width and height of the picture in a file as it is stored, from its header; `None` for files that are not
/// pictures.
pub fn size(path: &Path) -> Option<[u64; 2]> {
    Head::read(&mut BufReader::new(File::open(path).ok()?)).map(|head| head.size)
}

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
    }
    Ok(if data {
        Image::<Data>::from_samples(width, height, channels, samples).into()
    } else if linear {
        Image::<Linear>::from_samples(width, height, channels, samples).into()
    } else {
        Image::<Srgb>::from_samples(width, height, channels, samples).into()
    })
}

/// A decoded picture before its colours are converted.
struct Decoded {
    /// Columns, rows, and samples per pixel.
    size: (usize, usize, usize),
    samples: Vec<f32>,
    /// The colour that the file states, if it needs a conversion.
    colour: Option<SourceColour>,
    /// True if pictures of this format hold linear light unless they state something else.
    linear: bool,
}

/// A picture turned upright, or as stored with a description of what is ignored.
fn oriented(
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

fn report_turn(turn: Turn, notes: &mut Notes) {
    if turn != Turn::UPRIGHT {
        notes.decision("turned-upright", "the picture was turned upright, as its metadata (EXIF) say");
    }
}

/// Colours of a TIFF, premultiplied, or its samples as data.
fn of_tiff(
    picture: Tiff,
    encoding: FileEncoding,
    notes: &mut Notes,
    progress: Progress<'_>,
) -> Result<Decoded, Error> {
    report_ignored(&picture.ignored, notes);
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
fn of_raster(
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

/// The conversion from chromaticities that a file states, if they differ from those of Rec.709.
fn stated(xy: Option<[[f32; 2]; 4]>, encoding: FileEncoding, notes: &mut Notes) -> Option<SourceColour> {
    let xy = xy.filter(|xy| encoding == FileEncoding::Auto && exr::differ_from_srgb(Some(xy)))?;
    let colour = SourceColour::linear(xy);
    if colour.is_some() {
        notes.decision(
            "primaries-applied",
            "the file states chromaticities other than those of Rec.709; its colours were converted to Rec.709",
        );
    } else {
        notes.warning(
            "profile-ignored",
            "the chromaticities of the file do not define a colour space and are ignored; set `encoding`",
        );
    }
    colour
}

/// Warns about pixels that are not square. `aspect` is the width of a pixel divided by its height.
fn report_pixels(aspect: f64, notes: &mut Notes) {
    if aspect.is_nan() || (aspect - 1.0).abs() >= 1e-3 {
        let text =
            format!("the pixels of the file are not square (width / height: {aspect}); this is ignored");
        notes.warning("pixel-aspect-ignored", text);
    }
}

/// Adds notes about parts of an EXR file that are ignored.
fn report_choice(file: &exr::Opened<'_>, by_default: bool, notes: &mut Notes) {
    if file.parts() > 1 && by_default {
        notes.warning(
            "one-part-only",
            format!(
                "the file has {} parts, and the part `{}` is read; set `layer` to read another part: {}",
                file.parts(),
                file.part(),
                file.part_names().join(", ")
            ),
        );
    }
    report_pixels(f64::from(file.pixel_aspect()), notes);
    if file.cropped() {
        notes.decision(
            "data-window",
            "the data window differs from the display window; pixels outside the data window are 0",
        );
    }
}

/// Names of the channels of the chosen layer: colour with optional alpha, a vector, or a single channel.
fn layer(name: &str, file: &exr::Opened<'_>) -> Result<Vec<String>, Error> {
    let (layer, names) = (file.layer.as_str(), file.names());
    let prefix = if layer.is_empty() { String::new() } else { format!("{layer}.") };
    let all = |letters: &[&str]| {
        let full: Vec<String> = letters.iter().map(|letter| format!("{prefix}{letter}")).collect();
        full.iter().all(|name| names.contains(name)).then_some(full)
    };
    // Its Y alone would be a grey picture.
    let chroma = all(&["RY", "BY"]).is_some();
    let single = || match layer {
        "" if chroma => None,
        "" => names.iter().find(|name| *name == "Y").map(|name| vec![name.clone()]),
        wanted => names.iter().find(|name| *name == wanted).map(|name| vec![name.clone()]),
    };
    let found = all(&["R", "G", "B", "A"])
        .or_else(|| all(&["R", "G", "B"]))
        .or_else(|| all(&["r", "g", "b", "a"]))
        .or_else(|| all(&["r", "g", "b"]))
        .or_else(|| all(&["X", "Y", "Z"]))
        .or_else(|| if chroma { None } else { all(&["Y", "A"]) })
        .or_else(|| if layer.is_empty() { None } else { all(&["Z"]) })
        .or_else(single);
    found.ok_or_else(|| no_layer(name, file, &names, chroma))
}

/// The error about a missing layer, which lists the layers of the file.
fn no_layer(name: &str, file: &exr::Opened<'_>, names: &[String], chroma: bool) -> Error {
    let what = match file.layer.as_str() {
        _ if chroma => {
            "the picture stores luminance and chroma (Y, RY, BY), which cannot be read as colour".to_owned()
        }
        "" => "the picture has neither channels R, G and B nor a channel Y".to_owned(),
        layer => format!("the picture has no layer `{layer}`"),
    };
    let layers: Vec<String> = file.layers().into_iter().take(20).map(|layer| format!("`{layer}`")).collect();
    let mut text = format!("{what}; `layer` may be one of {}", layers.join(", "));
    if file.parts() > 1 {
        text.push_str(&format!(", or a part: {}", file.part_names().join(", ")));
    }
    let of = if file.parts() > 1 {
        format!("the channels of the part `{}`", file.part())
    } else {
        "the channels of the file".to_owned()
    };
    Error::format(name, format!("{text}; {of} are {}", names.join(", ")))
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

#[cfg(test)]
mod tests {
    use super::*;

    fn load(bytes: &[u8], encoding: FileEncoding, layer: &str) -> (Picture, Notes) {
        let mut notes = Notes::none();
        (
            decode(encoding, layer, "a", bytes, &mut notes, Progress::UNTRACKED)
                .unwrap_or_else(|e| panic!("{e}")),
            notes,
        )
    }
    fn png_of(channels: usize, largest: u16, codes: Vec<u16>) -> Vec<u8> {
        let width = codes.len() / channels;
        let raster = Raster { width, height: 1, channels, largest, codes, ignored: Vec::new(), colour: None };
        png::write(&raster, false, &[]).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Pixels of an OpenEXR file that are not square are reported.
    #[test]
    fn pixels_that_are_not_square_are_reported() {
        let plane = |name: &str| {
            let samples = vec![0.5];
            (exr::Channel { name: name.into(), samples }, exr::Depth::Float)
        };
        let channels = ["R", "G", "B"].map(plane).into_iter().collect();
        let (bytes, _) = exr::write(1, 1, channels, "", None).unwrap_or_else(|e| panic!("{e}"));
        let reported = |bytes: &[u8]| {
            let (_, notes) = load(bytes, FileEncoding::Auto, "");
            notes.iter().any(|note| note.id == "pixel-aspect-ignored")
        };
        assert!(!reported(&bytes));
        // The name of the attribute, its type and its length, then the number.
        let name = b"pixelAspectRatio\0float\0\x04\0\0\0";
        let at = bytes.windows(name.len()).position(|window| window == name).map(|at| at + name.len());
        let mut wide = bytes;
        let place = at.and_then(|at| wide.get_mut(at..at + 4)).expect("has the attribute");
        place.copy_from_slice(&2.0_f32.to_le_bytes());
        assert!(reported(&wide));
        let radiance = |more: &str| {
            let head = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{more}\n-Y 1 +X 1\n");
            reported(&[head.as_bytes(), &[128, 128, 128, 129][..]].concat())
        };
        assert_eq!(["", "PIXASPECT=1\n", "PIXASPECT= 0.5\n"].map(radiance), [false, false, true]);
    }

    /// PNGs of 8 and 16 bits, grey and with alpha, are decoded to premultiplied colour or, if the encoding says so,
    /// to data.
    #[test]
    fn pngs_are_premultiplied_colour_or_data() {
        let rgba = png_of(4, 255, vec![255, 51, 0, 51]);
        let (picture, _) = load(&rgba, FileEncoding::Auto, "");
        assert_eq!((picture.encoding(), picture.samples()), ("srgb", &[0.2, 0.2 * 0.2, 0.0, 0.2][..]));
        assert_eq!(load(&rgba, FileEncoding::Data, "").0.samples(), [1.0, 0.2, 0.0, 0.2]);
        let grey = png_of(1, 65_535, vec![0, 13_107]);
        let (picture, _) = load(&grey, FileEncoding::Linear, "");
        assert_eq!((picture.encoding(), picture.size()), ("linear", (2, 1, 3)));
        assert_eq!(picture.samples()[3..], [0.2; 3]);
        assert_eq!(load(&grey, FileEncoding::Data, "").0.size(), (2, 1, 1));
    }

    /// A JPEG of 2 x 1 pixels, left red and right blue, that is to be turned by 90 degrees clockwise. This test fails
    /// if `upright_size` or the decoder ignores the metadata, or if `decode` does not.
    #[test]
    fn a_photograph_is_turned_upright_where_asked() {
        let codes = [[[250, 0, 0]; 8], [[0, 0, 250]; 8]].concat().concat().repeat(8);
        let raster = Raster {
            width: 16,
            height: 8,
            channels: 3,
            largest: 255,
            codes,
            ignored: Vec::new(),
            colour: None,
        };
        let mut bytes = jpeg::write(&raster, 100, None).unwrap_or_else(|e| panic!("{e}"));
        let exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
        let length = (exif.len() as u16 + 2).to_be_bytes();
        bytes.splice(2..2, [&[0xff, 0xe1][..], &length, exif].concat());
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), &bytes).expect("it is written");
        assert_eq!((size(file.path()), upright_size(file.path())), (Some([16, 8]), Some([8, 16])));
        let (stored, notes) = load(&bytes, FileEncoding::Auto, "");
        assert_eq!(stored.size(), (16, 8, 3));
        assert!(notes.iter().any(|note| note.text.contains("other than upright (EXIF)")));
        let mut notes = Notes::none();
        let (encoding, upright) = (FileEncoding::Auto, Orientation::Upright);
        let turned = decode_turned(encoding, upright, "", "a", &bytes, &mut notes, Progress::UNTRACKED)
            .unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(notes.iter().map(|note| note.id.as_str()).collect::<Vec<_>>(), ["turned-upright"]);
        assert_eq!(turned.size(), (8, 16, 3));
        // The left side of the file is at the top.
        let (top, bottom) = (turned.samples().first_chunk::<3>(), turned.samples().last_chunk::<3>());
        let (Some([red, _, _]), Some([_, _, blue])) = (top, bottom) else { panic!("has pixels") };
        assert!(*red > 0.9 && *blue > 0.9, "{red}, {blue}");
    }

    /// TIFF of codes is sRGB with straight alpha unless it says otherwise; TIFF of floats is light.
    #[test]
    fn tiffs_are_premultiplied_colour_or_data() {
        use ::tiff::encoder::{TiffEncoder, colortype};
        let mut codes = std::io::Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut codes).expect("a header");
        encoder.write_image::<colortype::RGBA8>(1, 1, &[255, 51, 0, 51]).expect("a picture");
        let codes = codes.into_inner();
        let (picture, notes) = load(&codes, FileEncoding::Auto, "");
        assert_eq!((picture.encoding(), picture.samples()), ("srgb", &[0.2, 0.2 * 0.2, 0.0, 0.2][..]));
        assert_eq!(notes, Notes::none());
        assert_eq!(load(&codes, FileEncoding::Data, "").0.samples(), [1.0, 0.2, 0.0, 0.2]);
        let mut grey = std::io::Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut grey).expect("a header");
        encoder.write_image::<colortype::Gray32Float>(2, 1, &[0.5, 7.0]).expect("a picture");
        let (picture, _) = load(&grey.into_inner(), FileEncoding::Auto, "");
        assert_eq!((picture.encoding(), picture.size()), ("linear", (2, 1, 3)));
        assert_eq!(picture.samples()[3..], [7.0; 3]);
    }

    // Used to be decoded as display colours, with 0.5 becoming 0.21.
    #[test]
    fn a_picture_with_a_linear_profile_is_linear_light() {
        let profile = crate::io::icc::tests::profile(
            "Linear sRGB",
            &moxcms::ColorProfile::new_srgb(),
            moxcms::ToneReprCurve::Lut(Vec::new()),
        );
        let file = png::tests::with_profile(&profile);
        let (picture, notes) = load(&file, FileEncoding::Auto, "");
        assert_eq!((picture.encoding(), picture.samples()[0]), ("linear", 128.0 / 255.0));
        assert!(notes.iter().any(|note| note.id == "linear-profile"));
        let (picture, notes) = load(&file, FileEncoding::Srgb, "");
        assert_eq!((picture.encoding(), notes.iter().count()), ("srgb", 0));
    }

    #[test]
    fn layers_of_an_exr_are_found_by_name_and_hold_numbers() {
        let plane =
            |name: &str, v: f32| (exr::Channel { name: name.into(), samples: vec![v] }, exr::Depth::Float);
        let channels = vec![
            plane("R", 1.0),
            plane("G", f32::NAN),
            plane("B", f32::INFINITY),
            plane("R0.R", 4.0),
            plane("R0.G", 5.0),
            plane("R0.B", 6.0),
            plane("R0.A", 1.0),
            plane("Z", f32::INFINITY),
            plane("depth.Z", 3.0),
            plane("N.X", 0.0),
            plane("N.Y", 0.0),
            plane("N.Z", 1.0),
        ];
        let (bytes, _) = exr::write(1, 1, channels, "", None).unwrap_or_else(|e| panic!("{e}"));
        let (picture, notes) = load(&bytes, FileEncoding::Auto, "");
        assert_eq!((picture.encoding(), picture.samples()), ("linear", &[1.0, 0.0, 65_504.0][..]));
        assert_eq!(notes.iter().count(), 2);
        assert_eq!(load(&bytes, FileEncoding::Auto, "R0").0.samples(), [4.0, 5.0, 6.0, 1.0]);
        assert_eq!(load(&bytes, FileEncoding::Data, "Z").0.samples(), [f32::INFINITY]);
        assert_eq!(load(&bytes, FileEncoding::Data, "N").0.samples(), [0.0, 0.0, 1.0]);
        assert_eq!(load(&bytes, FileEncoding::Data, "depth").0.samples(), [3.0]);
        let refused = |bytes: &[u8], layer: &str| {
            let read = decode(FileEncoding::Auto, layer, "a", bytes, &mut Notes::none(), Progress::UNTRACKED);
            read.err().map(|error| error.to_string()).unwrap_or_default()
        };
        let reported = refused(&bytes, "S");
        assert!(
            reported.contains("no layer `S`")
                && reported.contains("one of `B`, `G`, `N`, `R`, `R0`, `Z`, `depth`"),
            "{reported}"
        );

        // Data is not mistaken for colour, and the channels of the file are listed.
        let of = |names: &[&str]| {
            let channels = names.iter().map(|name| plane(name, 0.5)).collect();
            exr::write(1, 1, channels, "", None).unwrap_or_else(|e| panic!("{e}")).0
        };
        assert_eq!(load(&of(&["r", "g", "b"]), FileEncoding::Auto, "").0.size(), (1, 1, 3));
        let reported = refused(&of(&["variance.R", "variance.G", "variance.B"]), "");
        assert!(
            reported
                .contains("neither channels R, G and B nor a channel Y; `layer` may be one of `variance`"),
            "{reported}"
        );
        for more in [&["Y", "RY", "BY"][..], &["Y", "RY", "BY", "A"]] {
            assert!(refused(&of(more), "").contains("luminance and chroma"));
            assert_eq!(load(&of(more), FileEncoding::Auto, "Y").0.size(), (1, 1, 1));
        }
        assert!(refused(&of(&["R", "G"]), "").contains("the channels of the file are G, R"));
    }
}
