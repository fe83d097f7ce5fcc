//! EXIF metadata of PNG and JPEG (CIPA DC-008, a TIFF structure).

/// Tag of the pointer to the directory of properties of the photograph.
const PHOTOGRAPH: u16 = 0x8769;
/// Tag of the pointer to the directory on interoperability.
const INTEROPERABILITY: u16 = 0xa005;
/// Tag of the colour space, in the directory of the photograph.
const COLOUR_SPACE: u16 = 0xa001;
/// Tag of the rule, in the directory on interoperability.
const RULE: u16 = 1;
/// Rule of the optional colour space of DCF (CIPA DC-009), which is Adobe RGB.
const OPTIONAL: &[u8] = b"R03";

/// Colour space that EXIF data state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ExifColour {
    /// Adobe RGB (1998): the value 2 that many cameras write, or "uncalibrated" with the rule `R03`.
    AdobeRgb,
    /// A colour space that only an ICC profile would define.
    Uncalibrated,
}

/// The colour space that EXIF data state. `None` for sRGB, if none is stated, or if the data are damaged.
pub(super) fn colour(exif: &[u8]) -> Option<ExifColour> {
    let tiff = Tiff::new(exif.strip_prefix(b"Exif\0\0").unwrap_or(exif))?;
    let main = tiff.number(4, 4)?;
    let photograph = tiff.entry(main, PHOTOGRAPH).and_then(|at| tiff.number(at + 8, 4))?;
    let space = tiff.entry(photograph, COLOUR_SPACE).and_then(|at| tiff.number(at + 8, 2))?;
    let pointer =
        [photograph, main].into_iter().find_map(|directory| tiff.entry(directory, INTEROPERABILITY));
    let directory = pointer.and_then(|at| tiff.number(at + 8, 4));
    // Up to four bytes are in the entry itself.
    let rule = directory
        .and_then(|directory| tiff.entry(directory, RULE))
        .and_then(|at| tiff.bytes.get(at + 8..at + 11));
    match (space, rule) {
        (2, _) | (0xffff, Some(OPTIONAL)) => Some(ExifColour::AdobeRgb),
        (0xffff, _) => Some(ExifColour::Uncalibrated),
        _ => None,
    }
}

/// A TIFF structure.
struct Tiff<'a> {
    bytes: &'a [u8],
    is_little_endian: bool,
}

impl<'a> Tiff<'a> {
    fn new(bytes: &'a [u8]) -> Option<Self> {
        let is_little_endian = match bytes.get(..4)? {
            [b'I', b'I', 42, 0] => true,
            [b'M', b'M', 0, 42] => false,
            _ => return None,
        };
        Some(Self { bytes, is_little_endian })
    }

    /// The unsigned number of `length` bytes at an offset.
    fn number(&self, at: usize, length: usize) -> Option<usize> {
        let bytes = self.bytes.get(at..at.checked_add(length)?)?;
        let add = |number: usize, byte: &u8| number << 8 | usize::from(*byte);
        Some(if self.is_little_endian { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) })
    }

    /// Offset of the entry with a tag in the directory at an offset. An entry has 12 bytes: tag, type, number of
    /// values, and the value or its offset.
    fn entry(&self, directory: usize, tag: u16) -> Option<usize> {
        let count = self.number(directory, 2)?;
        let entries = (0..count).map(|index| directory + 2 + 12 * index);
        entries
            .take_while(|at| at + 12 <= self.bytes.len())
            .find(|&at| self.number(at, 2) == Some(usize::from(tag)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// EXIF data with a colour space, and a rule if one is given, in either byte order.
    fn exif(space: u16, rule: Option<&[u8; 4]>, is_little_endian: bool) -> Vec<u8> {
        let mut bytes = if is_little_endian { b"II*\0".to_vec() } else { b"MM\0*".to_vec() };
        let short = |v: u16| if is_little_endian { v.to_le_bytes() } else { v.to_be_bytes() };
        let long = |v: u32| if is_little_endian { v.to_le_bytes() } else { v.to_be_bytes() };
        let entry = |tag: u16, kind: u16, count: u32, value: [u8; 4]| {
            [short(tag).to_vec(), short(kind).to_vec(), long(count).to_vec(), value.to_vec()].concat()
        };
        bytes.extend(long(8));
        bytes.extend(short(1));
        bytes.extend(entry(PHOTOGRAPH, 4, 1, long(26)));
        bytes.extend(long(0));
        let mut value = short(space).to_vec();
        value.extend([0, 0]);
        bytes.extend(short(if rule.is_some() { 2 } else { 1 }));
        bytes.extend(entry(COLOUR_SPACE, 3, 1, [value[0], value[1], 0, 0]));
        if let Some(rule) = rule {
            bytes.extend(entry(INTEROPERABILITY, 4, 1, long(56)));
            bytes.extend(long(0));
            bytes.extend(short(1));
            bytes.extend(entry(RULE, 2, 4, *rule));
        }
        bytes.extend(long(0));
        [b"Exif\0\0".to_vec(), bytes].concat()
    }

    #[test]
    fn the_colour_space_is_that_of_the_metadata() {
        for order in [true, false] {
            let found = |space, rule: Option<&[u8; 4]>| colour(&exif(space, rule, order));
            assert_eq!(found(1, Some(b"R98\0")), None);
            assert_eq!(found(2, None), Some(ExifColour::AdobeRgb));
            assert_eq!(found(0xffff, Some(b"R03\0")), Some(ExifColour::AdobeRgb));
            assert_eq!(found(0xffff, Some(b"R98\0")), Some(ExifColour::Uncalibrated));
            assert_eq!(found(0xffff, None), Some(ExifColour::Uncalibrated));
            let whole = exif(2, Some(b"R03\0"), order);
            assert!(
                (0..whole.len()).all(|length| colour(&whole[..length]) != Some(ExifColour::Uncalibrated))
            );
        }
        assert_eq!(colour(b"II*\0\xff\xff\xff\xff"), None);
    }
}
