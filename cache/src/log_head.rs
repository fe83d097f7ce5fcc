//! The head of a log file, which holds its salt. The layout is in the documentation of the crate.

use std::hash::{BuildHasher, RandomState};

use crate::entry::checksum;

/// The length of the head in bytes. The head consists of two equal copies of 32 bytes, so that one flipped byte
/// cannot destroy the salt.
pub(crate) const LENGTH: u64 = 64;

const MAGIC: &[u8; 8] = b"LHlog\0\0\x01";

/// The head of a new log with this salt.
pub(crate) fn with(salt: u32) -> Vec<u8> {
    let mut copy = Vec::from(MAGIC);
    copy.extend_from_slice(&salt.to_le_bytes());
    copy.extend_from_slice(&checksum(0, &[&copy]).to_le_bytes());
    copy.resize(32, 0);
    [copy.as_slice(), &copy].concat()
}

/// The salt in the head of a file, from the first copy that is undamaged.
pub(crate) fn salt(head: &[u8]) -> Option<u32> {
    let read = |copy: &[u8]| -> Option<u32> {
        let (body, sum) = copy.get(..16)?.split_at(12);
        let whole = body.starts_with(MAGIC) && checksum(0, &[body]).to_le_bytes() == *sum;
        whole.then(|| body.last_chunk().map(|salt| u32::from_le_bytes(*salt)))?
    };
    if head.len() as u64 == LENGTH { read(head).or_else(|| read(&head[32..])) } else { None }
}

/// A random salt, so that entries of another log inside a payload are not mistaken for entries of this log.
pub(crate) fn fresh_salt() -> u32 {
    RandomState::new().hash_one(std::process::id()) as u32
}
