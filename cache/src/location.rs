//! Locations of log entries, and sizes of the parts of a log.

use crate::digest::Digest;

/// The identity of an entry: kind and key.
pub(crate) type EntryId = (u8, Digest);

/// Location of an entry: offset in bytes, counted from the end of the file's head, and length of the payload.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Location {
    pub offset: u64,
    pub length: u32,
}

/// Sizes of the contents of a log file, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LogSizes {
    /// Total size of the valid entries.
    pub live: u64,
    /// Total size of three types of entries: entries that later entries replaced or removed, entries that remove
    /// other entries, and incomplete entries.
    pub dead: u64,
    /// Number of bytes that belong to no entry.
    pub damaged: u64,
}
