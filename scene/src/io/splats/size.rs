//! Number of splats of a file according to its header. It is used to estimate memory before the file is read.

use std::io::Read;

use engine::FileHead;
use flate2::read::GzDecoder;

use super::bytes::{u8_at, u32_at};
use super::rows::{Row, sh_rest};
use super::{fixed_rows, ksplat, spz};
use crate::io::head::{elements_of, ply_header};

/// Estimates two sizes in bytes: of the rows of a file, and of its decompressed data. The number of splats is taken
/// from the header if the format stores it there. Otherwise it is estimated from the length of the file and the
/// usual size of a splat in such files.
pub fn of(file: &FileHead<'_>) -> (u64, u64) {
    let mut head = Vec::new();
    let read = file.open().map(|reader| reader.take(64).read_to_end(&mut head));
    if read.is_none_or(|read| read.is_err()) {
        return (0, 0);
    }
    // A scene of degree 3 if the degree is unknown.
    let of = |count: u64, degree: u32, packed: u64| {
        let row = (size_of::<Row>() + 12 * (1 + sh_rest(degree))) as u64;
        (count.saturating_mul(row), count.saturating_mul(packed))
    };
    match head[..] {
        [b'p', b'l', b'y', ..] | [0xef, 0xbb, 0xbf, b'p', b'l', b'y', ..] => {
            let header = file.open().and_then(|mut reader| ply_header(&mut reader));
            let elements = header.as_ref().map_or_else(Vec::new, elements_of);
            // Some files are first converted to a second file in memory.
            let converted = header.iter().filter(|header| fixed_rows::is_converted(header));
            let stride = converted
                .flat_map(|header| &header.elements)
                .filter(|element| element.name == "vertex")
                .flat_map(|element| &element.properties)
                .map(|property| property.scalar.size() as u64)
                .sum();
            let found = |wanted: &str| elements.iter().find(|(name, ..)| name == wanted);
            let vertices = found("vertex").map_or((0, 0), |(_, count, fields)| (*count, *fields));
            // Nine for degree 1, 24 for 2, 45 for 3, 72 for 4, among the fields or in a separate element.
            let fields = vertices.1 + found("sh").map_or(0, |(.., fields)| *fields);
            let degree = [72, 45, 24, 9].iter().position(|least| fields >= *least).map_or(0, |at| 4 - at);
            of(vertices.0, degree as u32, stride)
        }
        [0x1f, 0x8b, ..] | [b'N', b'G', b'S', b'P', ..] => {
            let mut plain = vec![0; 16];
            if head[0] == 0x1f {
                let unpacked = file.open().map(|reader| GzDecoder::new(reader).read_exact(&mut plain));
                if unpacked.is_none_or(|read| read.is_err()) {
                    return (0, 0);
                }
            } else {
                plain.copy_from_slice(head.get(..16).unwrap_or(&[0; 16]));
            }
            if !plain.starts_with(spz::MAGIC) {
                return (0, 0);
            }
            let degree = u32::from(u8_at(&plain, 12)).min(4);
            // The attributes in one piece, and split.
            of(u64::from(u32_at(&plain, 8)), degree, 2 * (20 + 3 * sh_rest(degree) as u64))
        }
        // SOG in an archive: some 12 bytes per splat, and decoded pictures of four bytes per texel.
        [b'P', b'K', ..] => of(file.bytes / 12, 3, 80),
        // Pictures of SOG, each with its share of 12 bytes per splat.
        [b'R', b'I', b'F', b'F', ..] => of(file.bytes / 12, 3, 80),
        // Text of USD: some four bytes per number, and the numbers as floats before they are rows.
        [b'#', b'u', b's', b'd', b'a', ..] => (file.bytes.saturating_mul(4), file.bytes.saturating_mul(2)),
        [b'g', b'l', b'T', b'F', ..] => of(file.bytes / 236, 3, 0),
        _ if ksplat::is_ksplat(&head) => {
            of(u64::from(u32_at(&head, 16)).min(file.bytes / ksplat::LEAST_ROW), 3, 0)
        }
        _ if file.name.to_ascii_lowercase().ends_with(".splat") => of(file.bytes / 32, 0, 0),
        _ => (0, 0),
    }
}
