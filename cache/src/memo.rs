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
    let mut payload = Vec::with_capacity(80);
    payload.extend_from_slice(&stamp.size.to_le_bytes());
    payload.extend_from_slice(&stamp.mtime_ns.to_le_bytes());
    payload.extend_from_slice(&stamp.inode.to_le_bytes());
    payload.extend_from_slice(&stamp.dev.to_le_bytes());
    payload.extend_from_slice(&stamp.ctime_ns.to_le_bytes());
    payload.extend_from_slice(&stamp.taken_ns.to_le_bytes());
    payload.extend_from_slice(digest.as_bytes());
    payload
}

/// The digest in `payload`, if it was taken of a settled file that still has the stamp `now`.
pub(crate) fn recall(payload: &[u8], now: &FileStamp) -> Option<Digest> {
    let (numbers, digest) = payload.split_at_checked(48)?;
    let number = |index: usize| numbers.get(index * 8..).and_then(|rest| rest.first_chunk::<8>()).copied();
    let stamp = FileStamp {
        size: u64::from_le_bytes(number(0)?),
        mtime_ns: i64::from_le_bytes(number(1)?),
        inode: u64::from_le_bytes(number(2)?),
        dev: u64::from_le_bytes(number(3)?),
        ctime_ns: i64::from_le_bytes(number(4)?),
        taken_ns: i64::from_le_bytes(number(5)?),
    };
    (stamp == *now && stamp.is_settled()).then_some(Digest::from_bytes(digest.try_into().ok()?))
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
