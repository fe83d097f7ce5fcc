//! PNG: reading to integer codes, and writing with reproducible bytes.

use std::io::Read as _;

use flate2::read::ZlibDecoder;
use png::{BitDepth, CodingIndependentCodePoints, ColorType, Decoder, Encoder, Limits, Transformations};

use super::believable::believable;
use super::exr::differ_from_srgb;
use super::icc;
pub use super::png_pack::Packing;
use super::png_pack::pack;
use super::progress::{Progress, TrackedReader};
pub use super::raster::Raster;
use super::source_colour::SourceColour;
use super::turn::Turn;
use crate::error::Error;
use crate::math::color::space::Space;

/// Reads a PNG of any kind; palettes and low depths are widened to 8 bits.
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
    let bad = |e: png::DecodingError| Error::format(file, format!("not a complete PNG: {e}"));
    // The largest ratio of deflate is 1032 to 1.
    let mut decoder = Decoder::new_with_limits(
        TrackedReader::new(bytes, progress),
        Limits { bytes: (bytes.len() + 65_536).saturating_mul(2_200) },
    );
    decoder.set_transformations(Transformations::EXPAND);
    // The decoder would inflate a profile of any size; `profile` stops at the largest that is read.
    decoder.set_ignore_iccp_chunk(true);
    let mut reader = decoder.read_info().map_err(bad)?;
    let info = reader.info();
    let (width, height) = (info.width, info.height);
    let (mut ignored, mut colour) = (Vec::new(), None);
    // A code of H.273 takes precedence over a profile, that over the sRGB chunk, and that over gamma and chromaticities
    // (PNG, third edition, 4.3).
    if let Some(code) = info.coding_independent_code_points {
        match space_of(code) {
            Some(space) => colour = (space != Space::Srgb).then_some(SourceColour::Space(space)),
            None => ignored.push(format!(
                "a colour space with the code points {}, {}, {} (cICP)",
                code.color_primaries, code.transfer_function, code.matrix_coefficients
            )),
        }
    } else if info.srgb.is_none() {
        if let Some(meaning) = profile(bytes) {
            colour = meaning.profile.map(|profile| SourceColour::Icc(Box::new(profile)));
            ignored.extend(meaning.ignored);
        } else {
            colour = chromaticities(info, &mut ignored);
        }
    }
    if info.animation_control.is_some() {
        ignored.push("animation frames after the first".to_owned());
    }
    let (color, depth) = reader.output_color_type();
    let channels = color.samples();
    // One bit per sample before deflate, so 8 * 1032 samples per byte.
    believable(file, width.into(), height.into(), channels as u64, bytes.len(), 8 * 1032)?;
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| Error::format(file, "the picture is too large for this machine"))?;
    let mut raw = vec![0; size];
    reader.next_frame(&mut raw).map_err(bad)?;
    let (width, height) = (width as usize, height as usize);
    let wide = depth == BitDepth::Sixteen;
    let sample = if wide { 2 } else { 1 };
    if raw.len() != width * height * channels * sample {
        return Err(Error::format(file, "the number of samples differs from the number in the header"));
    }
    let mut codes = Vec::with_capacity(width * height * channels);
    if wide {
        let pairs = raw.as_chunks::<2>().0;
        progress.over(pairs, |pairs| codes.extend(pairs.iter().map(|pair| u16::from_be_bytes(*pair))))?;
    } else {
        progress.over(&raw, |raw| codes.extend(raw.iter().map(|&code| u16::from(code))))?;
    }
    let largest = if wide { 65_535 } else { 255 };
    let turn = chunk(bytes, *b"eXIf").map_or(Turn::UPRIGHT, Turn::of_exif);
    Ok((Raster { width, height, channels, largest, codes, ignored, colour }, turn))
}

/// Code points of the spaces that files of displays use, as (primaries, transfer function) of ITU-T H.273. Those of
/// television share one transfer function, which displays decode by BT.1886.
const CODE_POINTS: [(Space, u8, u8); 6] = [
    (Space::Srgb, 1, 13),
    (Space::Rec709, 1, 1),
    (Space::DisplayP3, 12, 13),
    (Space::Rec2020, 9, 14),
    (Space::LinearRec709, 1, 8),
    (Space::LinearRec2020, 9, 8),
];

/// The space of a chunk `cICP` that this program knows.
fn space_of(code: CodingIndependentCodePoints) -> Option<Space> {
    // The transfer functions 6, 14 and 15 have the same values as 1.
    let transfer = |t: u8| if matches!(t, 6 | 14 | 15) { 1 } else { t };
    let rgb = code.matrix_coefficients == 0 && code.is_video_full_range_image;
    CODE_POINTS
        .iter()
        .find(|(_, primaries, t)| {
            *primaries == code.color_primaries && transfer(*t) == transfer(code.transfer_function)
        })
        .filter(|_| rgb)
        .map(|(space, ..)| *space)
}

/// The colour that the chunks `cHRM` and `gAMA` state, if it is not sRGB. A gamma that is not that of sRGB is added
/// to `ignored`, with the chromaticities, which would be applied to wrong light.
fn chromaticities(info: &png::Info<'_>, ignored: &mut Vec<String>) -> Option<SourceColour> {
    let xy = info
        .chrm_chunk
        .map(|c| [c.red, c.green, c.blue, c.white].map(|(x, y)| [x.into_value(), y.into_value()]));
    let xy = xy.filter(|xy| differ_from_srgb(Some(xy)));
    let gamma = info.gama_chunk.map(|g| g.into_value()).filter(|gamma| (gamma - 0.45455).abs() > 0.001);
    if let Some(gamma) = gamma {
        ignored.push(format!("a gamma of {gamma}"));
    }
    let xy = xy?;
    let colour = SourceColour::display(xy).filter(|_| gamma.is_none());
    if colour.is_none() {
        ignored.push("chromaticities other than those of sRGB".to_owned());
    }
    colour
}

/// Data of the first chunk of a type, which may lie before or after the picture; `None` if there is no such chunk.
fn chunk(bytes: &[u8], kind: [u8; 4]) -> Option<&[u8]> {
    let mut rest = bytes.get(8..)?;
    loop {
        let length = u32::from_be_bytes(*rest.first_chunk()?) as usize;
        let data = rest.get(8..)?.get(..length)?;
        if rest.get(4..8)? == kind {
            return Some(data);
        }
        // Length, type and check sum.
        rest = rest.get(length + 12..)?;
    }
}

/// The meaning of the colour profile of a PNG; `None` if it has no profile. Inflates at most [`icc::LARGEST`]
/// bytes.
fn profile(bytes: &[u8]) -> Option<icc::Meaning> {
    let mut rest = bytes.get(8..)?;
    loop {
        let length = u32::from_be_bytes(*rest.first_chunk()?) as usize;
        let data = rest.get(8..)?.get(..length)?;
        match &rest[4..8] {
            // After its name, a byte for the compression method.
            b"iCCP" => {
                let name = data.iter().take(80).position(|byte| *byte == 0)?;
                let most = icc::LARGEST as u64 + 1;
                let mut inflated = Vec::new();
                let read = ZlibDecoder::new(data.get(name + 2..)?).take(most).read_to_end(&mut inflated);
                return Some(match read {
                    Ok(_) if inflated.len() <= icc::LARGEST => icc::meaning(&inflated),
                    Ok(_) => {
                        let text = format!("an ICC profile of more than {} MiB", icc::LARGEST >> 20);
                        icc::Meaning { profile: None, ignored: Some(text) }
                    }
                    Err(_) => icc::meaning(&[]),
                });
            }
            b"IDAT" => return None,
            // Length, type and check sum.
            _ => rest = rest.get(length + 12..)?,
        }
    }
}

/// Encodes the integer samples of a picture as a PNG, with 8 bits per sample if `raster.largest` is 255, otherwise
/// with 16. `srgb` declares that colour samples are sRGB-encoded. `texts` holds the keyword and the text of each
/// entry of the metadata. Filter and compression are fixed.
pub fn write(raster: &Raster, srgb: bool, texts: &[(&str, &str)]) -> Result<Vec<u8>, Error> {
    write_for(raster, Packing::Small, srgb.then_some(Space::Srgb), texts, Progress::UNTRACKED)
}

/// Like [`write()`], with progress, cancellation and a given compression effort. `space` is the space of the colour
/// samples, which the file states: sRGB by its own chunk, others by code points (`cICP`).
pub fn write_for(
    raster: &Raster,
    packing: Packing,
    space: Option<Space>,
    texts: &[(&str, &str)],
    progress: Progress<'_>,
) -> Result<Vec<u8>, Error> {
    write_all(std::slice::from_ref(raster), None, packing, space, texts, progress)
}

/// Writes frames of equal size and type as an animated PNG. `delay` is the duration of a frame as a fraction of a
/// second, and `plays` is the number of times that the animation is played, or 0 to repeat it forever.
pub fn write_frames(
    frames: &[Raster],
    delay: (u16, u16),
    plays: u32,
    srgb: bool,
    texts: &[(&str, &str)],
    progress: Progress<'_>,
) -> Result<Vec<u8>, Error> {
    write_all(frames, Some((delay, plays)), Packing::Small, srgb.then_some(Space::Srgb), texts, progress)
}

type Animation = ((u16, u16), u32);

fn write_all(
    frames: &[Raster],
    animation: Option<Animation>,
    packing: Packing,
    space: Option<Space>,
    texts: &[(&str, &str)],
    progress: Progress<'_>,
) -> Result<Vec<u8>, Error> {
    let fail = |e: png::EncodingError| Error::Mismatch(format!("cannot encode the picture as PNG: {e}"));
    let Some(first) = frames.first() else {
        return Err(Error::Mismatch("cannot write a PNG without a picture".to_owned()));
    };
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, first.width as u32, first.height as u32);
    encoder.set_color(match first.channels {
        1 => ColorType::Grayscale,
        2 => ColorType::GrayscaleAlpha,
        3 => ColorType::Rgb,
        _ => ColorType::Rgba,
    });
    encoder.set_depth(if first.largest == 255 { BitDepth::Eight } else { BitDepth::Sixteen });
    if space == Some(Space::Srgb) {
        encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
    }
    if let Some((_, plays)) = animation {
        encoder.set_animated(frames.len() as u32, plays).map_err(fail)?;
    }
    for (keyword, text) in texts {
        encoder.add_itxt_chunk((*keyword).to_owned(), (*text).to_owned()).map_err(fail)?;
    }
    let mut writer = encoder.write_header().map_err(fail)?;
    if let Some(space) = space.filter(|space| *space != Space::Srgb) {
        let Some((_, primaries, transfer)) = CODE_POINTS.iter().find(|(known, ..)| *known == space) else {
            return Err(Error::Mismatch(format!("a PNG cannot state the colour space {space:?}")));
        };
        // Matrix coefficients 0: RGB. The last byte declares the full range of codes.
        writer.write_chunk(png::chunk::ChunkType(*b"cICP"), &[*primaries, *transfer, 0, 1]).map_err(fail)?;
    }
    let mut sequence = 0_u32;
    for (index, frame) in frames.iter().enumerate() {
        let packed = pack(frame, packing, progress.piece(index, frames.len()))?;
        if let Some((delay, _)) = animation {
            writer.write_chunk(png::chunk::fcTL, &frame_control(sequence, frame, delay)).map_err(fail)?;
            sequence += 1;
        }
        for piece in packed.chunks(LARGEST_CHUNK) {
            if index == 0 {
                writer.write_chunk(png::chunk::IDAT, piece).map_err(fail)?;
            } else {
                let numbered = [&sequence.to_be_bytes()[..], piece].concat();
                writer.write_chunk(png::chunk::fdAT, &numbered).map_err(fail)?;
                sequence += 1;
            }
        }
    }
    writer.finish().map_err(fail)?;
    Ok(bytes)
}

/// Maximum number of data bytes in a chunk. The length of a chunk, which includes a sequence number, is a 31-bit
/// number.
const LARGEST_CHUNK: usize = (u32::MAX >> 1) as usize - 4;

/// The frame-control chunk (`fcTL`) of a frame that replaces the whole picture.
fn frame_control(sequence: u32, frame: &Raster, (numerator, denominator): (u16, u16)) -> Vec<u8> {
    let sizes = [sequence, frame.width as u32, frame.height as u32, 0, 0].map(u32::to_be_bytes).concat();
    let delay = [numerator, denominator].map(u16::to_be_bytes).concat();
    [sizes, delay, vec![0, 0]].concat()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::io::exr;
    use moxcms::{ColorProfile, ToneReprCurve};
    use testing::row;

    pub(crate) fn raster(channels: usize, largest: u16) -> Raster {
        let (width, height) = (37, 5);
        let codes = (0..width * height * channels)
            .map(|i| ((i * 7919) % (usize::from(largest) + 1)) as u16)
            .collect();
        Raster { width, height, channels, largest, codes, ignored: Vec::new(), colour: None }
    }

    #[test]
    fn every_kind_comes_back_as_it_was_and_gives_the_same_bytes() {
        for channels in 1..=4 {
            for largest in [255, 65_535] {
                let raster = raster(channels, largest);
                let bytes =
                    write(&raster, true, &[("recipe", "(a: \"b ä\")")]).unwrap_or_else(|e| panic!("{e}"));
                assert_eq!(bytes, write(&raster, true, &[("recipe", "(a: \"b ä\")")]).unwrap_or_default());
                assert_eq!(read("a.png", &bytes).unwrap_or_else(|e| panic!("{e}")), raster);
            }
        }
    }

    #[test]
    fn no_cut_or_flip_panics_and_every_cut_is_an_error() {
        let bytes = write(&raster(3, 255), false, &[]).unwrap_or_default();
        // The chunk after the picture's data (the end chunk) may be missing.
        for end in 0..bytes.len() - 16 {
            assert!(read("a.png", &bytes[..end]).is_err(), "cut at {end}");
        }
        for at in 0..bytes.len() {
            let mut hurt = bytes.clone();
            hurt[at] ^= 1 << (at % 8);
            drop(read("a.png", &hurt));
        }
    }

    /// Palettes and low depths are widened, a transparent colour becomes alpha, and gamma and profiles that are
    /// ignored are reported.
    #[test]
    fn palettes_low_depths_and_skipped_chunks() {
        let file = |color, depth, data: &[u8], change: &dyn Fn(&mut png::Info<'_>)| {
            let mut info = png::Info::with_size(4, 1);
            (info.color_type, info.bit_depth) = (color, depth);
            change(&mut info);
            let mut bytes = Vec::new();
            let mut writer =
                Encoder::with_info(&mut bytes, info).and_then(Encoder::write_header).expect("writes");
            writer.write_image_data(data).expect("writes");
            writer.finish().expect("writes");
            read("a.png", &bytes).expect("reads")
        };
        let palette: Vec<u8> = vec![10, 20, 30, 40, 50, 60, 255, 0, 128];
        let colours = [&palette[..], &palette[3..6]].concat();
        let indexed = |info: &mut png::Info<'_>| info.palette = Some(palette.clone().into());
        // Two bits each: 0, 1, 2, 1.
        let plain = file(ColorType::Indexed, BitDepth::Two, &[0b0001_1001], &indexed);
        let codes = |bytes: &[u8]| bytes.iter().map(|&v| u16::from(v)).collect::<Vec<_>>();
        assert_eq!((plain.channels, plain.largest, &plain.codes), (3, 255, &codes(&colours)));
        let clear = file(ColorType::Indexed, BitDepth::Two, &[0b0001_1001], &|info| {
            indexed(info);
            info.trns = Some(vec![0, 128].into());
        });
        let alphas: Vec<u16> = clear.codes.iter().skip(3).step_by(4).copied().collect();
        assert_eq!((clear.channels, alphas), (4, vec![0, 128, 255, 128]));
        let grey = file(ColorType::Grayscale, BitDepth::One, &[0b0101_0000], &|_| {});
        assert_eq!(
            (grey.channels, grey.codes, grey.ignored),
            (1, vec![0, 255, 0, 255], Vec::<String>::new())
        );
        let ramp = [0, 85, 170, 255];
        let gamma = |value: f32| {
            file(ColorType::Grayscale, BitDepth::Eight, &ramp, &|info| {
                info.source_gamma = Some(png::ScaledFloat::new(value));
                info.gama_chunk = info.source_gamma;
            })
        };
        assert_eq!((gamma(1.0).codes, gamma(1.0).ignored), (codes(&ramp), vec!["a gamma of 1".to_owned()]));
        assert_eq!(gamma(1.0 / 2.2).ignored, Vec::<String>::new());
        let stated = |gamma: f32, srgb: bool| {
            file(ColorType::Grayscale, BitDepth::Eight, &ramp, &|info| {
                let p3 = png::SourceChromaticities::new(
                    (0.3127, 0.329),
                    (0.68, 0.32),
                    (0.265, 0.69),
                    (0.15, 0.06),
                );
                (info.source_chromaticities, info.chrm_chunk) = (Some(p3), Some(p3));
                info.source_gamma = Some(png::ScaledFloat::new(gamma));
                info.gama_chunk = info.source_gamma;
                info.srgb = srgb.then_some(png::SrgbRenderingIntent::Perceptual);
            })
        };
        // From the published matrix of linear P3 to linear sRGB; the file has five decimals.
        let p3 = stated(0.45455, false);
        assert!(p3.ignored.is_empty());
        let Some(SourceColour::Display(matrix)) = p3.colour else { panic!("{:?}", p3.colour) };
        let red = matrix.map(|row| row[0]);
        assert!(red.iter().zip([1.22494, -0.04206, -0.01964]).all(|(a, b)| (a - b).abs() < 1e-4), "{red:?}");
        assert_eq!((stated(0.45455, true).colour, stated(0.45455, true).ignored), (None, Vec::new()));
        assert_eq!((stated(1.0, false).colour, stated(1.0, false).ignored.len()), (None, 2));
        let profile = file(ColorType::Grayscale, BitDepth::Eight, &ramp, &|info| {
            info.icc_profile = Some(vec![1, 2, 3].into());
        });
        assert_eq!(
            (profile.codes, profile.ignored),
            (codes(&ramp), vec!["an ICC profile that cannot be read".to_owned()])
        );
    }

    /// The orientation of EXIF data is reported, before and after the picture; upright is not.
    #[test]
    fn orientations_of_png_are_reported() {
        // Big endian; one entry: tag 0x112, a short, one value.
        let exif = |value: u8| {
            let mut exif = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
            exif.extend([value, 0, 0, 0, 0, 0, 0]);
            exif
        };
        let plain = write(&raster(3, 255), true, &[]).unwrap_or_else(|e| panic!("{e}"));
        let of = |exif: &[u8], after: bool| {
            let mut crc = flate2::Crc::new();
            crc.update(b"eXIf");
            crc.update(exif);
            let length = (exif.len() as u32).to_be_bytes();
            let chunk = [&length[..], b"eXIf", exif, &crc.sum().to_be_bytes()].concat();
            // The header ends after 33 bytes, and the end chunk has 12.
            let at = if after { plain.len() - 12 } else { 33 };
            read("a.png", &[&plain[..at], &chunk[..], &plain[at..]].concat()).expect("reads").ignored
        };
        let reported = ["an orientation other than upright (EXIF)"];
        for after in [false, true] {
            assert!(of(&exif(1), after).is_empty());
            for value in 2..=8 {
                assert_eq!(of(&exif(value), after), reported);
            }
            assert_eq!(of(&[&b"Exif\0\0"[..], &exif(6)[..]].concat(), after), reported);
            assert!(of(b"MM\0*", after).is_empty());
        }
    }

    /// A PNG of 4 by 4 grey pixels with a profile.
    pub(crate) fn with_profile(profile: &[u8]) -> Vec<u8> {
        let mut info = png::Info::with_size(4, 4);
        (info.color_type, info.bit_depth) = (ColorType::Grayscale, BitDepth::Eight);
        info.icc_profile = Some(profile.into());
        let mut bytes = Vec::new();
        let mut writer =
            Encoder::with_info(&mut bytes, info).and_then(Encoder::write_header).expect("writes");
        writer.write_image_data(&[128; 16]).expect("writes");
        writer.finish().expect("writes");
        bytes
    }

    // A profile is inflated only up to a limit; one of 3 GB in 3 MB used to be held in memory completely.
    #[test]
    fn profiles_that_inflate_without_end_are_not_read() {
        let read = read("a.png", &with_profile(&vec![0; icc::LARGEST + 1])).expect("reads");
        assert_eq!(read.ignored, ["an ICC profile of more than 16 MiB"]);
        let linear =
            icc::tests::profile("Linear sRGB", &ColorProfile::new_srgb(), ToneReprCurve::Lut(vec![]));
        let read = super::read("a.png", &with_profile(&linear)).expect("reads");
        assert!(read.colour.is_some_and(|colour| colour.is_scene()) && read.ignored.is_empty());
    }

    /// Pictures of one pixel, of prime sizes, and of 30,000 columns or rows are unchanged after writing and
    /// reading. Sizes whose number of samples does not fit into 64 bits are refused.
    #[test]
    fn sizes_are_not_believed_and_do_not_overflow() {
        assert!(believable("a", u64::MAX, u64::MAX, 4, 1000, 10).is_err());
        assert!(believable("a", 1 << 32, 1 << 32, 1, usize::MAX, 1).is_err());
        for (width, height) in [(1, 1), (30_000, 7), (3, 30_011), (127, 61)] {
            let codes = (0..width * height * 3).map(|i| (i % 251) as u16).collect();
            let raster =
                Raster { width, height, channels: 3, largest: 255, codes, ignored: Vec::new(), colour: None };
            let bytes = write(&raster, true, &[]).unwrap_or_else(|e| panic!("{e}"));
            let same = read("a.png", &bytes).is_ok_and(|back| back == raster);
            row(65, "sizes that do not come back", f64::from(u8::from(!same)), 0.0);
            let plane =
                exr::Channel { name: "Y".into(), samples: raster.samples()[..width * height].to_vec() };
            let file = exr::write(width, height, vec![(plane.clone(), exr::Depth::Float)], "", None);
            let back = file.and_then(|(bytes, _)| exr::read("a.exr", &bytes)).expect("comes back");
            assert_eq!((back.width, back.height, &back.channels), (width, height, &vec![plane]));
        }
        assert!(believable("a", 1 << 40, 1 << 40, 3, 1000, 10).is_err());
        assert!(believable("a", 0, 3, 3, 1000, 10).is_err());
        assert!(believable("a", 10, 10, 3, 30, 10).is_ok());
        assert!(believable("a", 10, 10, 4, 30, 10).is_err());
    }
}
