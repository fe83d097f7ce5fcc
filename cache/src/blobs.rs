//! [`Blobs`]: stored contents, identified by their digests. Small blobs share a log; each larger blob is a separate
//! file.

use std::collections::{BTreeSet, HashMap};
use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, SystemTime};

use crate::digest::Digest;
use crate::error::{At, Error, Result};
use crate::failpoint::{self, BLOB, reach};
use crate::log::{Log, Settings};
use crate::obstacle::{Expected, clear, clear_folder};
use crate::regular;
use crate::settings::{Fsync, Incident, lock};
use crate::stamp::same_file;
use crate::temp::{TempFile, sync_folder};

/// Minimum length in bytes of a blob that is stored as a separate file. Shorter blobs are stored in the log, since
/// a file would cost more time and space than its content.
pub(crate) const SMALL: usize = 4096;

const DAY: Duration = Duration::from_secs(24 * 60 * 60);

/// Kind of the log entries that contain blobs.
const KIND: u8 = 2;

/// All blobs of a store.
#[derive(Debug)]
pub(crate) enum Blobs {
    /// Blobs in memory, by digest.
    Memory(Mutex<HashMap<Digest, Vec<u8>>>),
    /// Blobs in a cache folder.
    Disk(Box<Disk>),
    /// No storage: no blob is kept.
    Nowhere,
}

/// The blobs in a cache folder.
#[derive(Debug)]
pub(crate) struct Disk {
    root: PathBuf,
    settings: Settings,
    fsync: Fsync,
    /// The log of small blobs, opened on first use, since a run with nothing to compute reads no blob.
    small: Mutex<Option<Log>>,
    /// Damaged blobs that could be neither moved nor removed.
    bad: Mutex<BTreeSet<Digest>>,
    /// Paths of files written since the last sync.
    unsynced: Mutex<Vec<PathBuf>>,
}

impl Blobs {
    /// Blobs in memory only.
    pub fn in_memory() -> Blobs {
        Blobs::Memory(Mutex::default())
    }

    /// Blobs in a cache folder. Large blobs are files below `root`; small blobs are in the log with the given
    /// `settings`.
    pub fn on_disk(root: PathBuf, settings: Settings, fsync: Fsync) -> Blobs {
        let (small, bad, unsynced) = (Mutex::default(), Mutex::default(), Mutex::default());
        Blobs::Disk(Box::new(Disk { root, settings, fsync, small, bad, unsynced }))
    }

    /// Stores `bytes` under `digest`.
    pub fn put(&self, digest: &Digest, bytes: &[u8]) -> Result<()> {
        match self {
            Blobs::Nowhere => Ok(()),
            Blobs::Memory(blobs) => {
                lock(blobs).entry(*digest).or_insert_with(|| bytes.to_vec());
                Ok(())
            }
            Blobs::Disk(disk) => disk.put(digest, bytes),
        }
    }

    /// The bytes with this digest, verified. A damaged blob is quarantined and reported.
    pub fn get(&self, digest: &Digest, report: impl Fn(Incident)) -> Result<Option<Vec<u8>>> {
        match self {
            Blobs::Nowhere => Ok(None),
            Blobs::Memory(blobs) => Ok(lock(blobs).get(digest).cloned()),
            Blobs::Disk(disk) => disk.get(digest, report),
        }
    }

    /// True if a blob with this digest is stored. Its content is not verified.
    pub fn has(&self, digest: &Digest) -> bool {
        match self {
            Blobs::Nowhere => false,
            Blobs::Memory(blobs) => lock(blobs).contains_key(digest),
            Blobs::Disk(disk) => disk.has(digest),
        }
    }

    /// The length in bytes of the blob with this digest; `None` if it is not stored. Large blobs are not read.
    pub fn length(&self, digest: &Digest, report: impl Fn(Incident)) -> Option<u64> {
        match self {
            Blobs::Nowhere => None,
            Blobs::Memory(blobs) => lock(blobs).get(digest).map(|bytes| bytes.len() as u64),
            Blobs::Disk(disk) => disk.length(digest, report),
        }
    }

    /// Rewrites the log of small blobs if it is damaged or contains mostly dead entries. Rewrites the index of the
    /// log if many entries are missing from it.
    pub fn tidy(&self) -> Result<()> {
        let Blobs::Disk(disk) = self else { return Ok(()) };
        let mut small = lock(&disk.small);
        let Some(log) = small.as_mut() else { return Ok(()) };
        if log.wants_compaction() {
            log.compact(|_, _| true)?;
        }
        log.save_index()
    }

    /// Reads what other processes appended to the log of small blobs, if the log is open.
    pub fn refresh(&self) {
        if let Blobs::Disk(disk) = self
            && let Some(log) = lock(&disk.small).as_mut()
        {
            // An error recurs, and is reported, when a blob is read.
            let _ = log.refresh();
        }
    }

    /// The digest and length in bytes of every small blob.
    pub fn small_sizes(&self) -> Result<Vec<(Digest, u64)>> {
        let Blobs::Disk(disk) = self else { return Ok(Vec::new()) };
        disk.with_small(|log| log.refresh().and_then(|_| log.lengths(KIND)))
    }

    /// The total size in bytes of the replaced and removed entries in the log of small blobs.
    pub fn small_dead(&self) -> u64 {
        let Blobs::Disk(disk) = self else { return 0 };
        disk.with_small(|log| Ok(log.dead())).unwrap_or(0)
    }

    /// Reads the whole log of small blobs and returns the number of its damaged bytes.
    pub fn reread_small(&self) -> Result<u64> {
        let Blobs::Disk(disk) = self else { return Ok(0) };
        disk.with_small(Log::reread)
    }

    /// Reads a blob and returns whether it is undamaged. Changes nothing.
    pub fn is_good(&self, digest: &Digest) -> Result<bool> {
        let Blobs::Disk(disk) = self else { return Ok(true) };
        match disk.with_small(|log| log.get(KIND, digest))? {
            Some(bytes) => Ok(Digest::of(&bytes) == *digest),
            None => Ok(read_file(&disk.path(digest)).is_ok_and(|(bytes, _)| Digest::of(&bytes) == *digest)),
        }
    }

    /// Removes the blobs with these digests.
    pub fn remove(&self, dead: &BTreeSet<Digest>) -> Result<()> {
        let Blobs::Disk(disk) = self else { return Ok(()) };
        self.remove_files(dead)?;
        disk.with_small(|log| {
            log.compact(|_, key| !dead.contains(key))?;
            log.save_index()
        })
    }

    /// Removes those blobs in `dead` that are stored as separate files. This needs no free disk space.
    pub fn remove_files(&self, dead: &BTreeSet<Digest>) -> Result<()> {
        let Blobs::Disk(disk) = self else { return Ok(()) };
        for digest in dead {
            let path = disk.path(digest);
            match fs::remove_file(&path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(Error::io("remove", &path, error));
                }
                _ => reach(failpoint::GC_BLOB_GONE).at("remove", &path)?,
            }
        }
        Ok(())
    }

    /// Makes sure that all blobs that were stored since the last call survive a loss of power. Does nothing if the
    /// policy is [`Fsync::Off`].
    pub fn sync(&self) -> Result<()> {
        match self {
            Blobs::Memory(_) | Blobs::Nowhere => Ok(()),
            Blobs::Disk(disk) => disk.sync(),
        }
    }
}

impl Disk {
    fn put(&self, digest: &Digest, bytes: &[u8]) -> Result<()> {
        if !self.settings.writable {
            return Ok(());
        }
        if bytes.len() < SMALL {
            return self.with_small(|log| {
                if log.contains(KIND, digest)? { Ok(()) } else { log.append(&[(KIND, *digest, bytes)]) }
            });
        }
        let path = self.path(digest);
        let there =
            fs::metadata(&path).is_ok_and(|found| found.is_file() && found.len() == bytes.len() as u64);
        if there && !lock(&self.bad).contains(digest) {
            return Ok(());
        }
        // Obstacles are reported when a blob is read; these here need no report.
        path.parent().into_iter().for_each(|parent| drop(clear(&self.root, parent, Expected::Folder)));
        clear_folder(&self.root, &path);
        let mut temp = TempFile::create(&self.settings.temp, &BLOB)?;
        temp.write(bytes)?;
        if self.fsync == Fsync::Always {
            temp.sync()?;
        }
        temp.persist(&path)?;
        lock(&self.bad).remove(digest);
        match self.fsync {
            Fsync::Always => path.parent().into_iter().for_each(sync_folder),
            Fsync::Batch => lock(&self.unsynced).push(path),
            Fsync::Off => {}
        }
        Ok(())
    }

    fn get(&self, digest: &Digest, report: impl Fn(Incident)) -> Result<Option<Vec<u8>>> {
        if let Some(bytes) = self.get_small(digest, &report)? {
            return Ok(Some(bytes));
        }
        if lock(&self.bad).contains(digest) {
            return Ok(None);
        }
        let path = self.path(digest);
        let (read, what) = match read_file(&path) {
            Ok((bytes, read)) if Digest::of(&bytes) == *digest => {
                self.mark_used(&path, &read);
                return Ok(Some(bytes));
            }
            Ok((bytes, read)) => {
                (Some(read), format!("the content ({} bytes) does not match the digest", bytes.len()))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                self.with_small(Log::refresh)?;
                return self.get_small(digest, &report);
            }
            Err(error) if is_own_failure(&error) => return Err(Error::io("read", &path, error)),
            Err(error) => (None, error.to_string()),
        };
        // Another process may have replaced the file by an undamaged one in the meantime.
        let there = fs::metadata(&path);
        if there.is_ok_and(|there| read.is_none_or(|read| same_file(&read, &there))) {
            report(self.quarantine(digest, &path, &what)?);
        }
        Ok(None)
    }

    /// Sets the modification time of a blob's file to the current time, at most once a day. A collection uses the
    /// modification time as the time of the last use of the blob.
    fn mark_used(&self, path: &Path, read: &Metadata) {
        let now = SystemTime::now();
        let fresh = read.modified().is_ok_and(|time| now.duration_since(time).is_ok_and(|past| past < DAY));
        if self.settings.writable && !fresh {
            // If this fails, a collection may remove the blob too early, which costs only time.
            let _ = File::options().write(true).open(path).and_then(|file| file.set_modified(now));
        }
    }

    fn get_small(&self, digest: &Digest, report: &impl Fn(Incident)) -> Result<Option<Vec<u8>>> {
        self.with_small(|log| match log.get(KIND, digest)? {
            Some(bytes) if Digest::of(&bytes) == *digest => Ok(Some(bytes)),
            Some(_) => {
                log.drop_entry(KIND, digest);
                report(Incident {
                    digest: Some(*digest),
                    what: "the entry in the log of small blobs does not match the digest and was removed"
                        .to_owned(),
                });
                Ok(None)
            }
            None => Ok(None),
        })
    }

    fn has(&self, digest: &Digest) -> bool {
        let known = |log: &mut Log| log.contains(KIND, digest);
        let found = |known: Result<bool>| known.unwrap_or(false);
        found(self.with_small(known))
            || (fs::metadata(self.path(digest)).is_ok_and(|found| found.is_file())
                && !lock(&self.bad).contains(digest))
            || found(self.with_small(|log| log.refresh().and_then(|_| known(log))))
    }

    fn length(&self, digest: &Digest, report: impl Fn(Incident)) -> Option<u64> {
        let found = fs::metadata(self.path(digest)).ok().filter(Metadata::is_file);
        let small = || self.get_small(digest, &report).ok().flatten().map(|bytes| bytes.len() as u64);
        found.map(|found| found.len()).or_else(small)
    }

    fn sync(&self) -> Result<()> {
        if self.fsync == Fsync::Off {
            return Ok(());
        }
        let paths = std::mem::take(&mut *lock(&self.unsynced));
        for path in &paths {
            match OpenOptions::new().write(true).open(path).and_then(|file| file.sync_data()) {
                // The file was collected or quarantined in the meantime.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => {
                    // After a failed sync the content on the disk is unknown.
                    let _ = fs::remove_file(path);
                    return Err(Error::io("sync", path, error));
                }
                Ok(()) => {}
            }
        }
        let folders: BTreeSet<&Path> = paths.iter().filter_map(|path| path.parent()).collect();
        folders.into_iter().for_each(sync_folder);
        lock(&self.small).as_mut().map_or(Ok(()), Log::sync)
    }

    /// Moves a damaged blob to the quarantine. If this fails, removes the blob. If this fails too, adds the digest
    /// to `bad`. Returns a description that consists of the path, `what`, and the action taken.
    fn quarantine(&self, digest: &Digest, path: &Path, what: &str) -> Result<Incident> {
        reach(failpoint::QUARANTINE_BEFORE).at("quarantine", path)?;
        let aside = self.settings.quarantine.join(digest.to_string());
        let moved = self.settings.writable
            && fs::create_dir_all(&self.settings.quarantine).and_then(|()| fs::rename(path, &aside)).is_ok();
        let outcome = if moved {
            format!("moved to {}", aside.display())
        } else if self.settings.writable
            && fs::remove_file(path).or_else(|_| fs::remove_dir_all(path)).is_ok()
        {
            "removed".to_owned()
        } else {
            lock(&self.bad).insert(*digest);
            "ignored".to_owned()
        };
        reach(failpoint::QUARANTINE_AFTER).at("quarantine", path)?;
        Ok(Incident { digest: Some(*digest), what: format!("{}: {what}; {outcome}", path.display()) })
    }

    /// Calls `act` with the log of small blobs, which is opened if necessary.
    fn with_small<T>(&self, act: impl FnOnce(&mut Log) -> Result<T>) -> Result<T> {
        let mut small = lock(&self.small);
        let log = match small.take() {
            Some(log) => log,
            None => Log::open(self.settings.clone())?,
        };
        act(small.insert(log))
    }

    /// The path of a blob's file. The name of the folder is the first two digits of the digest, so that no folder
    /// has too many entries.
    fn path(&self, digest: &Digest) -> PathBuf {
        let name = digest.to_string();
        self.root.join("blobs").join(&name[..2]).join(name)
    }
}

/// Returns the content of a file, and the metadata that the file had when it was opened.
fn read_file(path: &Path) -> io::Result<(Vec<u8>, Metadata)> {
    let mut file = regular::open(path, OpenOptions::new().read(true))?;
    let metadata = file.metadata()?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(metadata.len()).unwrap_or(usize::MAX))?;
    file.read_to_end(&mut bytes)?;
    Ok((bytes, metadata))
}

/// True if reading failed because this process lacks memory, file handles or permission, and not because the stored
/// data are damaged.
fn is_own_failure(error: &io::Error) -> bool {
    // EMFILE and ENFILE, which have no stable `ErrorKind`.
    let no_handles = cfg!(unix) && matches!(error.raw_os_error(), Some(23 | 24));
    no_handles || matches!(error.kind(), io::ErrorKind::OutOfMemory | io::ErrorKind::PermissionDenied)
}
