//! Little-endian numbers from a file.
//!
//! Every reader of a format checks the sizes of its data first, and its error states these sizes. Later reads are
//! therefore in bounds. If such a check were wrong, these functions would return 0 and not panic.

use crate::error::Error;

fn array<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let end = at.saturating_add(N);
    bytes.get(at..end).and_then(|b| b.try_into().ok()).unwrap_or([0; N])
}

/// Reads the byte at `at`.
pub fn u8_at(bytes: &[u8], at: usize) -> u8 {
    bytes.get(at).copied().unwrap_or(0)
}

/// Reads a 16-bit number at `at`.
pub fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(array(bytes, at))
}

/// Reads a 32-bit number at `at`.
pub fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(array(bytes, at))
}

/// Reads a 64-bit number at `at`.
pub fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(array(bytes, at))
}

/// Reads a 32-bit float at `at`.
pub fn f32_at(bytes: &[u8], at: usize) -> f32 {
    f32::from_le_bytes(array(bytes, at))
}

/// Reads a 64-bit float at `at`.
pub fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(array(bytes, at))
}

/// Reads a 16-bit float at `at`, which is converted exactly.
pub fn f16_at(bytes: &[u8], at: usize) -> f64 {
    let bits = u16_at(bytes, at);
    let (exponent, mantissa) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    let power = |e: i32| f64::from_bits(((1023 + e) as u64) << 52);
    let value = match exponent {
        0 => mantissa * power(-24),
        31 if mantissa == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        e => (1024.0 + mantissa) * power(e - 25),
    };
    if bits >> 15 == 1 { -value } else { value }
}

/// The `length` bytes from `start`, or an error that describes the missing data.
pub fn range<'a>(
    file: &str,
    bytes: &'a [u8],
    start: usize,
    length: usize,
    what: &str,
) -> Result<&'a [u8], Error> {
    let end = start.checked_add(length);
    end.and_then(|end| bytes.get(start..end)).ok_or_else(|| {
        let held = bytes.len();
        Error::format(
            file,
            format!("cannot read {what}: {length} bytes at offset {start} are needed, but the file has {held} bytes"),
        )
    })
}

/// Checks a count of splats: it is an error if the available bytes cannot hold it. `densest` is the largest
/// possible number of splats per byte: the reciprocal of the length of a row, or more if the file is compressed.
pub fn believed(file: &str, count: u64, held: usize, densest: f64) -> Result<usize, Error> {
    if count as f64 <= held as f64 * densest
        && let Ok(count) = usize::try_from(count)
    {
        return Ok(count);
    }
    let what = format!("the header claims {count} splats, which {held} bytes cannot contain");
    Err(Error::format(file, what))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_exact() {
        for (bits, value) in [
            (0x0000_u16, 0.0),
            (0x0001, 5.960_464_477_539_063e-8),
            (0x03ff, 6.097_555_160_522_461e-5),
            (0x0400, 6.103_515_625e-5),
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
        ] {
            assert_eq!(f16_at(&bits.to_le_bytes(), 0), value);
        }
        assert_eq!(f16_at(&0xfc00_u16.to_le_bytes(), 0), f64::NEG_INFINITY);
        assert!(f16_at(&0x7e00_u16.to_le_bytes(), 0).is_nan());
    }

    #[test]
    fn past_the_end_is_zero() {
        assert_eq!((u32_at(&[1, 2, 3], 0), f64_at(&[], usize::MAX), u8_at(&[7], 0)), (0, 0.0, 7));
    }
}
