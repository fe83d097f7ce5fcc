//! Tags of the first directory of a TIFF that say how its samples are stored, and what is not read, in words.

/// Tag of the compression.
const COMPRESSION: u16 = 259;
/// Tag of the meaning of the samples.
const PHOTOMETRIC: u16 = 262;

/// Reads numbers of a TIFF or BigTIFF in the byte order of the file.
struct Numbers<'a> {
    bytes: &'a [u8],
    little: bool,
}

impl Numbers<'_> {
    /// The number of `size` bytes at an offset; `None` beyond the end of the file.
    fn at(&self, offset: u64, size: usize) -> Option<u64> {
        let start = usize::try_from(offset).ok()?;
        let bytes = self.bytes.get(start..start.checked_add(size)?)?;
        let add = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        Some(if self.little { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) })
    }
}

/// The value of a tag with one small number in the first directory; `None` if it has no such tag.
fn tag(bytes: &[u8], wanted: u16) -> Option<u64> {
    let file = Numbers { bytes, little: bytes.first() == Some(&b'I') };
    let big = file.at(2, 2)? == 43;
    let directory = if big { file.at(8, 8)? } else { file.at(4, 4)? };
    let (head, entry) = if big { (8, 20) } else { (2, 12) };
    let count = file.at(directory, head)?.min(4096);
    let entries = directory.checked_add(head as u64)?;
    for number in 0..count {
        let at = entries.checked_add(number * entry)?;
        if file.at(at, 2)? == u64::from(wanted) {
            let size = match file.at(at + 2, 2)? {
                1 => 1,
                3 => 2,
                4 => 4,
                _ => return None,
            };
            return file.at(at + entry - if big { 8 } else { 4 }, size);
        }
    }
    None
}

/// Description of a TIFF whose samples are not read, with what to do; `None` if its tags name nothing of this kind.
pub(super) fn unread(bytes: &[u8]) -> Option<String> {
    let save = "save it as RGB or grey";
    let meaning = match tag(bytes, PHOTOMETRIC) {
        Some(3) => Some(("colours of a palette".to_owned(), save)),
        Some(4) => Some(("a transparency mask".to_owned(), save)),
        Some(5) => Some(("CMYK colours".to_owned(), save)),
        Some(32_803 | 34_892) => Some((
            "samples of a camera sensor".to_owned(),
            "develop it and export it as TIFF, PNG (16 bits) or OpenEXR",
        )),
        Some(8..=10) => Some(("CIE Lab colours".to_owned(), save)),
        Some(code @ (32_844 | 32_845)) => Some((
            if code == 32_844 { "SGI LogL".to_owned() } else { "SGI LogLuv colours".to_owned() },
            "save it as RGB floats (OpenCV: `IMWRITE_TIFF_COMPRESSION` 1, 5 or 8), or as OpenEXR",
        )),
        _ => None,
    };
    // JPEG explains why the colours are YCbCr.
    let compression = match tag(bytes, COMPRESSION) {
        None | Some(1 | 5 | 8 | 32_773 | 32_946) => None,
        Some(2..=4) => Some("a fax compression (CCITT)".to_owned()),
        Some(6 | 7) => Some("JPEG compression".to_owned()),
        Some(34_676 | 34_677) => Some("SGI LogLuv compression".to_owned()),
        Some(34_712) => Some("JPEG 2000 compression".to_owned()),
        Some(34_887) => Some("LERC compression".to_owned()),
        Some(34_925) => Some("LZMA compression".to_owned()),
        Some(50_000) => Some("Zstandard compression".to_owned()),
        Some(50_001) => Some("WebP compression".to_owned()),
        Some(50_002 | 52_546) => Some("JPEG XL compression".to_owned()),
        Some(other) => Some(format!("the compression with the number {other}")),
    };
    let compression =
        compression.map(|name| (name, "save it with deflate, LZW or PackBits, or without compression"));
    let (what, remedy) = meaning.or(compression)?;
    Some(format!("a TIFF with {what}; {remedy}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with one directory; each tag has a type and a value.
    fn file(little: bool, big: bool, tags: &[(u16, u16, u32)]) -> Vec<u8> {
        let number = |value: u64, size: usize| -> Vec<u8> {
            let bytes = value.to_le_bytes()[..size].to_vec();
            if little { bytes } else { bytes.into_iter().rev().collect() }
        };
        let wide = if big { 8 } else { 4 };
        let mut out = if little { b"II".to_vec() } else { b"MM".to_vec() };
        out.extend(if big { [number(43, 2), number(8, 2), number(0, 2)].concat() } else { number(42, 2) });
        out.extend(number(if big { 16 } else { 8 }, wide));
        out.extend(number(tags.len() as u64, if big { 8 } else { 2 }));
        for (tag, scalar, value) in tags {
            out.extend([number((*tag).into(), 2), number((*scalar).into(), 2), number(1, wide)].concat());
            let size = if *scalar == 3 { 2 } else { 4 };
            out.extend([number((*value).into(), size), vec![0; wide - size]].concat());
        }
        out
    }

    /// Samples that are not read are named in every byte order. This test fails if `tag` ignores the byte order, or
    /// reads the value from the place of the other kind of TIFF.
    #[test]
    fn what_is_not_read_is_named() {
        for (compression, photometric, says) in [
            (1, 3, "colours of a palette; save it as RGB"),
            (34_676, 32_845, "SGI LogLuv colours; save it as RGB floats"),
            (34_925, 2, "LZMA compression; save it with deflate"),
            (7, 6, "JPEG compression"),
            (50_000, 2, "Zstandard"),
            (12_345, 2, "number 12345"),
            (4, 1, "fax"),
            (5, 5, "CMYK"),
        ] {
            for (little, big, scalar) in
                [(true, false, 3), (false, false, 4), (true, true, 4), (false, true, 3)]
            {
                let tags =
                    [(256, 4, 7), (COMPRESSION, scalar, compression), (PHOTOMETRIC, scalar, photometric)];
                let bytes = file(little, big, &tags);
                let found = unread(&bytes).unwrap_or_default();
                assert!(found.contains(says), "{little} {big}: {found}");
                (0..bytes.len()).for_each(|end| drop(unread(&bytes[..end])));
            }
        }
        for read in [(1, 2), (5, 1), (8, 0), (32_773, 2), (32_946, 2)] {
            let tags = [(COMPRESSION, 3, read.0), (PHOTOMETRIC, 3, read.1)];
            assert_eq!(unread(&file(true, false, &tags)), None, "{read:?}");
        }
    }
}
