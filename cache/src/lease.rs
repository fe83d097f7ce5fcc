//! [`Lease`]: the right to compute a key, so that of several processes one works and the others wait.
//!
//! A lease is a kernel lock on a file, so it ends with its process, however that ends. It only saves work:
//! where locks do not work, everybody gets every lease.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use crate::failpoint::{self, reach};
use crate::stamp::same_file;

/// The answer to asking for a lease.
#[derive(Debug)]
pub enum LeaseState {
    /// It is ours until dropped.
    Acquired(Lease),
    /// Another thread or process has it.
    Busy,
}

/// A held lease; dropping it lets the next one in.
#[derive(Debug)]
#[must_use = "a lease ends when it is dropped"]
pub struct Lease {
    held: Option<(PathBuf, File)>,
}

impl Lease {
    /// A lease that keeps nobody out.
    pub(crate) fn unlocked() -> Lease {
        Lease { held: None }
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        let Some((path, file)) = self.held.take() else { return };
        // Removed while still locked: whoever opened this file before sees, once it has the lock, that the
        // path no longer leads to it, and asks again.
        if cfg!(unix) {
            let _ = fs::remove_file(path);
            let _ = reach(failpoint::LEASE_UNLINKED);
        }
        let _ = file.unlock();
    }
}

/// Tries once to lock the file at `path`, creating it.
pub(crate) fn try_lease(path: &Path) -> LeaseState {
    loop {
        match try_lock(path) {
            Ok(Some(file)) => {
                let _ = reach(failpoint::LEASE_ACQUIRED);
                return LeaseState::Acquired(Lease { held: Some((path.to_path_buf(), file)) });
            }
            Ok(None) => {}
            Err(TryLockError::WouldBlock) => return LeaseState::Busy,
            Err(TryLockError::Error(_)) => return LeaseState::Acquired(Lease::unlocked()),
        }
    }
}

/// `None` if the file was removed by its holder between our opening and our locking it.
fn try_lock(path: &Path) -> Result<Option<File>, TryLockError> {
    let open = || OpenOptions::new().write(true).create(true).truncate(false).open(path);
    let file = match (open(), path.parent()) {
        (Err(error), Some(folder)) if error.kind() == io::ErrorKind::NotFound => {
            fs::create_dir_all(folder).map_err(TryLockError::Error)?;
            open().map_err(TryLockError::Error)?
        }
        (result, _) => result.map_err(TryLockError::Error)?,
    };
    lock_opened(path, file)
}

/// Locks a file opened at `path`; `None` if the path meanwhile leads to another file or to none.
fn lock_opened(path: &Path, file: File) -> Result<Option<File>, TryLockError> {
    file.try_lock()?;
    let ours = file.metadata().map_err(TryLockError::Error)?;
    Ok(fs::metadata(path).is_ok_and(|there| same_file(&there, &ours)).then_some(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_on_a_removed_file_is_no_lease() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lease");
        let LeaseState::Acquired(first) = try_lease(&path) else { panic!("busy") };
        let late = File::open(&path).unwrap();
        assert!(matches!(lock_opened(&path, late.try_clone().unwrap()), Err(TryLockError::WouldBlock)));
        drop(first);
        assert!(matches!(lock_opened(&path, late.try_clone().unwrap()), Ok(None)), "removed");
        late.unlock().unwrap();
        let LeaseState::Acquired(_second) = try_lease(&path) else { panic!("busy") };
        assert!(matches!(lock_opened(&path, late), Ok(None)), "removed, and another in its place");
    }
}
