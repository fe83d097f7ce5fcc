//! Where the entries of a log are stored, and what else the log consists of.

use crate::digest::Digest;

/// The identity of an entry: kind and key.
pub(crate) type EntryId = (u8, Digest);

/// Where an entry is stored: its offset in bytes from the end of the file's head, and the length of its payload.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Location {
    pub offset: u64,
    pub length: u32,
}

/// Sizes of the contents of a log, in bytes of its file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LogSizes {
    /// Entries that can be read.
    pub live: u64,
    /// Entries that later ones replaced or removed, the removals themselves, and entries cut short.
    pub dead: u64,
    /// Bytes that belong to no entry.
    pub damaged: u64,
}
