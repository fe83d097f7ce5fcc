//! [`FileStamp`]: metadata of a file that show whether its content may have changed.

use std::fs::{self, Metadata};
use std::io;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// The state of a file, taken from the result of one `stat`. Two equal stamps *probably* mean equal content. If the
/// earlier stamp [`is_settled`](Self::is_settled), they certainly do.
#[derive(Clone, Copy, Debug)]
pub struct FileStamp {
    /// Length in bytes.
    pub size: u64,
    /// Time of the last change of content, in nanoseconds since 1970; negative for earlier times.
    pub mtime_ns: i64,
    /// Number of the file in its file system; 0 on systems without such numbers.
    pub inode: u64,
    /// Number of the file system; 0 on systems without such numbers.
    pub dev: u64,
    /// Time of the last change of content or attributes, in nanoseconds since 1970.
    pub ctime_ns: i64,
    /// Time at which this stamp was taken, in nanoseconds since 1970. The clock is read before `stat` is called.
    /// This field is ignored when stamps are compared.
    pub taken_ns: i64,
}

/// Assumed resolution of file times, in nanoseconds. If a file was changed less than this time before its stamp was
/// taken, another change may leave the file time as it is. FAT has a resolution of two seconds, and no common file
/// system has a coarser one.
const GRANULARITY_NS: i64 = 2_000_000_000;

impl PartialEq for FileStamp {
    fn eq(&self, other: &FileStamp) -> bool {
        (self.size, self.mtime_ns, self.inode, self.dev, self.ctime_ns)
            == (other.size, other.mtime_ns, other.inode, other.dev, other.ctime_ns)
    }
}

impl Eq for FileStamp {}

impl FileStamp {
    /// The stamp of the file at `path`, following links.
    ///
    /// # Errors
    /// If the file is missing or cannot be reached.
    pub fn of(path: &Path) -> io::Result<FileStamp> {
        let taken_ns = now_ns();
        Ok(FileStamp::new(&fs::metadata(path)?, taken_ns))
    }

    /// The stamp of `metadata`, which was read at `taken_ns` or later.
    #[cfg(unix)]
    pub(crate) fn new(metadata: &Metadata, taken_ns: i64) -> FileStamp {
        use std::os::unix::fs::MetadataExt;
        let ns = |seconds: i64, rest: i64| seconds.saturating_mul(1_000_000_000).saturating_add(rest);
        FileStamp {
            size: metadata.len(),
            mtime_ns: ns(metadata.mtime(), metadata.mtime_nsec()),
            inode: metadata.ino(),
            dev: metadata.dev(),
            ctime_ns: ns(metadata.ctime(), metadata.ctime_nsec()),
            taken_ns,
        }
    }

    /// The stamp of `metadata`, which was read at `taken_ns` or later. On systems other than Unix, the standard library
    /// reports neither inodes nor the time at which an inode changed; the time of creation replaces the latter.
    #[cfg(not(unix))]
    pub(crate) fn new(metadata: &Metadata, taken_ns: i64) -> FileStamp {
        let mtime_ns = metadata.modified().map_or(taken_ns, since_1970_ns);
        let ctime_ns = metadata.created().map_or(0, since_1970_ns);
        FileStamp { size: metadata.len(), mtime_ns, inode: 0, dev: 0, ctime_ns, taken_ns }
    }

    /// Encodes the fields that are compared, for storage.
    pub fn to_bytes(&self) -> [u8; 40] {
        let numbers = [self.size, self.mtime_ns as u64, self.inode, self.dev, self.ctime_ns as u64];
        let mut bytes = [0; 40];
        bytes.copy_from_slice(numbers.map(u64::to_le_bytes).as_flattened());
        bytes
    }

    /// True if the file's last change was so long before the stamp was taken that any later change must give a
    /// different stamp (git's rule for "racily clean" files). Always false for a file whose time is in the future.
    pub fn is_settled(&self) -> bool {
        self.mtime_ns.max(self.ctime_ns).saturating_add(GRANULARITY_NS) < self.taken_ns
    }
}

/// True if two results of `stat` belong to the same file, not only to the same path.
#[cfg(unix)]
pub(crate) fn same_file(a: &Metadata, b: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    (a.dev(), a.ino()) == (b.dev(), b.ino())
}

/// True if two results of `stat` belong to the same file, judging by the creation times.
#[cfg(not(unix))]
pub(crate) fn same_file(a: &Metadata, b: &Metadata) -> bool {
    a.created().ok() == b.created().ok()
}

fn now_ns() -> i64 {
    since_1970_ns(SystemTime::now())
}

fn since_1970_ns(time: SystemTime) -> i64 {
    let ns = |elapsed: std::time::Duration| i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX);
    match time.duration_since(UNIX_EPOCH) {
        Ok(after) => ns(after),
        Err(before) => -ns(before.duration()),
    }
}
