//! The container of glTF: GLB, or JSON alone.

use std::io::{Error as IoError, ErrorKind, Read};
use std::path::Path;

use crate::error::Error;

/// Maximum length of the JSON of a file in bytes. It is read before a limit on memory is known, to find the other files.
const JSON_LIMIT: u64 = 256 << 20;

/// Splits a GLB into its JSON and binary chunks.
pub(super) fn split<'a>(name: &str, bytes: &'a [u8]) -> Result<(&'a [u8], Option<Vec<u8>>), Error> {
    let short = || Error::format(name, "the GLB is truncated");
    let word = |at: usize| -> Result<usize, Error> {
        let raw = bytes.get(at..at + 4).ok_or_else(short)?;
        Ok(raw.iter().rev().fold(0, |sum, b| sum << 8 | usize::from(*b)))
    };
    if word(4)? != 2 {
        return Err(Error::unsupported(name, format!("GLB version {}; save the file as glTF 2.0", word(4)?)));
    }
    let bytes = bytes.get(..word(8)?).ok_or_else(short)?;
    let length = word(12)?;
    if word(16)? != 0x4e4f_534a {
        return Err(Error::format(name, "the first chunk of the GLB is not JSON"));
    }
    let text = bytes.get(20..20 + length).ok_or_else(short)?;
    let next = 20 + length.next_multiple_of(4);
    if bytes.len() < next + 8 {
        return Ok((text, None));
    }
    let blob = bytes.get(next + 8..next + 8 + word(next)?).ok_or_else(short)?;
    Ok((text, (word(next + 4)? == 0x004e_4942).then(|| blob.to_vec())))
}

/// Reads the JSON of a file that begins like glTF. The flag is true if the file is binary (GLB). The data after the
/// JSON are not read. Returns `None` for any other file.
pub fn json_of(path: &Path) -> std::io::Result<Option<(Vec<u8>, bool)>> {
    json_in(&mut engine::open_regular(path)?)
}

/// Like [`json_of`], from an open file at its start; reads up to the end of the JSON.
pub fn json_in(file: &mut impl Read) -> std::io::Result<Option<(Vec<u8>, bool)>> {
    let mut head = Vec::new();
    file.by_ref().take(20).read_to_end(&mut head)?;
    if head.starts_with(b"glTF") {
        // A header of 12 bytes, then length and type of the first chunk, which is the JSON.
        let Some(length) = head.get(12..).and_then(|rest| rest.first_chunk()) else { return Ok(None) };
        let length = u64::from(u32::from_le_bytes(*length));
        let mut json = Vec::new();
        file.take(length.min(JSON_LIMIT + 1)).read_to_end(&mut json)?;
        bounded(&json)?;
        return Ok(Some((json, true)));
    }
    let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&head);
    if !text.trim_ascii_start().starts_with(b"{") {
        return Ok(None);
    }
    file.take(JSON_LIMIT + 1).read_to_end(&mut head)?;
    bounded(&head)?;
    Ok(Some((head, false)))
}

/// An error if the JSON is longer than the limit.
fn bounded(json: &[u8]) -> std::io::Result<()> {
    if json.len() as u64 <= JSON_LIMIT {
        return Ok(());
    }
    let what = format!(
        "the JSON of this glTF file is longer than {} MiB; save its buffers and pictures as files of their own, or as GLB",
        JSON_LIMIT >> 20
    );
    Err(IoError::new(ErrorKind::FileTooLarge, what))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// JSON beyond the limit is an error, and no more than the limit is read.
    #[test]
    fn long_json_is_refused() {
        let head = |kind: &[u8]| {
            [b"glTF\x02\0\0\0\0\0\0\0".as_slice(), &0x7fff_ffff_u32.to_le_bytes(), kind].concat()
        };
        for start in [head(b"JSON"), b"{                   ".to_vec()] {
            let mut endless = start.chain(std::io::repeat(b' '));
            let error = json_in(&mut endless).expect_err("is too long");
            assert_eq!(error.kind(), ErrorKind::FileTooLarge, "{error}");
        }
    }
}
