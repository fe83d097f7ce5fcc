//! [`FileLock`]: a lock between processes, on a file that is never replaced or removed.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::error::{At, Result};
use crate::regular;

/// A file that every thread of every process can lock.
#[derive(Debug)]
pub(crate) struct FileLock(Arc<File>);

/// A held lock. Its owner must not lock the same [`FileLock`] again: dropping the second guard would release the
/// first lock, too.
pub(crate) struct FileGuard(Arc<File>);

impl FileLock {
    /// Opens or creates the file to lock, and its folder.
    pub fn open(path: &Path) -> Result<FileLock> {
        let file = match (regular::open_or_create(path), path.parent()) {
            (Err(error), Some(folder)) if error.kind() == io::ErrorKind::NotFound => {
                fs::create_dir_all(folder).at("create", folder)?;
                regular::open_or_create(path)
            }
            (result, _) => result,
        };
        Ok(FileLock(Arc::new(file.at("open", path)?)))
    }

    /// Locks the file exclusively, waiting for at most `timeout`. Returns `None` if the lock was not obtained in
    /// this time, or if the file system has no locks.
    pub fn exclusive(&self, timeout: Duration) -> Option<FileGuard> {
        let start = Instant::now();
        loop {
            match self.0.try_lock() {
                Ok(()) => return Some(FileGuard(Arc::clone(&self.0))),
                Err(TryLockError::WouldBlock) if start.elapsed() < timeout => {
                    std::thread::sleep(Duration::from_micros(200));
                }
                Err(_) => return None,
            }
        }
    }

    /// Takes a shared lock. If another process holds the lock exclusively, waits until it is released. Returns
    /// `None` once `cancelled` returns true, or if the file system has no locks.
    pub fn shared_when_free(&self, cancelled: &dyn Fn() -> bool) -> Option<FileGuard> {
        loop {
            match self.0.try_lock_shared() {
                Ok(()) => return Some(FileGuard(Arc::clone(&self.0))),
                Err(TryLockError::WouldBlock) if !cancelled() => std::thread::sleep(Duration::from_millis(5)),
                Err(_) => return None,
            }
        }
    }

    /// Tries once to take a shared lock. Returns `None` if that fails.
    pub fn shared(&self) -> Option<FileGuard> {
        self.0.try_lock_shared().ok().map(|()| FileGuard(Arc::clone(&self.0)))
    }
}

impl Drop for FileGuard {
    fn drop(&mut self) {
        let _ = self.0.unlock();
    }
}
