//! [`FileLock`]: a lock between processes, on a file that is never replaced or removed.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::error::{At, Result};

/// A lock that is held by nobody or somebody, in this process or another.
#[derive(Debug)]
pub(crate) struct FileLock(Arc<File>);

/// A held lock. Its owner must not take it again: the second guard would give up the first's.
pub(crate) struct FileGuard(Arc<File>);

impl FileLock {
    /// Opens or creates the file to lock, and its folder.
    pub fn open(path: &Path) -> Result<FileLock> {
        let open = || OpenOptions::new().write(true).create(true).truncate(false).open(path);
        let file = match (open(), path.parent()) {
            (Err(error), Some(folder)) if error.kind() == io::ErrorKind::NotFound => {
                fs::create_dir_all(folder).at("create", folder)?;
                open()
            }
            (result, _) => result,
        };
        Ok(FileLock(Arc::new(file.at("open", path)?)))
    }

    /// Tries for as long as `patience` to be alone. `None` where that is in vain, or locks do not work.
    pub fn exclusive(&self, patience: Duration) -> Option<FileGuard> {
        let start = Instant::now();
        loop {
            match self.0.try_lock() {
                Ok(()) => return Some(FileGuard(Arc::clone(&self.0))),
                Err(TryLockError::WouldBlock) if start.elapsed() < patience => {
                    std::thread::sleep(Duration::from_micros(200));
                }
                Err(_) => return None,
            }
        }
    }

    /// Waits until writers are out, or until `cancelled`. `None` then, and where locks do not work.
    pub fn shared_when_free(&self, cancelled: &dyn Fn() -> bool) -> Option<FileGuard> {
        loop {
            match self.0.try_lock_shared() {
                Ok(()) => return Some(FileGuard(Arc::clone(&self.0))),
                Err(TryLockError::WouldBlock) if !cancelled() => std::thread::sleep(Duration::from_millis(5)),
                Err(_) => return None,
            }
        }
    }

    /// Tries once to keep writers out.
    pub fn shared(&self) -> Option<FileGuard> {
        self.0.try_lock_shared().ok().map(|()| FileGuard(Arc::clone(&self.0)))
    }
}

impl Drop for FileGuard {
    fn drop(&mut self) {
        let _ = self.0.unlock();
    }
}
