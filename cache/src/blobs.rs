//! [`Blobs`]: content by its digest. Small ones share a log, larger ones are a file each.

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
use crate::stamp::same_file;
use crate::store::{Fsync, Incident, lock};
use crate::temp::{TempFile, sync_folder};

/// Shorter blobs live in the log: below this, a file costs more time and space than its content.
pub(crate) const SMALL: usize = 4096;

const DAY: Duration = Duration::from_secs(24 * 60 * 60);

/// The kind of a blob's entry in the log.
const KIND: u8 = 2;

#[derive(Debug)]
pub(crate) enum Blobs {
    Memory(Mutex<HashMap<Digest, Vec<u8>>>),
    Disk(Box<Disk>),
}

#[derive(Debug)]
pub(crate) struct Disk {
    folder: PathBuf,
    settings: Settings,
    fsync: Fsync,
    /// Opened when first needed: a run that finds nothing to do reads no blob.
    small: Mutex<Option<Log>>,
    /// Bad blobs that could be neither moved nor removed.
    bad: Mutex<BTreeSet<Digest>>,
    unsynced: Mutex<Vec<PathBuf>>,
}

impl Blobs {
    pub fn in_memory() -> Blobs {
        Blobs::Memory(Mutex::default())
    }

    /// Blobs in files below `folder`, small ones in the log of `settings`.
    pub fn on_disk(folder: PathBuf, settings: Settings, fsync: Fsync) -> Blobs {
        let (small, bad, unsynced) = (Mutex::default(), Mutex::default(), Mutex::default());
        Blobs::Disk(Box::new(Disk { folder, settings, fsync, small, bad, unsynced }))
    }

    pub fn put(&self, digest: &Digest, bytes: &[u8]) -> Result<()> {
        match self {
            Blobs::Memory(blobs) => {
                lock(blobs).entry(*digest).or_insert_with(|| bytes.to_vec());
                Ok(())
            }
            Blobs::Disk(disk) => disk.put(digest, bytes),
        }
    }

    /// The bytes, which have this digest. A bad blob is put aside and `report`ed.
    pub fn get(&self, digest: &Digest, report: impl Fn(Incident)) -> Result<Option<Vec<u8>>> {
        match self {
            Blobs::Memory(blobs) => Ok(lock(blobs).get(digest).cloned()),
            Blobs::Disk(disk) => disk.get(digest, report),
        }
    }

    /// Whether a blob is there; whether it is good shows when it is read.
    pub fn has(&self, digest: &Digest) -> bool {
        match self {
            Blobs::Memory(blobs) => lock(blobs).contains_key(digest),
            Blobs::Disk(disk) => disk.has(digest),
        }
    }

    /// Rewrites the log of small blobs if much of it is dead or damaged, and its index if it lacks much.
    pub fn tidy(&self) -> Result<()> {
        let Blobs::Disk(disk) = self else { return Ok(()) };
        let mut small = lock(&disk.small);
        let Some(log) = small.as_mut() else { return Ok(()) };
        if log.wants_compaction() {
            log.compact(|_, _| true)?;
        }
        log.save_index()
    }

    /// Notices what other processes did to the log of small blobs, if it was opened.
    pub fn refresh(&self) {
        if let Blobs::Disk(disk) = self
            && let Some(log) = lock(&disk.small).as_mut()
        {
            // What cannot be read now is found out by whoever reads it.
            let _ = log.refresh();
        }
    }

    /// Digest and size of every blob in the log of small ones.
    pub fn small_sizes(&self) -> Result<Vec<(Digest, u64)>> {
        let Blobs::Disk(disk) = self else { return Ok(Vec::new()) };
        disk.with_small(|log| log.refresh().and_then(|_| log.lengths(KIND)))
    }

    /// Bytes of the log of small blobs that are dead.
    pub fn small_dead(&self) -> u64 {
        let Blobs::Disk(disk) = self else { return 0 };
        disk.with_small(|log| Ok(log.dead())).unwrap_or(0)
    }

    /// Reads the whole log of small blobs and gives its damaged bytes.
    pub fn reread_small(&self) -> Result<u64> {
        let Blobs::Disk(disk) = self else { return Ok(0) };
        disk.with_small(Log::reread)
    }

    /// Reads a blob and says whether it is good; leaves it where it is.
    pub fn is_good(&self, digest: &Digest) -> Result<bool> {
        let Blobs::Disk(disk) = self else { return Ok(true) };
        match disk.with_small(|log| log.get(KIND, digest))? {
            Some(bytes) => Ok(Digest::of(&bytes) == *digest),
            None => Ok(read_file(&disk.path(digest)).is_ok_and(|(bytes, _)| Digest::of(&bytes) == *digest)),
        }
    }

    /// Removes blobs.
    pub fn remove(&self, dead: &BTreeSet<Digest>) -> Result<()> {
        let Blobs::Disk(disk) = self else { return Ok(()) };
        self.remove_files(dead)?;
        disk.with_small(|log| {
            log.compact(|_, key| !dead.contains(key))?;
            log.save_index()
        })
    }

    /// Removes those that are files of their own, which takes no room.
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

    /// Syncs what was put since the last time.
    pub fn sync(&self) -> Result<()> {
        match self {
            Blobs::Memory(_) => Ok(()),
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
            Ok((bytes, read)) => (Some(read), format!("{} bytes that are not its content", bytes.len())),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                self.with_small(Log::refresh)?;
                return self.get_small(digest, &report);
            }
            Err(error) if is_our_trouble(&error) => return Err(Error::io("read", &path, error)),
            Err(error) => (None, error.to_string()),
        };
        // Another process may have put a good one in its place by now; that one stays.
        let there = fs::metadata(&path);
        if there.is_ok_and(|there| read.is_none_or(|read| same_file(&read, &there))) {
            report(self.put_aside(digest, &path, &what)?);
        }
        Ok(None)
    }

    /// Notes, once a day, that a blob was read: the time of its file is that of its last use.
    fn mark_used(&self, path: &Path, read: &Metadata) {
        let now = SystemTime::now();
        let fresh = read.modified().is_ok_and(|time| now.duration_since(time).is_ok_and(|past| past < DAY));
        if self.settings.writable && !fresh {
            // A collection may take it earlier than it should, which costs time only.
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
                    what: "a small blob was damaged; removed".to_owned(),
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

    fn sync(&self) -> Result<()> {
        if self.fsync == Fsync::Off {
            return Ok(());
        }
        let paths = std::mem::take(&mut *lock(&self.unsynced));
        for path in &paths {
            match OpenOptions::new().write(true).open(path).and_then(|file| file.sync_data()) {
                // Collected or put aside since.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => {
                    // After a failed sync nobody knows what is on the disk.
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

    /// Moves a bad blob out of the way, or removes it, or at least remembers it.
    fn put_aside(&self, digest: &Digest, path: &Path, what: &str) -> Result<Incident> {
        reach(failpoint::QUARANTINE_BEFORE).at("put aside", path)?;
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
        reach(failpoint::QUARANTINE_AFTER).at("put aside", path)?;
        Ok(Incident { digest: Some(*digest), what: format!("{} held {what}; {outcome}", path.display()) })
    }

    fn with_small<T>(&self, act: impl FnOnce(&mut Log) -> Result<T>) -> Result<T> {
        let mut small = lock(&self.small);
        let log = match small.take() {
            Some(log) => log,
            None => Log::open(self.settings.clone())?,
        };
        act(small.insert(log))
    }

    /// Two digits name a folder, so that none grows too long.
    fn path(&self, digest: &Digest) -> PathBuf {
        let name = digest.to_string();
        self.folder.join(&name[..2]).join(name)
    }
}

/// The whole file, and which file that was.
fn read_file(path: &Path) -> io::Result<(Vec<u8>, Metadata)> {
    let mut file = File::open(path)?;
    let metadata = file.metadata()?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(metadata.len()).unwrap_or(usize::MAX))?;
    file.read_to_end(&mut bytes)?;
    Ok((bytes, metadata))
}

/// Whether reading failed for want of something in this process or of permission, and not for what is on
/// the disk.
fn is_our_trouble(error: &io::Error) -> bool {
    // EMFILE and ENFILE, which have no stable kind.
    let files = cfg!(unix) && matches!(error.raw_os_error(), Some(23 | 24));
    files || matches!(error.kind(), io::ErrorKind::OutOfMemory | io::ErrorKind::PermissionDenied)
}
