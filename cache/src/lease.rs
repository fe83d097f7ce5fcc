//! [`Lease`]: the right to compute a key, so that of several processes one computes and the others wait.
//!
//! A lease is a kernel lock on a file, so it ends with its process, however that ends. It only saves work: where locks
//! do not work, everybody gets every lease. Holders renew their leases, which sets the time of the file. A holder that
//! does not, such as a stopped process, is not waited for: equal keys give equal bytes, so computing twice is safe.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant, SystemTime};

use crate::digest::Digest;
use crate::failpoint::{self, reach};
use crate::regular;
use crate::settings::lock;
use crate::stamp::same_file;

/// The time after which a lease that its holder has not renewed counts as stalled. Holders renew every second.
pub const STALLED_AFTER: Duration = Duration::from_secs(10);

/// The answer to a request for a lease.
#[derive(Debug)]
pub enum LeaseState {
    /// It is ours until dropped.
    Acquired(Lease),
    /// Another thread or process has it.
    Busy,
    /// Another process has it and has not renewed it for [`STALLED_AFTER`], for example because it is stopped. The
    /// key may be computed here, too, under this lease, which excludes nobody.
    Stalled(Lease),
}

/// A held lease; dropping it admits the next one.
#[derive(Debug)]
#[must_use = "a lease ends when it is dropped"]
pub struct Lease {
    held: Option<(PathBuf, Arc<File>)>,
}

impl Lease {
    /// A lease that excludes nobody.
    pub(crate) fn unlocked() -> Lease {
        Lease { held: None }
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        let Some((path, file)) = self.held.take() else { return };
        // Removed while still locked: a process that opened this file before sees, once it has the lock, that the
        // path no longer leads to it, and asks again.
        if cfg!(unix) {
            let _ = fs::remove_file(path);
            let _ = reach(failpoint::LEASE_UNLINKED);
        }
        let _ = file.unlock();
    }
}

/// The leases that a store holds and those that it waits for.
#[derive(Debug, Default)]
pub(crate) struct Leases {
    held: Mutex<Vec<Weak<File>>>,
    /// For each lease held elsewhere: the time of its file, and since when it has been the same.
    awaited: Mutex<BTreeMap<Digest, (Option<SystemTime>, Instant)>>,
}

impl Leases {
    /// Tries once to lock the file at `path`, which belongs to `key`.
    pub fn request(&self, key: &Digest, path: &Path) -> LeaseState {
        let state = try_lease(path);
        let mut awaited = lock(&self.awaited);
        match &state {
            LeaseState::Busy => {
                let renewed = fs::metadata(path).and_then(|file| file.modified()).ok();
                let now = Instant::now();
                let (last, since) = awaited.entry(*key).or_insert((renewed, now));
                if *last != renewed {
                    (*last, *since) = (renewed, now);
                } else if now.duration_since(*since) >= STALLED_AFTER {
                    return LeaseState::Stalled(Lease::unlocked());
                }
            }
            LeaseState::Acquired(lease) => {
                awaited.remove(key);
                lock(&self.held).extend(lease.held.iter().map(|(_, file)| Arc::downgrade(file)));
            }
            LeaseState::Stalled(_) => {}
        }
        state
    }

    /// Shows those who wait that the holder is at work.
    pub fn renew(&self) {
        let now = SystemTime::now();
        lock(&self.held).retain(|file| {
            // A lease that cannot be renewed is computed twice at worst.
            file.upgrade().map(|file| file.set_modified(now)).is_some()
        });
    }
}

/// Tries once to lock the file at `path`, creating it.
pub(crate) fn try_lease(path: &Path) -> LeaseState {
    loop {
        match try_lock(path) {
            Ok(Some(file)) => {
                let _ = reach(failpoint::LEASE_ACQUIRED);
                return LeaseState::Acquired(Lease { held: Some((path.to_path_buf(), Arc::new(file))) });
            }
            Ok(None) => {}
            Err(TryLockError::WouldBlock) => return LeaseState::Busy,
            Err(TryLockError::Error(_)) => return LeaseState::Acquired(Lease::unlocked()),
        }
    }
}

/// `None` if the file was removed by its holder between our opening and our locking it.
fn try_lock(path: &Path) -> Result<Option<File>, TryLockError> {
    let file = match (regular::open_or_create(path), path.parent()) {
        (Err(error), Some(folder)) if error.kind() == io::ErrorKind::NotFound => {
            fs::create_dir_all(folder).map_err(TryLockError::Error)?;
            regular::open_or_create(path).map_err(TryLockError::Error)?
        }
        (result, _) => result.map_err(TryLockError::Error)?,
    };
    lock_opened(path, file)
}

/// Locks a file opened at `path`; `None` if the path now leads to another file or to none.
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

    #[test]
    fn a_lease_that_is_not_renewed_stalls_and_one_that_is_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let (key, path) = (Digest::of(b"key"), folder.path().join("lease"));
        let (holder, waiter) = (Leases::default(), Leases::default());
        let LeaseState::Acquired(lease) = holder.request(&key, &path) else { panic!("busy") };
        assert!(matches!(waiter.request(&key, &path), LeaseState::Busy));
        // As if the wait had begun that long ago.
        let long_ago = |waiter: &Leases| {
            let since = Instant::now().checked_sub(STALLED_AFTER).unwrap();
            lock(&waiter.awaited).values_mut().for_each(|(_, begin)| *begin = since);
        };
        long_ago(&waiter);
        std::thread::sleep(Duration::from_millis(20));
        holder.renew();
        assert!(matches!(waiter.request(&key, &path), LeaseState::Busy), "renewed");
        long_ago(&waiter);
        assert!(matches!(waiter.request(&key, &path), LeaseState::Stalled(_)));
        assert!(matches!(waiter.request(&key, &path), LeaseState::Stalled(_)), "until it is renewed");
        drop(lease);
        assert!(matches!(waiter.request(&key, &path), LeaseState::Acquired(_)));
        holder.renew();
        assert!(lock(&holder.held).is_empty());
    }
}
