//! [`Error`]: what can go wrong with a cache folder, always with the operation and the path.

use std::io;
use std::path::{Path, PathBuf};

/// Why the cache could not do something. What was stored before stays valid after any of these.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system is full, or the user's share of it.
    #[error("disk full: cannot {operation} {}", path.display())]
    Full {
        /// What was tried, as a verb: "write", "append to".
        operation: &'static str,
        /// The file or folder it was tried on.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The system refused.
    #[error("cannot {operation} {}", path.display())]
    Io {
        /// What was tried, as a verb: "write", "append to".
        operation: &'static str,
        /// The file or folder it was tried on.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A record is larger than the log takes.
    #[error("a record of {length} bytes is larger than the limit of {limit} bytes")]
    RecordTooLarge {
        /// Its length in bytes.
        length: usize,
        /// The most that is taken, in bytes.
        limit: usize,
    },
    /// Runs were at work for as long as a collection waited.
    #[error("the cache is in use: a run is at work, and {} s were not enough to wait for it", waited.as_secs())]
    InUse {
        /// How long it waited.
        waited: std::time::Duration,
    },
    /// A file was to be published over something that is not a file, such as a folder or a device.
    #[error("{} is not a regular file, and is left alone", path.display())]
    NotAFile {
        /// The path that was to be written.
        path: PathBuf,
    },
}

/// The result of an operation on the cache.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Wraps what the system said; full disks and quotas get their own variant.
    pub(crate) fn io(operation: &'static str, path: &Path, source: io::Error) -> Error {
        let path = path.to_path_buf();
        match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
                Error::Full { operation, path, source }
            }
            _ => Error::Io { operation, path, source },
        }
    }

    /// Whether the system says that this place cannot be written at all.
    pub(crate) fn is_read_only(&self) -> bool {
        let Error::Io { source, .. } = self else { return false };
        matches!(source.kind(), io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem)
    }
}

/// Adds the operation and the path to a system error.
pub(crate) trait At<T> {
    /// `operation` is a verb that fits before a path.
    fn at(self, operation: &'static str, path: &Path) -> Result<T>;
}

impl<T> At<T> for io::Result<T> {
    fn at(self, operation: &'static str, path: &Path) -> Result<T> {
        self.map_err(|source| Error::io(operation, path, source))
    }
}
