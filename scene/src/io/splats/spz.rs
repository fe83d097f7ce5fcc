//! SPZ (nianticlabs/spz, README and `load-spz.cc`), versions 1 to 4. Versions 1 to 3 are one gzip stream. Version 4
//! has an uncompressed header and a Zstandard stream per attribute. An uncompressed stream is also read.
//!
//! Attributes are stored one after the other: centres (24-bit fixed point; 16-bit floats in version 1), opacities,
//! colours, log scales, rotations, harmonics. Rotations have three bytes up to version 2; from version 3 on, they
//! are the three smaller components in 10 bits each. Axes are right, up, back unless the extension
//! `SPZ_ADOBE_coordinate_system` names others.

use engine::{NodeError, Notes, Up};
use glam::{DMat3, DVec3};

use super::bytes::{believed, f16_at, range, u8_at, u32_at, u64_at};
use super::frame::{Frame, Turn};
use super::inflate::{DEFLATE_RATIO, gunzip, unzstd};
use super::loaded::Loaded;
use super::reading::Reading;
use super::rows::{Row, largest_left_out, sh_rest};
use crate::error::Error;
use crate::math::num;
use crate::types::frame::Similarity;

/// The first bytes of every version after decompression.
pub(super) const MAGIC: &[u8; 4] = b"NGSP";
/// First bytes of a gzip stream.
pub(super) const GZIP: [u8; 2] = [0x1f, 0x8b];

const HEADER: usize = 16;
const HEADER_4: usize = 32;
const ANTIALIASED: u8 = 1;
const EXTENDED: u8 = 2;
/// Maximum number of bytes of extensions after the attributes of versions 1 to 3.
const EXTENSIONS: usize = 1 << 20;
/// Maximum number of decompressed bytes per byte of a version 4 file. The reference implementation has the same
/// limit. In captures, the number is at most 3.
const ZSTD_RATIO: f64 = 1024.0;

/// A coefficient `c` of the constant colour is stored as `c * COLOUR_SCALE + 0.5`, in a byte in which 255
/// represents 1.
pub(crate) const COLOUR_SCALE: f64 = 0.15;
/// Type of the extension that defines the axes.
const COORDINATE_SYSTEM: u32 = 0xadbe_0003;

/// The first 16 bytes, the same in all versions.
#[derive(Clone, Copy)]
struct Header {
    version: u32,
    count: u64,
    degree: u32,
    fraction_bits: u32,
    flags: u8,
    streams: usize,
}

impl Header {
    fn read(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        if bytes.starts_with(b"ply") {
            return Err(Error::unsupported(
                file,
                "a PLY file compressed with gzip; unpack it, for instance with `gunzip`",
            ));
        }
        if bytes.get(..4) != Some(MAGIC) {
            return Err(Error::format(
                file,
                "the stream does not begin with `NGSP`, so the file is not an SPZ file",
            ));
        }
        let header = Self {
            version: u32_at(bytes, 4),
            count: u64::from(u32_at(bytes, 8)),
            degree: u32::from(u8_at(bytes, 12)),
            fraction_bits: u32::from(u8_at(bytes, 13)),
            flags: u8_at(bytes, 14),
            streams: usize::from(u8_at(bytes, 15)),
        };
        if !(1..=4).contains(&header.version) {
            return Err(Error::unsupported(file, format!("version {} of SPZ", header.version)));
        }
        if header.degree > 4 {
            return Err(Error::format(
                file,
                format!("the degree of the spherical harmonics is {}, not 0 to 4", header.degree),
            ));
        }
        if header.fraction_bits > 31 {
            return Err(Error::format(
                file,
                format!("the centres have {} fraction bits; the maximum is 31", header.fraction_bits),
            ));
        }
        Ok(header)
    }

    /// Bytes per splat of each attribute: centre, opacity, colour, scale, rotation, harmonics.
    fn sizes(&self) -> [usize; 6] {
        let centre = if self.version == 1 { 6 } else { 9 };
        let rotation = if self.version <= 2 { 3 } else { 4 };
        [centre, 1, 3, 3, rotation, sh_rest(self.degree) * 3]
    }
}

/// Decompressed attributes.
struct Attributes {
    header: Header,
    count: usize,
    /// The attributes, in the order of [`Header::sizes`].
    streams: [Vec<u8>; 6],
    extensions: Vec<u8>,
    /// Number of bytes of the file after the last attribute.
    left_over: usize,
}

/// Decompresses a file of any version.
fn unpack(file: &str, bytes: &[u8]) -> Result<Attributes, Error> {
    if bytes.starts_with(MAGIC) {
        let header = Header::read(file, range(file, bytes, 0, HEADER, "the header")?)?;
        return match header.version {
            4 => unpack_4(file, bytes, header),
            _ => split(file, bytes, header),
        };
    }
    let (plain, left_over) = gunzip(file, bytes, |head| {
        let header = Header::read(file, head)?;
        let each: usize = header.sizes().iter().sum();
        let count = believed(file, header.count, bytes.len(), DEFLATE_RATIO as f64 / each as f64)?;
        Ok(HEADER + count * each + EXTENSIONS)
    })?;
    let header = Header::read(file, &plain)?;
    if header.version == 4 {
        return Err(Error::format(
            file,
            "the file is a gzip stream, but contains SPZ version 4, which must not be compressed with gzip",
        ));
    }
    let attributes = split(file, &plain, header)?;
    Ok(Attributes { left_over: attributes.left_over + left_over, ..attributes })
}

/// Splits the single stream of versions 1 to 3 into attributes.
fn split(file: &str, bytes: &[u8], header: Header) -> Result<Attributes, Error> {
    let each: usize = header.sizes().iter().sum();
    let count = believed(file, header.count, bytes.len().saturating_sub(HEADER), 1.0 / each as f64)?;
    let mut at = HEADER;
    let mut streams: [Vec<u8>; 6] = Default::default();
    for (stream, size) in streams.iter_mut().zip(header.sizes()) {
        *stream = range(file, bytes, at, count * size, "an attribute")?.to_vec();
        at += stream.len();
    }
    let after = bytes.get(at..).unwrap_or_default();
    let (extensions, left_over) =
        if header.flags & EXTENDED == 0 { (Vec::new(), after.len()) } else { (after.to_vec(), 0) };
    Ok(Attributes { header, count, streams, extensions, left_over })
}

fn unpack_4(file: &str, bytes: &[u8], header: Header) -> Result<Attributes, Error> {
    range(file, bytes, 0, HEADER_4, "the header")?;
    let each: usize = header.sizes().iter().sum();
    let count = believed(file, header.count, bytes.len(), ZSTD_RATIO / each as f64)?;
    let contents = u32_at(bytes, 16) as usize;
    if contents < HEADER_4 {
        return Err(Error::format(
            file,
            format!("the table of contents begins at byte {contents}, inside the header"),
        ));
    }
    let table = range(file, bytes, contents, header.streams * 16, "the table of contents")?;
    let mut entries = table.as_chunks::<16>().0.iter();
    let mut at = contents + table.len();
    let mut streams: [Vec<u8>; 6] = Default::default();
    for (stream, size) in streams.iter_mut().zip(header.sizes()) {
        // Attributes without bytes have no stream.
        let length = count * size;
        if length == 0 {
            continue;
        }
        let entry = entries.next().ok_or_else(|| Error::format(file, "a stream is missing"))?;
        let (packed, promised) = (u64_at(entry, 0), u64_at(entry, 8));
        if promised != length as u64 {
            let what = format!("a stream has {promised} bytes, but {count} splats need {length}");
            return Err(Error::format(file, what));
        }
        let packed = range(file, bytes, at, usize::try_from(packed).unwrap_or(usize::MAX), "a stream")?;
        at += packed.len();
        *stream = unzstd(file, packed, length)?;
    }
    if entries.next().is_some() {
        return Err(Error::format(file, "there are more streams than attributes"));
    }
    let extensions = bytes.get(HEADER_4..contents).unwrap_or_default().to_vec();
    Ok(Attributes { header, count, streams, extensions, left_over: bytes.len() - at })
}

/// The orthogonal map from the axes that an extension defines to right, up, back; `None` if the file does not
/// contain that extension.
fn named_axes(file: &str, flags: u8, mut records: &[u8]) -> Result<Option<DMat3>, Error> {
    if flags & EXTENDED == 0 {
        return Ok(None);
    }
    // Records of type, length and payload, one after the other; unknown types are skipped.
    while records.len() >= 8 {
        let (kind, length) = (u32_at(records, 0), u32_at(records, 4) as usize);
        let payload = range(file, records, 8, length, "an extension")?;
        if kind == COORDINATE_SYSTEM {
            let code = match u32_at(payload, 0) {
                0 => return Ok(None),
                code @ 1..=16 => code - 1,
                other => {
                    return Err(Error::format(file, format!("the coordinate system {other} is unknown")));
                }
            };
            let sign = |bit: u32| if code & bit == 0 { -1.0 } else { 1.0 };
            // Bit 0: x is right rather than left; 1: up rather than down; 2 and 3 as below.
            let (right, up) = (sign(1), sign(2));
            return Ok(Some(if code & 8 == 0 {
                // z is forward if bit 2 is set.
                DMat3::from_diagonal(DVec3::new(right, up, -sign(4)))
            } else {
                // y and z are exchanged; y is back if bit 2 is set.
                DMat3::from_cols(DVec3::X * right, DVec3::Z * sign(4), DVec3::Y * up)
            }));
        }
        records = records.get(8 + length..).unwrap_or_default();
    }
    Ok(None)
}

/// Decodes a rotation to a quaternion (w, x, y, z) of approximate length 1. The bits are the index of the omitted
/// component in the order x, y, z, w, then the sign and magnitude of each of the others.
pub fn rotation_10(word: u32) -> [f64; 4] {
    let part = |shift: u32| {
        let size = f64::from(word >> shift & 511) / 511.0 * std::f64::consts::FRAC_1_SQRT_2;
        if word >> (shift + 9) & 1 == 1 { -size } else { size }
    };
    let [x, y, z, w] = largest_left_out((word >> 30) as usize, [part(20), part(10), part(0)]);
    [w, x, y, z]
}

fn rotation_8(bytes: [u8; 3]) -> [f64; 4] {
    largest_left_out(0, bytes.map(|b| f64::from(b) / 127.5 - 1.0))
}

/// Loads a file. `local` is `Some` for SPZ data within glTF. It contains the transform of the node, if any, which
/// replaces the transform that follows from the axes of the file.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    local: Option<Option<&Turn>>,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let Attributes { header, count, streams, extensions, left_over } = unpack(file, bytes)?;
    super::loaded::left_over(file, left_over, notes);
    if header.version <= 2 {
        let text = format!(
            "`{file}` is a file of SPZ version {}, so its rotations have errors of up to 12 degrees",
            header.version
        );
        notes.warning("coarse-rotations", text);
    }
    let own;
    let turn = match local {
        Some(turn) => turn,
        None => {
            let axes = named_axes(file, header.flags, &extensions)?;
            if axes.is_none() {
                let text = format!(
                    "`{file}` does not name its axes, and the specification of SPZ has +y up; splat-transform 3 writes \
                     the axes of its input unchanged, and `frame: AsStored` reads such files"
                );
                notes.decision("spz-axes", text);
            }
            let axes = axes.filter(|_| reading.placing.frame == Frame::ByFormat).unwrap_or(DMat3::IDENTITY);
            let world = reading.world(file, Some(Up::PlusY), false, notes);
            let world = world.unwrap_or(Similarity::IDENTITY);
            let all = Similarity { rotation: world.rotation * axes, ..world };
            own = (all != Similarity::IDENTITY).then(|| Turn::new(all.rotation, all.scale, all.offset));
            own.as_ref()
        }
    };
    let [centres, opacities, colours, scales, rotations, harmonics] = &streams;
    let step = 1.0 / f64::from(1_u32 << header.fraction_bits);
    let sizes: Vec<f64> = (0..256).map(|b| num::f64::exp(f64::from(b) / 16.0 - 10.0)).collect();
    let rest = sh_rest(header.degree);
    let parts = reading.rows(count, turn, |index, sh| {
        let byte = |stream: &[u8], at: usize| f64::from(u8_at(stream, at));
        let mean = [0, 1, 2].map(|i| match header.version {
            1 => f16_at(centres, index * 6 + i * 2),
            _ => {
                let at = index * 9 + i * 3;
                let bytes = [0, u8_at(centres, at), u8_at(centres, at + 1), u8_at(centres, at + 2)];
                // The shift extends the sign.
                f64::from(i32::from_le_bytes(bytes) >> 8) * step
            }
        });
        let quat = match header.version {
            1 | 2 => rotation_8([0, 1, 2].map(|i| u8_at(rotations, index * 3 + i))),
            _ => rotation_10(u32_at(rotations, index * 4)),
        };
        let scale = [0, 1, 2].map(|i| sizes[usize::from(u8_at(scales, index * 3 + i))]);
        sh.push([0, 1, 2].map(|c| ((byte(colours, index * 3 + c) / 255.0 - 0.5) / COLOUR_SCALE) as f32));
        for i in 0..rest {
            let at = (index * rest + i) * 3;
            sh.push([0, 1, 2].map(|c| ((byte(harmonics, at + c) - 128.0) / 128.0) as f32));
        }
        Row::checked(mean, quat, scale, byte(opacities, index) / 255.0, reading.max_extent)
    })?;
    let mut loaded = Loaded::new(parts, count, header.degree);
    loaded.antialiased = header.flags & ANTIALIASED != 0;
    Ok(loaded)
}
