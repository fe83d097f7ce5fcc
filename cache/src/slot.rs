//! Where the entries of a log lie, as it and its index know it, and what else it consists of.

use crate::digest::Digest;

/// What names an entry: kind and key.
pub(crate) type Place = (u8, Digest);

/// Where an entry lies: offset from the end of the file's head, and the length of its payload.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    pub offset: u64,
    pub length: u32,
}

/// What a log consists of, in bytes of its file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Health {
    /// Entries that can be read.
    pub live: u64,
    /// Entries that later ones replaced or removed, and those removals.
    pub dead: u64,
    /// Bytes that belong to no entry.
    pub damaged: u64,
}
