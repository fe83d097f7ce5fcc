//! Memos: stored digests of files, so that an unchanged file is not read again. Each memo contains the
//! [`FileStamp`] for which its digest is valid.

use std::fs::OpenOptions;
use std::io::{self, Read};
use std::path::Path;

use crate::digest::{Digest, DigestWriter};
use crate::regular;
use crate::stamp::FileStamp;

/// The key of a memo: the digest of the absolute path. Links in the path are not resolved.
pub(crate) fn key(path: &Path) -> io::Result<Digest> {
    Ok(Digest::of(std::path::absolute(path)?.as_os_str().as_encoded_bytes()))
}

/// Encodes a stamp and a digest as the payload of an entry.
pub(crate) fn encode(stamp: &FileStamp, digest: &Digest) -> Vec<u8> {
    [&stamp.to_bytes()[..], &stamp.taken_ns.to_le_bytes(), digest.as_bytes()].concat()
}

/// Returns the digest in `payload` if the stamp in `payload` was settled (see [`FileStamp::is_settled`]) and equals
/// `now`.
pub(crate) fn recall(payload: &[u8], now: &FileStamp) -> Option<Digest> {
    let (stamp, rest) = payload.split_first_chunk::<40>()?;
    let (taken, digest) = rest.split_first_chunk::<8>()?;
    let then = FileStamp { taken_ns: i64::from_le_bytes(*taken), ..*now };
    (*stamp == now.to_bytes() && then.is_settled()).then_some(Digest::from_bytes(digest.try_into().ok()?))
}

/// Reads the whole file and returns its digest and its length in bytes.
///
/// # Errors
/// The errors of [`regular::open`] and of reading.
pub(crate) fn read_digest(path: &Path, cancelled: &dyn Fn() -> bool) -> io::Result<Option<(Digest, u64)>> {
    let mut file = regular::open(path, OpenOptions::new().read(true))?;
    let mut writer = DigestWriter::new();
    let mut buffer = vec![0; 256 << 10];
    loop {
        if cancelled() {
            return Ok(None);
        }
        match file.read(&mut buffer) {
            Ok(0) => return Ok(Some((writer.finish(), writer.length()))),
            Ok(count) => io::Write::write_all(&mut writer, &buffer[..count])?,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}
