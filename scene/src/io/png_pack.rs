//! The pixel data of a PNG: rows filtered on all threads, then deflated in order.
//!
//! The bytes are those that the crate `png` writes. Its stream writer could be cancelled between rows as well, but
//! filters rows on one thread, which is most of the work and takes ten seconds for a picture of a hundred
//! megapixels.

use std::io::{Cursor, Write};

use flate2::write::ZlibEncoder;

use super::progress::Progress;
use super::raster::Raster;
use crate::error::Error;

/// Compression effort.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packing {
    /// Makes small files: each row uses the filter whose output, as signed bytes, has the smallest sum of
    /// magnitudes. The deflate level is 6.
    Small,
    /// Takes a tenth of the time and makes larger files: stores differences from the row above, deflated with a
    /// fixed code.
    Fast,
}

/// Number of bytes of filtered rows that are held in memory at a time, in addition to the picture.
const BATCH: usize = 1 << 18;

enum Deflate {
    Small(ZlibEncoder<Vec<u8>>),
    Fast(fdeflate::Compressor<Cursor<Vec<u8>>>),
}

impl Deflate {
    /// Creates a compressor whose output buffer has a capacity of `room` bytes, so that its memory is known in
    /// advance.
    fn new(packing: Packing, room: usize) -> std::io::Result<Self> {
        let room = Vec::with_capacity(room);
        Ok(match packing {
            Packing::Small => Self::Small(ZlibEncoder::new(room, flate2::Compression::new(6))),
            Packing::Fast => Self::Fast(fdeflate::Compressor::new(Cursor::new(room))?),
        })
    }

    fn put(&mut self, row: &[u8]) -> std::io::Result<()> {
        match self {
            Self::Small(deflate) => deflate.write_all(row),
            Self::Fast(deflate) => deflate.write_data(row),
        }
    }

    fn finish(self) -> std::io::Result<Vec<u8>> {
        match self {
            Self::Small(deflate) => deflate.finish(),
            Self::Fast(deflate) => Ok(deflate.finish()?.into_inner()),
        }
    }
}

/// The data of a picture: all filtered rows, each preceded by the number of its filter, deflated.
pub fn pack(raster: &Raster, packing: Packing, progress: Progress<'_>) -> Result<Vec<u8>, Error> {
    let fail = |e: std::io::Error| Error::Mismatch(format!("cannot encode the picture as PNG: {e}"));
    let rows = raster.height;
    let step = (BATCH / (raster.width * raster.channels * 2).max(1)).clamp(1, 256);
    let length = raster.width * raster.channels * if raster.largest == 255 { 1 } else { 2 } + 1;
    // Incompressible data is stored, with 5 bytes per block.
    let mut deflate = Deflate::new(packing, length * rows + length * rows / 1000 + 64).map_err(fail)?;
    for start in (0..rows).step_by(step) {
        progress.report(start as f32 / rows as f32)?;
        let filtered = progress.tiles(step.min(rows - start), |i| filtered(raster, start + i, packing));
        for row in filtered? {
            deflate.put(&row).map_err(fail)?;
        }
    }
    let packed = deflate.finish().map_err(fail)?;
    if packing == Packing::Fast
        && packed.len() > fdeflate::StoredOnlyCompressor::<()>::compressed_size(length * rows)
    {
        // The fixed code makes noise longer, so noise is stored uncompressed.
        let mut stored = fdeflate::StoredOnlyCompressor::new(Cursor::new(Vec::new())).map_err(fail)?;
        for y in 0..rows {
            stored.write_data(&[0]).map_err(fail)?;
            stored.write_data(&row(raster, y)).map_err(fail)?;
        }
        return Ok(stored.finish().map_err(fail)?.into_inner());
    }
    Ok(packed)
}

/// The bytes of row `y` before filtering.
fn row(raster: &Raster, y: usize) -> Vec<u8> {
    let samples = raster.width * raster.channels;
    let codes = &raster.codes[y * samples..(y + 1) * samples];
    if raster.largest == 255 {
        codes.iter().map(|&code| code as u8).collect()
    } else {
        codes.iter().flat_map(|code| code.to_be_bytes()).collect()
    }
}

/// Filters row `y` and returns the number of the filter, followed by the filtered bytes. `packing` determines which
/// filters are tried; the filter whose output, as signed bytes, has the smallest sum of magnitudes is used.
fn filtered(raster: &Raster, y: usize, packing: Packing) -> Vec<u8> {
    let back = raster.channels * if raster.largest == 255 { 1 } else { 2 };
    let now = row(raster, y);
    let above = if y == 0 { vec![0; now.len()] } else { row(raster, y - 1) };
    // Of filters with equal sums, the last is used; a sum of 0 ends the search.
    let tried: &[u8] = if packing == Packing::Fast { &[UP] } else { &[UP, SUB, AVERAGE, PAETH] };
    let (mut best, mut least) = (Vec::new(), u64::MAX);
    for filter in tried {
        let made = apply(*filter, back, &above, &now);
        let sum: u64 = made[1..].iter().map(|b| u64::from(b.cast_signed().unsigned_abs())).sum();
        if sum <= least {
            (best, least) = (made, sum);
        }
        if least == 0 {
            break;
        }
    }
    best
}

// Numbers of filters, PNG 1.2, section 6.
const SUB: u8 = 1;
const UP: u8 = 2;
const AVERAGE: u8 = 3;
const PAETH: u8 = 4;

/// Applies a filter. Returns its number and the filtered row; `back` is the distance in bytes to the previous
/// pixel.
fn apply(filter: u8, back: usize, above: &[u8], now: &[u8]) -> Vec<u8> {
    let mut made = Vec::with_capacity(now.len() + 1);
    made.push(filter);
    // Pixels before the first are 0.
    let (head, tail) = now.split_at(back.min(now.len()));
    let left = &now[..tail.len()];
    let (above_head, above_tail) = above.split_at(head.len());
    let above_left = &above[..tail.len()];
    match filter {
        SUB => {
            made.extend(head);
            made.extend(tail.iter().zip(left).map(|(x, a)| x.wrapping_sub(*a)));
        }
        UP => made.extend(now.iter().zip(above).map(|(x, b)| x.wrapping_sub(*b))),
        AVERAGE => {
            made.extend(head.iter().zip(above_head).map(|(x, b)| x.wrapping_sub(*b / 2)));
            let mean = |a: u8, b: u8| (a & b) + ((a ^ b) >> 1);
            made.extend(
                tail.iter().zip(left).zip(above_tail).map(|((x, a), b)| x.wrapping_sub(mean(*a, *b))),
            );
        }
        _ => {
            made.extend(head.iter().zip(above_head).map(|(x, b)| x.wrapping_sub(*b)));
            let near = left.iter().zip(above_tail).zip(above_left);
            made.extend(tail.iter().zip(near).map(|(x, ((a, b), c))| x.wrapping_sub(paeth(*a, *b, *c))));
        }
    }
    made
}

/// Returns the neighbour (left, above or upper left) that is nearest to left + above - upper left; the first of
/// them in this order if several are equally near.
fn paeth(a: u8, b: u8, c: u8) -> u8 {
    let (toward_a, toward_b) = (i16::from(b) - i16::from(c), i16::from(a) - i16::from(c));
    let (pa, pb, pc) = (toward_a.abs(), toward_b.abs(), (toward_a + toward_b).abs());
    if pa <= pb && pa <= pc {
        a
    } else if pb <= pc {
        b
    } else {
        c
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raster(width: usize, height: usize, channels: usize, largest: u16, noise: u32) -> Raster {
        let mut state = 1_u32;
        let mut code = |i: usize| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((i * 7 / channels) as u32 % 1999 + (state >> 8) % noise) as u16 & largest
        };
        let codes = (0..width * height * channels).map(&mut code).collect();
        Raster { width, height, channels, largest, codes, ignored: Vec::new(), colour: None }
    }

    /// The data that the library writes for the whole picture.
    fn at_once(raster: &Raster, packing: Packing) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, raster.width as u32, raster.height as u32);
        encoder.set_color(
            [
                png::ColorType::Grayscale,
                png::ColorType::GrayscaleAlpha,
                png::ColorType::Rgb,
                png::ColorType::Rgba,
            ][raster.channels - 1],
        );
        encoder.set_depth(if raster.largest == 255 { png::BitDepth::Eight } else { png::BitDepth::Sixteen });
        let (compression, filter) = match packing {
            Packing::Small => (png::Compression::Balanced, png::Filter::Adaptive),
            Packing::Fast => (png::Compression::Fast, png::Filter::Up),
        };
        encoder.set_compression(compression);
        encoder.set_filter(filter);
        let raw: Vec<u8> = (0..raster.height).flat_map(|y| row(raster, y)).collect();
        let mut writer = encoder.write_header().expect("a header");
        writer.write_image_data(&raw).expect("a picture");
        writer.finish().expect("an end");
        bytes
    }

    /// Packing row by row gives the same bytes as the library. This test fails if `sum <= least` is replaced with
    /// `sum < least`, or if the fallback for noise is removed.
    #[test]
    fn rows_give_the_bytes_of_the_whole_picture() {
        for (largest, noise) in [(255, 1), (255, 9), (255, 256), (65_535, 1), (65_535, 300), (65_535, 65_536)]
        {
            for channels in 1..=4 {
                for (width, height) in [(1, 1), (3, 700), (97, 41)] {
                    let raster = raster(width, height, channels, largest, noise);
                    for packing in [Packing::Small, Packing::Fast] {
                        let made =
                            super::super::png::write_for(&raster, packing, None, &[], Progress::UNTRACKED);
                        let what = format!("{width}x{height}x{channels}, {largest}, {noise}, {packing:?}");
                        assert!(made.is_ok_and(|made| made == at_once(&raster, packing)), "{what}");
                    }
                }
            }
        }
    }
}
