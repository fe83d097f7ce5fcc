//! PNG: reading to f32 samples, and writing the same bytes every time.

use std::io::Cursor;

use png::{BitDepth, ColorType, Compression, Decoder, Encoder, Filter, Limits, Transformations};

use crate::Error;

/// A decoded picture: samples as stored, divided by the largest code, not linearised, alpha straight.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha.
    pub channels: usize,
    /// Largest code in the file: 255 or 65535.
    pub largest: u16,
    /// Codes, row by row.
    pub codes: Vec<u16>,
    /// What the file says and we pass over, such as a gamma other than sRGB's.
    pub ignored: Vec<String>,
}

impl Raster {
    /// The samples from 0 to 1.
    pub fn samples(&self) -> Vec<f32> {
        let largest = f32::from(self.largest);
        self.codes.iter().map(|&code| f32::from(code) / largest).collect()
    }
}

/// Most samples we read of one picture.
const SAMPLE_LIMIT: u64 = 1 << 31;

/// Refuses a picture that is empty, or larger than its bytes could hold. `ratio` is the most samples
/// that a byte of this format can stand for.
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
        Some(0) => Err(Error::format(file, format!("the picture is {width}x{height}"))),
        Some(n) if n <= most => Ok(()),
        _ => Err(Error::format(
            file,
            format!("claims {width}x{height} pixels, which {bytes} bytes cannot hold"),
        )),
    }
}

/// Reads a PNG of any kind; palettes and low depths are widened to 8 bits.
pub fn read(file: &str, bytes: &[u8]) -> Result<Raster, Error> {
    let bad = |e: png::DecodingError| Error::format(file, format!("not a whole PNG: {e}"));
    // Deflate reaches 1032 to 1; beyond that no file is honest.
    let mut decoder = Decoder::new_with_limits(
        Cursor::new(bytes),
        Limits { bytes: (bytes.len() + 65_536).saturating_mul(2_200) },
    );
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(bad)?;
    let info = reader.info();
    let (width, height) = (info.width, info.height);
    let mut ignored = Vec::new();
    if info.srgb.is_none() {
        if info.icc_profile.is_some() {
            ignored.push("an ICC profile".to_owned());
        }
        if let Some(gamma) = info.gama_chunk.map(|g| g.into_value())
            && (gamma - 0.45455).abs() > 0.001
        {
            ignored.push(format!("a gamma of {gamma}"));
        }
    }
    if info.animation_control.is_some() {
        ignored.push("all but the first frame".to_owned());
    }
    let (color, depth) = reader.output_color_type();
    let channels = color.samples();
    // A bit a sample before deflate, so 8 * 1032 of them a byte.
    believable(file, width.into(), height.into(), channels as u64, bytes.len(), 8 * 1032)?;
    let size =
        reader.output_buffer_size().ok_or_else(|| Error::format(file, "too large for this machine"))?;
    let mut raw = vec![0; size];
    reader.next_frame(&mut raw).map_err(bad)?;
    let (largest, codes) = match depth {
        BitDepth::Sixteen => {
            (65_535, raw.as_chunks::<2>().0.iter().map(|pair| u16::from_be_bytes(*pair)).collect())
        }
        _ => (255, raw.iter().map(|&code| u16::from(code)).collect::<Vec<_>>()),
    };
    let (width, height) = (width as usize, height as usize);
    if codes.len() != width * height * channels {
        return Err(Error::format(file, "holds another number of samples than it claims"));
    }
    Ok(Raster { width, height, channels, largest, codes, ignored })
}

/// Writes codes as a PNG: 8 bits where `largest` is 255, else 16. `srgb` tells that colour samples are
/// sRGB-encoded; `texts` are keywords and texts of its metadata. Fixed filter and compression.
pub fn write(raster: &Raster, srgb: bool, texts: &[(&str, &str)]) -> Result<Vec<u8>, Error> {
    write_all(std::slice::from_ref(raster), None, false, srgb, texts)
}

/// The same pixels in a tenth of the time and a larger file.
pub fn write_fast(raster: &Raster, srgb: bool, texts: &[(&str, &str)]) -> Result<Vec<u8>, Error> {
    write_all(std::slice::from_ref(raster), None, true, srgb, texts)
}

/// Writes frames of one size and sort as an animated PNG. `delay` is the time of a frame as a fraction of a
/// second, `plays` how often it plays, 0 for ever.
pub fn write_frames(
    frames: &[Raster],
    delay: (u16, u16),
    plays: u32,
    srgb: bool,
    texts: &[(&str, &str)],
) -> Result<Vec<u8>, Error> {
    write_all(frames, Some((delay, plays)), false, srgb, texts)
}

type Animation = ((u16, u16), u32);

fn write_all(
    frames: &[Raster],
    animation: Option<Animation>,
    fast: bool,
    srgb: bool,
    texts: &[(&str, &str)],
) -> Result<Vec<u8>, Error> {
    let fail = |e: png::EncodingError| Error::Mismatch(format!("cannot make a PNG: {e}"));
    let Some(first) = frames.first() else {
        return Err(Error::Mismatch("cannot make a PNG of no picture".to_owned()));
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
    // What is compressed fast has no time for the best filter of each row.
    let (compression, filter) =
        if fast { (Compression::Fast, Filter::Up) } else { (Compression::Balanced, Filter::Adaptive) };
    encoder.set_compression(compression);
    encoder.set_filter(filter);
    if srgb {
        encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
    }
    if let Some(((numerator, denominator), plays)) = animation {
        encoder.set_animated(frames.len() as u32, plays).map_err(fail)?;
        encoder.set_frame_delay(numerator, denominator).map_err(fail)?;
    }
    for (keyword, text) in texts {
        encoder.add_itxt_chunk((*keyword).to_owned(), (*text).to_owned()).map_err(fail)?;
    }
    let mut writer = encoder.write_header().map_err(fail)?;
    for frame in frames {
        let raw: Vec<u8> = if frame.largest == 255 {
            frame.codes.iter().map(|&code| code as u8).collect()
        } else {
            frame.codes.iter().flat_map(|code| code.to_be_bytes()).collect()
        };
        writer.write_image_data(&raw).map_err(fail)?;
    }
    writer.finish().map_err(fail)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::row;

    pub(crate) fn raster(channels: usize, largest: u16) -> Raster {
        let (width, height) = (37, 5);
        let codes = (0..width * height * channels)
            .map(|i| ((i * 7919) % (usize::from(largest) + 1)) as u16)
            .collect();
        Raster { width, height, channels, largest, codes, ignored: Vec::new() }
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
        // What follows the picture's data (the end chunk) may go.
        for end in 0..bytes.len() - 16 {
            assert!(read("a.png", &bytes[..end]).is_err(), "cut at {end}");
        }
        for at in 0..bytes.len() {
            let mut hurt = bytes.clone();
            hurt[at] ^= 1 << (at % 8);
            drop(read("a.png", &hurt));
        }
    }

    /// Mutation: `checked_mul` to `wrapping_mul` in `believable` (seen red).
    #[test]
    fn row_65_sizes_are_not_believed_and_do_not_overflow() {
        assert!(believable("a", u64::MAX, u64::MAX, 4, 1000, 10).is_err());
        assert!(believable("a", 1 << 32, 1 << 32, 1, usize::MAX, 1).is_err());
        for (width, height) in [(1, 1), (30_000, 1), (1, 30_011), (127, 61)] {
            let codes = (0..width * height * 3).map(|i| (i % 251) as u16).collect();
            let raster = Raster { width, height, channels: 3, largest: 255, codes, ignored: Vec::new() };
            let bytes = write(&raster, true, &[]).unwrap_or_else(|e| panic!("{e}"));
            let same = read("a.png", &bytes).is_ok_and(|back| back == raster);
            row(65, "sizes that do not come back", f64::from(u8::from(!same)), 0.0);
        }
        assert!(believable("a", 1 << 40, 1 << 40, 3, 1000, 10).is_err());
        assert!(believable("a", 0, 3, 3, 1000, 10).is_err());
        assert!(believable("a", 10, 10, 3, 30, 10).is_ok());
        assert!(believable("a", 10, 10, 4, 30, 10).is_err());
    }
}
