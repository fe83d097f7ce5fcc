//! Size of a picture from the first bytes of its file. It is used to estimate memory before the file is read.

use std::io::{BufRead, Read, Seek, SeekFrom};

use exr::meta::header::Header;
use exr::prelude::MetaData;

use super::exr::choose_part;
use super::hdr::sides;
use super::ply;
use super::tiff;
use super::turn::Turn;

/// Size and format of a picture from the head of its file, without validation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Head {
    /// Width and height in pixels.
    pub size: [u64; 2],
    /// Samples per pixel. For OpenEXR, the samples of all layers of the part are counted.
    pub channels: u64,
    /// Number of bytes per pixel that the decoder returns. For OpenEXR, the number of bytes per pixel that the
    /// largest part needs in addition to this part.
    pub decoded: u64,
    /// True if the samples are floats of linear light; false if they are integer codes.
    pub floats: bool,
    /// True if the metadata (EXIF) say that the picture is turned by 90 degrees when it is upright.
    pub is_quarter_turned: bool,
}

impl Head {
    /// Reads the head of a PNG, JPEG, TIFF, WebP, OpenEXR or Radiance picture at the position of the reader; `None` for
    /// other formats and truncated files.
    pub fn read(reader: &mut (impl BufRead + Seek)) -> Option<Self> {
        let begin = reader.stream_position().ok()?;
        let mut magic = [0; 4];
        reader.read_exact(&mut magic).ok()?;
        match magic {
            [0x89, b'P', b'N', b'G'] => png(reader),
            [0xff, 0xd8, ..] => {
                reader.seek(SeekFrom::Start(begin + 2)).ok()?;
                jpeg(reader)
            }
            [b'#', b'?', ..] => radiance(reader),
            [b'R', b'I', b'F', b'F'] => webp(reader),
            magic if tiff::is_tiff(&magic) => {
                reader.seek(SeekFrom::Start(begin)).ok()?;
                tiff_head(reader)
            }
            [0x76, 0x2f, 0x31, 0x01] => {
                reader.seek(SeekFrom::Start(begin)).ok()?;
                exr(reader)
            }
            _ => None,
        }
    }

    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        let [width, height] = self.size;
        width.saturating_mul(height)
    }

    /// Peak memory, in addition to the file, for reading the picture as floats, and the size of the floats, both in
    /// bytes.
    pub fn as_floats(&self) -> [u64; 2] {
        let samples = self.pixels().saturating_mul(self.channels);
        if self.floats {
            // The decoder writes the channels of one picture directly to its pixels.
            let floats = self.pixels().saturating_mul(4 * self.channels.min(4));
            return [self.pixels().saturating_mul(self.decoded).saturating_add(floats), floats];
        }
        let floats = self.pixels().saturating_mul(4 * self.channels.max(3));
        // The decoded picture and codes of 16 bits, then the codes and the floats.
        let codes = samples.saturating_mul(2);
        let decoding = self.pixels().saturating_mul(self.decoded);
        [codes.saturating_add(decoding.max(floats)), floats]
    }

    /// Peak memory, in addition to the file, for reading the picture as 8-bit texels, and the size of the texels,
    /// both in bytes.
    pub fn as_texels(&self) -> [u64; 2] {
        let texels = self.pixels().saturating_mul(4);
        let codes = self.pixels().saturating_mul(2 * self.channels);
        [codes.saturating_add(texels.max(self.pixels().saturating_mul(self.decoded))), texels]
    }
}

fn bytes<const N: usize>(reader: &mut impl Read) -> Option<[u8; N]> {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes).ok()?;
    Some(bytes)
}

/// Reads a PNG after the first half of its signature: the second half, the length and type of the first chunk,
/// width, height, depth and colour type.
fn png(reader: &mut (impl Read + Seek)) -> Option<Head> {
    let head: [u8; 22] = bytes(reader)?;
    let number = |at: usize| Some(u64::from(u32::from_be_bytes(*head.get(at..)?.first_chunk()?)));
    let channels = match head[21] {
        0 => 1,
        2 => 3,
        4 => 2,
        // A palette may have alpha.
        _ => 4,
    };
    let wide = u64::from(head[20] == 16);
    let (size, decoded) = ([number(12)?, number(16)?], channels * (1 + wide));
    let is_quarter_turned = png_turn(reader).is_some_and(Turn::is_quarter);
    Some(Head { size, channels, decoded, floats: false, is_quarter_turned })
}

/// The orientation in the chunk `eXIf`, which may lie before or after the picture. The reader is 7 bytes before the
/// second chunk.
fn png_turn(reader: &mut (impl Read + Seek)) -> Option<Turn> {
    reader.seek(SeekFrom::Current(7)).ok()?;
    loop {
        let length = u32::from_be_bytes(bytes(reader)?);
        match &bytes::<4>(reader)? {
            b"eXIf" if length <= 1 << 16 => {
                let mut exif = vec![0; length as usize];
                reader.read_exact(&mut exif).ok()?;
                return Some(Turn::of_exif(&exif));
            }
            b"IEND" => return None,
            // The data and its check sum.
            _ => reader.seek(SeekFrom::Current(i64::from(length) + 4)).ok()?,
        };
    }
}

/// Reads the first directory of a TIFF.
fn tiff_head(reader: &mut (impl BufRead + Seek)) -> Option<Head> {
    let tiff::Shape { size, channels, bits, turn } = tiff::shape(reader)?;
    // The decoded samples and a strip of them; grey becomes three channels.
    let decoded = channels * bits.div_ceil(8) * 2;
    let channels = channels.max(3);
    Some(Head { size, channels, decoded, floats: true, is_quarter_turned: turn.is_quarter() })
}

/// Reads segments up to the frame header, which has the size.
fn jpeg(reader: &mut (impl Read + Seek)) -> Option<Head> {
    let mut is_quarter_turned = false;
    loop {
        let [0xff, marker] = bytes::<2>(reader)? else { return None };
        if marker == 0xff {
            reader.seek(SeekFrom::Current(-1)).ok()?;
            continue;
        }
        let length = i64::from(u16::from_be_bytes(bytes(reader)?));
        // Frame segments of all types; not the tables of Huffman and arithmetic codes.
        if matches!(marker, 0xc0..=0xcf) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) {
            let [_, h0, h1, w0, w1] = bytes::<5>(reader)?;
            let size = |high, low| u64::from(u16::from_be_bytes([high, low]));
            // A progressive decoder keeps the coefficients of all blocks, two bytes each.
            let decoded = if marker == 0xc2 { 9 } else { 3 };
            let size = [size(w0, w1), size(h0, h1)];
            return Some(Head { size, channels: 3, decoded, floats: false, is_quarter_turned });
        }
        // The segment of EXIF data; other programs use the same marker for XMP.
        if marker == 0xe1 {
            let mut data = vec![0; usize::try_from(length - 2).ok()?];
            reader.read_exact(&mut data).ok()?;
            is_quarter_turned |= data.starts_with(b"Exif\0\0") && Turn::of_exif(&data).is_quarter();
            continue;
        }
        reader.seek(SeekFrom::Current(length - 2)).ok()?;
    }
}

/// Reads a Radiance header. The line with the size follows an empty line.
fn radiance(reader: &mut impl BufRead) -> Option<Head> {
    let mut line = String::new();
    let (mut all, mut last) = (reader.take(1 << 20), false);
    loop {
        line.clear();
        all.read_line(&mut line).ok().filter(|read| *read > 0)?;
        if last {
            let [rows, columns] = sides(&line)?;
            let [width, height] =
                if rows.across { [rows.count, columns.count] } else { [columns.count, rows.count] };
            let size = [u64::from(width), u64::from(height)];
            return Some(Head { size, channels: 3, decoded: 0, floats: true, is_quarter_turned: false });
        }
        last = line.trim_end().is_empty();
    }
}

fn webp(reader: &mut (impl BufRead + Seek)) -> Option<Head> {
    reader.seek(SeekFrom::Current(-4)).ok()?;
    let (width, height) = image_webp::WebPDecoder::new(reader).ok()?.dimensions();
    let size = [u64::from(width), u64::from(height)];
    Some(Head { size, channels: 4, decoded: 4, floats: false, is_quarter_turned: false })
}

/// Reads the head of the part that is used when no layer is named. Since another part may be named, `decoded` is
/// the memory that the largest flat part needs in addition to this part.
fn exr(reader: &mut (impl BufRead + Seek)) -> Option<Head> {
    let meta = MetaData::read_from_buffered(reader, false).ok()?;
    let (header, _) = choose_part(&meta.headers, "")?;
    let area = |header: &Header| (header.layer_size.0 as u64).saturating_mul(header.layer_size.1 as u64);
    // Bytes of the pixels of one picture. Its channels are read directly into them.
    let floats =
        |header: &Header| area(header).saturating_mul(4 * (header.channels.list.len() as u64).min(4));
    let (width, height) = (header.layer_size.0 as u64, header.layer_size.1 as u64);
    let channels = header.channels.list.len() as u64;
    let more = |other: &Header| floats(other).saturating_sub(floats(header)).div_ceil(area(header).max(1));
    let flat = meta.headers.iter().filter(|header| !header.deep);
    let decoded = flat.map(more).max().unwrap_or(0);
    Some(Head { size: [width, height], channels, decoded, floats: true, is_quarter_turned: false })
}

/// Reads the header of a PLY file. Returns `None` if it is longer than 64 KiB or invalid.
pub fn ply_header(reader: &mut impl BufRead) -> Option<ply::Header> {
    let mut head = Vec::new();
    reader.take(1 << 16).read_to_end(&mut head).ok()?;
    ply::header("", &head).ok()
}

/// The elements of a PLY file, each as (name, number of rows, number of properties).
pub fn elements_of(header: &ply::Header) -> Vec<(String, u64, u64)> {
    header.elements.iter().map(|e| (e.name.clone(), e.rows, e.properties.len() as u64)).collect()
}

/// Like [`elements_of`], read from the start of a file; empty if the header is longer than 64 KiB or invalid.
pub fn ply_elements(reader: &mut impl BufRead) -> Vec<(String, u64, u64)> {
    ply_header(reader).as_ref().map_or_else(Vec::new, elements_of)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::io::{exr as exr_file, jpeg as jpeg_file, png as png_file};

    fn of(bytes: &[u8]) -> Option<(u64, u64)> {
        Head::read(&mut Cursor::new(bytes)).map(|head| (head.pixels(), head.channels))
    }

    #[test]
    fn heads_of_every_format_and_no_cut_panics() {
        let raster = |channels: usize| png_file::Raster {
            width: 31,
            height: 7,
            channels,
            largest: 255,
            codes: vec![9; 31 * 7 * channels],
            ignored: Vec::new(),
            colour: None,
        };
        let plane = |name: &str| {
            let samples = vec![0.5; 31 * 7];
            (exr_file::Channel { name: name.to_owned(), samples }, exr_file::Depth::Float)
        };
        let files = [
            (png_file::write(&raster(1), true, &[]).unwrap_or_default(), 1),
            (png_file::write(&raster(4), true, &[("k", "text")]).unwrap_or_default(), 4),
            // The comments come before the frame.
            (jpeg_file::write(&raster(3), 80, Some(&"x".repeat(200_000))).unwrap_or_default(), 3),
            (exr_file::write(31, 7, vec![plane("Z"), plane("A")], "", None).unwrap_or_default().0, 2),
            (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 7 +X 31\n".to_vec(), 3),
        ];
        for (bytes, channels) in &files {
            assert_eq!(of(bytes), Some((217, *channels)));
            for end in 0..bytes.len().min(400) {
                let _ = of(&bytes[..end]);
            }
        }
        assert_eq!(of(b"ply\nformat"), None);
    }
}
