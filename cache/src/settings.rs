//! [`Options`] and [`Fsync`]: how a cache folder is opened. [`Incident`]: damage that was found in it.

use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::digest::Digest;

/// The folder of this storage format in the cache folder. A new format gets a new folder.
pub(crate) const FORMAT: &str = "v1";

/// The kinds of entries in the log of records. Compaction keeps entries of other kinds unchanged.
pub(crate) mod kind {
    pub const RECORD: u8 = 1;
    pub const MEMO: u8 = 3;
    pub const HISTORY: u8 = 4;
}

/// The policy for syncing written data to disk. Unsynced data can be lost in a power failure, but not if only the
/// process dies. Every read is verified, so results damaged by a power failure are detected and recomputed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fsync {
    /// Sync once, in [`Store::flush`](crate::Store::flush).
    #[default]
    Batch,
    /// Sync after every blob and record.
    Always,
    /// Never sync.
    Off,
}

/// Options for opening a [`Store`](crate::Store).
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// The policy for syncing.
    pub fsync: Fsync,
    /// True to write nothing, even if the folder is writable. A folder that is not writable is detected even if
    /// this is false.
    pub read_only: bool,
}

/// Damage that was found, and repaired or bypassed. Callers should print it as a one-line warning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Incident {
    /// The digest of the damaged blob; `None` if something other than a blob is damaged.
    pub digest: Option<Digest>,
    /// Description of the damage and of the action taken.
    pub what: String,
}

impl fmt::Display for Incident {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.digest {
            Some(digest) => write!(f, "damaged blob {}: {}", digest.short(), self.what),
            None => f.write_str(&self.what),
        }
    }
}

/// Locks a mutex, ignoring poisoning: every change under these mutexes is complete before anything can panic.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
