//! The container of glTF: GLB, or JSON alone.

use std::io::Read;
use std::path::Path;

use crate::error::Error;

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
    json_in(&mut std::fs::File::open(path)?)
}

/// Like [`json_of`], from an open file at its start; reads up to the end of the JSON.
pub fn json_in(file: &mut impl Read) -> std::io::Result<Option<(Vec<u8>, bool)>> {
    let mut head = Vec::new();
    file.by_ref().take(20).read_to_end(&mut head)?;
    if head.starts_with(b"glTF") {
        // A header of 12 bytes, then length and type of the first chunk, which is the JSON.
        let Some(length) = head.get(12..).and_then(|rest| rest.first_chunk()) else { return Ok(None) };
        let mut json = Vec::new();
        file.take(u32::from_le_bytes(*length).into()).read_to_end(&mut json)?;
        return Ok(Some((json, true)));
    }
    let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&head);
    if !text.trim_ascii_start().starts_with(b"{") {
        return Ok(None);
    }
    file.read_to_end(&mut head)?;
    Ok(Some((head, false)))
}
