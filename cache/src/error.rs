//! [`Error`]: the error of an operation on a cache folder. Errors of the operating system include the operation and
//! the path.

use std::io;
use std::path::{Path, PathBuf};

/// Errors of cache operations. After an error, everything stored before it is still valid.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no space left: the file system is full, the user's quota is used up, or the file would be larger
    /// than a process may write (`ulimit -f`).
    #[error("{}: cannot {operation} {}", no_room(source), path.display())]
    Full {
        /// The operation that failed, as a verb: "write", "append to".
        operation: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error that the operating system reported.
        source: io::Error,
    },
    /// The operating system reported an error.
    #[error("cannot {operation} {}", path.display())]
    Io {
        /// The operation that failed, as a verb: "write", "append to".
        operation: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error that the operating system reported.
        source: io::Error,
    },
    /// A record is too long to be stored as an entry of the log.
    #[error("a record of {length} bytes is larger than the limit of {limit} bytes")]
    RecordTooLarge {
        /// Length of the record in bytes.
        length: usize,
        /// The maximum length in bytes.
        limit: usize,
    },
    /// A collection could not start, because a run was still active when the timeout expired.
    #[error("the cache is in use: a run is active and did not end within {} s", waited.as_secs())]
    InUse {
        /// The time for which the collection waited.
        waited: std::time::Duration,
    },
    /// The path to be published is not a regular file but, for example, a folder or a device.
    #[error("{} is not a regular file and was not replaced", path.display())]
    NotAFile {
        /// The path that was to be written.
        path: PathBuf,
    },
}

/// The result of an operation on the cache.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Wraps an error of the operating system. Errors that mean a lack of space become [`Error::Full`].
    pub(crate) fn io(operation: &'static str, path: &Path, source: io::Error) -> Error {
        let path = path.to_path_buf();
        match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
                Error::Full { operation, path, source }
            }
            _ => Error::Io { operation, path, source },
        }
    }

    /// True if the error means that nothing can be written at the path.
    pub(crate) fn is_read_only(&self) -> bool {
        let Error::Io { source, .. } = self else { return false };
        matches!(source.kind(), io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem)
    }
}

fn no_room(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::QuotaExceeded => "quota exceeded",
        io::ErrorKind::FileTooLarge => "file size limit reached (`ulimit -f`)",
        _ => "disk full",
    }
}

/// Extension trait for I/O results. It adds the operation and the path to the error.
pub(crate) trait At<T> {
    /// Adds `path` and `operation`, a verb that can be followed by a path.
    fn at(self, operation: &'static str, path: &Path) -> Result<T>;
}

impl<T> At<T> for io::Result<T> {
    fn at(self, operation: &'static str, path: &Path) -> Result<T> {
        self.map_err(|source| Error::io(operation, path, source))
    }
}
