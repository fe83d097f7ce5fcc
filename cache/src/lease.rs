//! [`Lease`]: the exclusive right to compute the result of a key. If several processes need the same result, one of
//! them computes it and the others wait.
//!
//! A lease is a kernel lock on a file, so it ends with its process even if the process is killed. Leases only save
//! work: where locks are not supported, every request is granted. Holders renew their leases by setting the
//! modification time of the file. Other processes do not wait for a holder that fails to do so, such as a stopped
//! process. This is safe: equal keys give equal bytes, so a result may be computed twice.

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

/// The time after which a lease counts as stalled if its holder has not renewed it. Holders renew their leases
/// every second.
pub const STALLED_AFTER: Duration = Duration::from_secs(10);

/// The result of a request for a lease.
#[derive(Debug)]
pub enum LeaseState {
    /// The lease was granted. It is held until it is dropped.
    Acquired(Lease),
    /// The lease is held by another thread or process.
    Busy,
    /// The lease is held by another process that has not renewed it for [`STALLED_AFTER`], for example because that
    /// process is stopped. The caller may compute the result under the returned lease, which excludes no other
    /// process.
    Stalled(Lease),
}

/// A held lease. Dropping it releases it.
#[derive(Debug)]
#[must_use = "a lease ends when it is dropped"]
pub struct Lease {
    held: Option<(PathBuf, Arc<File>)>,
}

impl Lease {
    /// A lease that excludes no other process.
    pub(crate) fn unlocked() -> Lease {
        Lease { held: None }
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        let Some((path, file)) = self.held.take() else { return };
        // Removed while still locked: a process that opened this file before sees, once it has the lock, that the
        // path no longer leads to it, and asks again. Windows removes no file that is open in another process, and
        // `same_file` compares only times of creation there, so the file stays.
        if cfg!(unix) {
            let _ = fs::remove_file(path);
            let _ = reach(failpoint::LEASE_UNLINKED);
        }
        let _ = file.unlock();
    }
}

/// The leases that a store holds, and the leases for which the store waits.
#[derive(Debug, Default)]
pub(crate) struct Leases {
    held: Mutex<Vec<Weak<File>>>,
    /// For each lease for which the store waits: the modification time of the lease file, and the moment at which
    /// this modification time was first seen.
    awaited: Mutex<BTreeMap<Digest, (Option<SystemTime>, Instant)>>,
}

impl Leases {
    /// Tries once to lock `path`, the lease file of `key`.
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

    /// Renews the held leases, so that waiting processes see that the holder is working.
    pub fn renew(&self) {
        let now = SystemTime::now();
        lock(&self.held).retain(|file| {
            // If a lease cannot be renewed, its key is computed twice at worst.
            file.upgrade().map(|file| file.set_modified(now)).is_some()
        });
    }
}

/// Tries once to lock the file at `path`. Creates the file if it is missing.
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

/// Opens and locks the file at `path`. Returns `None` if another process removed the file after it was opened and
/// before it was locked.
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

/// Locks a file that was opened at `path`. Returns `None` if there is now another file or no file at `path`.
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
        // Acts as if the wait had begun that long ago.
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
