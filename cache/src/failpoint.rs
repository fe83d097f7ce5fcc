//! Failpoints: named places at which a test can stop the process or simulate a disk error.
//!
//! They are active only if the feature `failpoints` is enabled; otherwise, `reach` is an empty inlined function. If
//! the environment variable `LIGHTHARMONY_FAILPOINT` is `name:count`, the process is aborted when the place `name`
//! is reached for the `count`-th time (like `kill -9`, without destructors). Counting starts at 1 and includes all
//! threads. With `name:count:error`, the place returns an I/O error instead, and with `name:count:full`, the error
//! of a full disk.

/// The names of all places, in the order in which a write reaches them.
pub const NAMES: &[&str] = &[
    BLOB.before_create,
    BLOB.after_create,
    BLOB.middle,
    BLOB.after_write,
    BLOB.after_sync,
    BLOB.before_rename,
    BLOB.after_rename,
    LOG.before_create,
    LOG.after_create,
    LOG.middle,
    LOG.after_write,
    LOG.after_sync,
    LOG.before_rename,
    LOG.after_rename,
    INDEX.before_create,
    INDEX.after_create,
    INDEX.middle,
    INDEX.after_write,
    INDEX.before_rename,
    INDEX.after_rename,
    PUBLISH.before_create,
    PUBLISH.after_create,
    PUBLISH.middle,
    PUBLISH.after_write,
    PUBLISH.after_sync,
    PUBLISH.before_rename,
    PUBLISH.after_rename,
    PUBLISH_SYNCED,
    APPEND_BEFORE,
    APPEND_MIDDLE,
    APPEND_AFTER,
    FLUSH_BEFORE,
    FLUSH_AFTER,
    QUARANTINE_BEFORE,
    QUARANTINE_AFTER,
    LEASE_ACQUIRED,
    LEASE_UNLINKED,
    GC_RECORDS_GONE,
    GC_BLOB_GONE,
];

/// Failpoints in the code that writes a file under a temporary name and renames it.
#[derive(Debug)]
pub(crate) struct FilePoints {
    pub before_create: &'static str,
    pub after_create: &'static str,
    pub middle: &'static str,
    pub after_write: &'static str,
    pub after_sync: &'static str,
    pub before_rename: &'static str,
    pub after_rename: &'static str,
}

macro_rules! file_points {
    ($prefix:literal) => {
        FilePoints {
            before_create: concat!($prefix, ".before-create"),
            after_create: concat!($prefix, ".after-create"),
            middle: concat!($prefix, ".middle"),
            after_write: concat!($prefix, ".after-write"),
            after_sync: concat!($prefix, ".after-sync"),
            before_rename: concat!($prefix, ".before-rename"),
            after_rename: concat!($prefix, ".after-rename"),
        }
    };
}

/// Failpoints in the code that writes a blob to a separate file.
pub(crate) const BLOB: FilePoints = file_points!("blob");
/// Failpoints in the code that writes a new or compacted log.
pub(crate) const LOG: FilePoints = file_points!("log");
/// Failpoints in the code that writes the index of a log.
pub(crate) const INDEX: FilePoints = file_points!("index");
/// Failpoints in the code that writes a file for the user.
pub(crate) const PUBLISH: FilePoints = file_points!("publish");

/// The point just after the folder of a published file has been synced.
pub(crate) const PUBLISH_SYNCED: &str = "publish.folder-synced";

pub(crate) const APPEND_BEFORE: &str = "append.before";
/// The point at which half of the bytes of an entry have been appended.
pub(crate) const APPEND_MIDDLE: &str = "append.middle";
pub(crate) const APPEND_AFTER: &str = "append.after";
pub(crate) const FLUSH_BEFORE: &str = "flush.before";
pub(crate) const FLUSH_AFTER: &str = "flush.after";
pub(crate) const QUARANTINE_BEFORE: &str = "quarantine.before";
pub(crate) const QUARANTINE_AFTER: &str = "quarantine.after";
pub(crate) const LEASE_ACQUIRED: &str = "lease.acquired";
pub(crate) const LEASE_UNLINKED: &str = "lease.unlinked";
/// The point in a garbage collection after all records to be removed have been removed, and before the first blob
/// is removed.
pub(crate) const GC_RECORDS_GONE: &str = "gc.records-gone";
/// The point in a garbage collection just after a blob stored as a separate file has been removed. It is reached
/// once for each such blob.
pub(crate) const GC_BLOB_GONE: &str = "gc.blob-gone";

/// Does nothing: failpoints are disabled.
#[cfg(not(feature = "failpoints"))]
#[inline(always)]
pub(crate) fn reach(_name: &'static str) -> std::io::Result<()> {
    Ok(())
}

#[cfg(feature = "failpoints")]
pub(crate) use active::reach;

#[cfg(feature = "failpoints")]
mod active {
    use std::io;
    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicU64, Ordering};

    enum Effect {
        Abort,
        Error(io::ErrorKind),
    }

    struct Armed {
        name: String,
        count: u64,
        effect: Effect,
        reached: AtomicU64,
    }

    fn armed() -> Option<&'static Armed> {
        static ARMED: OnceLock<Option<Armed>> = OnceLock::new();
        ARMED.get_or_init(|| parse(&std::env::var("LIGHTHARMONY_FAILPOINT").ok()?)).as_ref()
    }

    fn parse(text: &str) -> Option<Armed> {
        let mut fields = text.split(':');
        let name = fields.next()?.to_owned();
        let count = fields.next()?.parse().ok()?;
        let effect = match fields.next() {
            Some("error") => Effect::Error(io::ErrorKind::Other),
            Some("full") => Effect::Error(io::ErrorKind::StorageFull),
            _ => Effect::Abort,
        };
        Some(Armed { name, count, effect, reached: AtomicU64::new(0) })
    }

    /// Aborts the process or returns an error if the environment variable names the failpoint `name`, and the
    /// failpoint is now reached for the `count`-th time.
    pub(crate) fn reach(name: &'static str) -> io::Result<()> {
        let Some(armed) = armed().filter(|armed| armed.name == name) else { return Ok(()) };
        if armed.reached.fetch_add(1, Ordering::Relaxed) + 1 != armed.count {
            return Ok(());
        }
        match armed.effect {
            Effect::Abort => std::process::abort(),
            Effect::Error(kind) => {
                Err(io::Error::new(kind, format!("simulated error at the failpoint `{name}`")))
            }
        }
    }
}
