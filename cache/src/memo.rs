//! Memos: the digest of a file as of a [`FileStamp`], so that an unchanged file is not read again.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use crate::digest::{Digest, DigestWriter};
use crate::stamp::FileStamp;

/// What a memo is stored under: the absolute path, links not followed.
pub(crate) fn key(path: &Path) -> io::Result<Digest> {
    Ok(Digest::of(std::path::absolute(path)?.as_os_str().as_encoded_bytes()))
}

/// Stamp and digest as the payload of an entry.
pub(crate) fn encode(stamp: &FileStamp, digest: &Digest) -> Vec<u8> {
    [&stamp.to_bytes()[..], &stamp.taken_ns.to_le_bytes(), digest.as_bytes()].concat()
}

/// The digest in `payload`, if it was taken of a settled file that still has the stamp `now`.
pub(crate) fn recall(payload: &[u8], now: &FileStamp) -> Option<Digest> {
    let (stamp, rest) = payload.split_first_chunk::<40>()?;
    let (taken, digest) = rest.split_first_chunk::<8>()?;
    let then = FileStamp { taken_ns: i64::from_le_bytes(*taken), ..*now };
    (*stamp == now.to_bytes() && then.is_settled()).then_some(Digest::from_bytes(digest.try_into().ok()?))
}

/// Reads the whole file: its digest and its length in bytes. A pipe or a device, which may have no end, is refused.
pub(crate) fn read_digest(path: &Path) -> io::Result<(Digest, u64)> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"));
    }
    let mut file = File::open(path)?;
    let mut writer = DigestWriter::new();
    let mut buffer = vec![0; 256 << 10];
    loop {
        match file.read(&mut buffer) {
            Ok(0) => return Ok((writer.finish(), writer.length())),
            Ok(count) => io::Write::write_all(&mut writer, &buffer[..count])?,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}
