//! Names of the compressions of OpenEXR files that are not read.

use crate::error::Error;

/// Start of the attribute that holds the compression of a part: its name, its type, and its size of one byte.
pub(super) const ATTRIBUTE: &[u8] = b"compression\0compression\0\x01\0\0\0";
/// Number of bytes from the start of a file in which headers are searched.
const HEADERS: usize = 1 << 20;

/// Name of a compression that is not read, by its number in files of OpenEXR 3.5; `None` for those that are read.
fn unread(number: u8) -> Option<String> {
    Some(match number {
        0..=9 => return None,
        10 => "HTJ2K256".to_owned(),
        11 => "HTJ2K32".to_owned(),
        12 => "LJ2K".to_owned(),
        13 => "ZSTD".to_owned(),
        other => format!("number {other}"),
    })
}

/// The error about a compression that is not read, if the header of a part names one.
pub(super) fn refusal(file: &str, bytes: &[u8]) -> Option<Error> {
    let headers = bytes.get(..HEADERS).unwrap_or(bytes);
    let found = headers.windows(ATTRIBUTE.len() + 1).filter_map(|window| window.strip_prefix(ATTRIBUTE));
    let name = found.filter_map(<[u8]>::first).find_map(|number| unread(*number))?;
    Some(Error::unsupported(file, format!("the compression {name}; save the picture with ZIP or PIZ")))
}
