//! [`Store`]: one cache folder, or none.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use crate::blobs::Blobs;
use crate::digest::Digest;
use crate::error::{At, Error, Result};
use crate::failpoint::{self, reach};
use crate::file_lock::{FileGuard, FileLock};
use crate::gc;
use crate::history::Book;
use crate::lease::{Lease, LeaseState, try_lease};
use crate::log::{Log, Settings};
use crate::memo;
use crate::stamp::FileStamp;
use crate::temp::{TempFile, sweep_temp};

/// The kinds of entries in the log of records. Numbers not listed are kept as they are by compaction.
pub(crate) mod kind {
    pub const RECORD: u8 = 1;
    pub const MEMO: u8 = 3;
    pub const HISTORY: u8 = 4;
}

/// The version of everything below it; a new format gets a new folder and never meets an old one.
pub(crate) const FORMAT: &str = "v1";

const DAY_SECONDS: u64 = 24 * 60 * 60;

/// Memos wait for company up to this many.
const MANY: usize = 4096;

/// The longest value of history, in bytes.
const LONGEST_NOTE: usize = 64 << 10;

/// When written data is forced onto the disk. It never matters to a killed process, only to a loss of power;
/// and what is lost then is noticed by the verified reads and computed again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fsync {
    /// Once, by [`Store::flush`].
    #[default]
    Batch,
    /// After every blob and record.
    Always,
    /// Never.
    Off,
}

/// How to open a [`Store`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// When to sync.
    pub fsync: Fsync,
    /// Write nothing, even if that were possible. A folder that cannot be written is found out without this.
    pub read_only: bool,
}

/// A run is at work; see [`Store::begin_run`].
#[must_use = "the run is over when this is dropped"]
pub struct Running(#[allow(dead_code, reason = "held until dropped")] Option<FileGuard>);

/// Damage that was found and dealt with; worth one line of warning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Incident {
    /// The blob that was damaged; `None` if it was a log.
    pub digest: Option<Digest>,
    /// What was found and what became of it.
    pub what: String,
}

impl fmt::Display for Incident {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.digest {
            Some(digest) => write!(f, "damaged blob {}: {}", digest.short(), self.what),
            None => f.write_str(&self.what),
        }
    }
}

/// Blobs, records, memos, history and leases in one folder, shared by any number of threads and processes.
///
/// Of a read-only store, everything that would write does nothing and succeeds.
#[derive(Debug)]
pub struct Store {
    folder: Option<PathBuf>,
    /// Why nothing is written, where that is so.
    read_only: Option<String>,
    fsync: Fsync,
    records: Mutex<Log>,
    blobs: Blobs,
    /// Memos not yet in the log.
    waiting: Mutex<BTreeMap<Digest, Vec<u8>>>,
    /// The books of history that were opened, by name.
    books: Mutex<BTreeMap<String, Book>>,
    incidents: Mutex<Vec<Incident>>,
}

impl Store {
    /// Opens the cache in `folder`, creating it if need be. If it cannot be written, it is opened read-only,
    /// empty if it does not exist, and so it is if the disk is full to the last byte; see
    /// [`why_read_only`](Self::why_read_only).
    ///
    /// # Errors
    /// When the folder is not one or cannot be read.
    pub fn open(folder: &Path, options: Options) -> Result<Store> {
        let reading = |why: String| Store::open_as(folder, options.fsync, Some(why));
        if options.read_only {
            return reading("it was opened for reading".to_owned());
        }
        match Store::open_as(folder, options.fsync, None) {
            // What is there can still be used.
            Err(error) if error.is_read_only() || matches!(error, Error::Full { .. }) => {
                let cause = std::error::Error::source(&error).map(|source| format!(": {source}"));
                reading(format!("{error}{}", cause.unwrap_or_default()))
            }
            result => result,
        }
    }

    /// A store without a folder, for tests and for runs that leave no trace.
    pub fn in_memory() -> Store {
        Store::new(None, None, Fsync::Off, Log::in_memory(), Blobs::in_memory())
    }

    fn open_as(folder: &Path, fsync: Fsync, read_only: Option<String>) -> Result<Store> {
        let writable = read_only.is_none();
        let root = folder.join(FORMAT);
        if writable {
            create_folder(folder, &root)?;
            // Only trying tells whether files can be made: existing logs may be writable where their folder
            // is not.
            TempFile::create(&root.join("temp"), &failpoint::LOG)?;
        }
        let settings = |name: &str| Settings {
            path: root.join(name).with_extension("log"),
            lock: root.join(name).with_extension("lock"),
            temp: root.join("temp"),
            quarantine: root.join("quarantine"),
            writable,
            sync: fsync == Fsync::Always,
        };
        let records = Log::open(settings("records"))?;
        let blobs = Blobs::on_disk(root.join("blobs"), settings("blobs"), fsync);
        let store = Store::new(Some(root), read_only, fsync, records, blobs);
        store.report_damage(&mut lock(&store.records));
        Ok(store)
    }

    fn new(
        folder: Option<PathBuf>,
        read_only: Option<String>,
        fsync: Fsync,
        records: Log,
        blobs: Blobs,
    ) -> Store {
        let (waiting, books, incidents) = (Mutex::default(), Mutex::default(), Mutex::default());
        Store { folder, read_only, fsync, records: Mutex::new(records), blobs, waiting, books, incidents }
    }

    /// Whether writes are left out.
    pub fn is_read_only(&self) -> bool {
        self.read_only.is_some()
    }

    /// Why writes are left out, where they are.
    pub fn why_read_only(&self) -> Option<&str> {
        self.read_only.as_deref()
    }

    /// Takes the damage found since the last call.
    pub fn take_incidents(&self) -> Vec<Incident> {
        std::mem::take(&mut lock(&self.incidents))
    }

    pub(crate) fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    pub(crate) fn records(&self) -> &Mutex<Log> {
        &self.records
    }

    pub(crate) fn blobs(&self) -> &Blobs {
        &self.blobs
    }

    /// The lock that runs share and a collection has alone; `None` where nothing can be written.
    pub(crate) fn runs(&self) -> Result<Option<FileLock>> {
        match &self.folder {
            Some(folder) if !self.is_read_only() => FileLock::open(&folder.join("runs.lock")).map(Some),
            _ => Ok(None),
        }
    }

    /// Says that a run is at work, until the guard is dropped: no collection removes anything meanwhile. Waits
    /// for one that is at work, for as long as `cancelled` allows. Notes when `book` was used.
    pub fn begin_run(&self, book: &str, cancelled: &dyn Fn() -> bool) -> Running {
        let today = today();
        // In a book of its own, since that of a large graph takes long to read.
        let name = Book::key(book).to_string();
        if self.history_get(gc::USED, &name).as_deref() != Some(&today.to_le_bytes()) {
            self.history_put(gc::USED, &name, &today.to_le_bytes());
        }
        // Where locks do not work there is no collection either.
        let guard = self.runs().ok().flatten().and_then(|runs| runs.shared_when_free(cancelled));
        // What a collection took since the folder was opened must not be found any more. What cannot be read
        // now is found out by whoever reads it.
        let _ = lock(&self.records).refresh();
        self.blobs.refresh();
        Running(guard)
    }

    fn report_damage(&self, records: &mut Log) {
        let damaged = records.take_damaged();
        if damaged > 0 {
            let what = format!("{damaged} damaged bytes in the cache's records were skipped");
            self.report(Incident { digest: None, what });
        }
    }

    fn report(&self, incident: Incident) {
        let mut incidents = lock(&self.incidents);
        if !incidents.contains(&incident) {
            incidents.push(incident);
        }
    }

    // --- blobs ---

    /// Stores `bytes` and returns their digest.
    ///
    /// # Errors
    /// When it cannot be written: see [`Error`].
    pub fn put_blob(&self, bytes: &[u8]) -> Result<Digest> {
        let digest = Digest::of(bytes);
        self.put_blob_as(&digest, bytes)?;
        Ok(digest)
    }

    /// Stores `bytes`, of which the digest is known. A wrong digest harms nobody: it shows when read.
    ///
    /// # Errors
    /// When it cannot be written: see [`Error`].
    pub fn put_blob_as(&self, digest: &Digest, bytes: &[u8]) -> Result<()> {
        self.blobs.put(digest, bytes)
    }

    /// The bytes that have this digest: verified. A damaged blob is put aside, reported as an
    /// [`Incident`], and is as good as none.
    ///
    /// # Errors
    /// When reading fails for want of permission, memory or file handles.
    pub fn get_blob(&self, digest: &Digest) -> Result<Option<Vec<u8>>> {
        self.blobs.get(digest, |incident| self.report(incident))
    }

    /// Whether there is a blob of this digest, unread and so unverified.
    pub fn has_blob(&self, digest: &Digest) -> bool {
        self.blobs.has(digest)
    }

    // --- records ---

    /// Stores `payload` under `key`, replacing what was there. When this returns, a killed process cannot
    /// undo it.
    ///
    /// # Errors
    /// When it cannot be written, or is longer than 16 MiB: see [`Error`].
    pub fn put_record(&self, key: &Digest, payload: &[u8]) -> Result<()> {
        lock(&self.records).append(&[(kind::RECORD, *key, payload)])
    }

    /// What was last stored under `key` by any process.
    pub fn get_record(&self, key: &Digest) -> Option<Vec<u8>> {
        let mut records = lock(&self.records);
        let found = match records.get(kind::RECORD, key) {
            // Another process may have made it.
            Ok(None) => match records.refresh() {
                Ok(true) => records.get(kind::RECORD, key),
                Ok(false) => Ok(None),
                Err(error) => Err(error),
            },
            found => found,
        };
        self.report_damage(&mut records);
        found.unwrap_or_else(|error| {
            self.report(Incident { digest: None, what: error.to_string() });
            None
        })
    }

    /// Forgets what is stored under `key`.
    ///
    /// # Errors
    /// When that cannot be written: see [`Error`].
    pub fn remove_record(&self, key: &Digest) -> Result<()> {
        lock(&self.records).remove(kind::RECORD, key)
    }

    /// The keys of all records, in order, as far as this process has read.
    ///
    /// # Errors
    /// When the log cannot be read.
    pub fn record_keys(&self) -> Result<Vec<Digest>> {
        lock(&self.records).keys(kind::RECORD)
    }

    // --- memos and history ---

    /// The digest that the file at `path` had under an equal stamp, if that can be trusted: see
    /// [`FileStamp::is_settled`].
    pub fn memo_get(&self, path: &Path, stamp: &FileStamp) -> Option<Digest> {
        let key = memo::key(path).ok()?;
        if let Some(memo) = lock(&self.waiting).get(&key) {
            return memo::recall(memo, stamp);
        }
        memo::recall(&lock(&self.records).get(kind::MEMO, &key).ok()??, stamp)
    }

    /// Remembers that the file at `path` had this digest. The stamp must have been taken before the file
    /// was read. Written by the next [`flush`](Self::flush).
    pub fn memo_put(&self, path: &Path, stamp: &FileStamp, digest: &Digest) {
        let Ok(key) = memo::key(path) else { return };
        let full = {
            let mut waiting = lock(&self.waiting);
            waiting.insert(key, memo::encode(stamp, digest));
            waiting.len() >= MANY
        };
        if full {
            // A memo that cannot be written is a memo lost.
            let _ = self.write_notes();
        }
    }

    /// The digest and length in bytes of the file at `path`, if they are known without reading it.
    pub fn known_digest(&self, path: &Path) -> Option<(Digest, u64)> {
        let stamp = FileStamp::of(path).ok()?;
        Some((self.memo_get(path, &stamp)?, stamp.size))
    }

    /// The digest and length in bytes of the file at `path`, read only if no memo serves.
    ///
    /// # Errors
    /// What the system says about a file that cannot be read.
    pub fn digest_file(&self, path: &Path) -> io::Result<(Digest, u64)> {
        let before = FileStamp::of(path)?;
        if let Some(digest) = self.memo_get(path, &before) {
            return Ok((digest, before.size));
        }
        let (digest, length) = memo::read_digest(path)?;
        if length == before.size && FileStamp::of(path)? == before {
            self.memo_put(path, &before, &digest);
        }
        Ok((digest, length))
    }

    /// Remembers `value` under `name` in a book; the last one wins, and losing one is allowed. Notes that are
    /// read together belong in one book, which is read and written whole. A value over 64 KiB is no small
    /// note, and is not kept. Written by the next [`flush`](Self::flush).
    pub fn history_put(&self, book: &str, name: &str, value: &[u8]) {
        if value.len() <= LONGEST_NOTE {
            self.with_book(book, |book| book.put(name, value));
        }
    }

    /// What was last remembered under `name` in a book.
    pub fn history_get(&self, book: &str, name: &str) -> Option<Vec<u8>> {
        self.with_book(book, |book| book.get(name).map(<[u8]>::to_vec))
    }

    fn with_book<T>(&self, name: &str, act: impl FnOnce(&mut Book) -> T) -> T {
        let mut books = lock(&self.books);
        if let Some(book) = books.get_mut(name) {
            return act(book);
        }
        let stored = lock(&self.records).get(kind::HISTORY, &Book::key(name));
        act(books
            .entry(name.to_owned())
            .insert_entry(Book::open(stored.ok().flatten().unwrap_or_default()))
            .into_mut())
    }

    fn write_notes(&self) -> Result<()> {
        let memos = std::mem::take(&mut *lock(&self.waiting));
        let items: Vec<_> = memos.iter().map(|(key, memo)| (kind::MEMO, *key, memo.as_slice())).collect();
        let mut books = lock(&self.books);
        let mut records = lock(&self.records);
        if !items.is_empty() {
            records.append(&items)?;
        }
        for (name, book) in books.iter_mut().filter(|(_, book)| book.is_changed()) {
            let key = Book::key(name);
            records.refresh()?;
            let bytes = book.encode(records.get(kind::HISTORY, &key)?.unwrap_or_default());
            records.append(&[(kind::HISTORY, key, &bytes)])?;
            *book = Book::open(bytes);
        }
        Ok(())
    }

    // --- leases ---

    /// Asks for the right to compute `key`. Whoever gets it looks for the record once more: the holder
    /// before may have written it.
    pub fn lease(&self, key: &Digest) -> LeaseState {
        match &self.folder {
            Some(folder) if !self.is_read_only() => try_lease(&folder.join("leases").join(key.to_string())),
            _ => LeaseState::Acquired(Lease::unlocked()),
        }
    }

    /// Asks again and again until the lease is ours; `Busy` when `timeout` is over or `cancelled` says so.
    pub fn wait_for_lease(
        &self,
        key: &Digest,
        timeout: Duration,
        cancelled: &dyn Fn() -> bool,
    ) -> LeaseState {
        let start = Instant::now();
        let mut pause = Duration::from_millis(1);
        loop {
            match self.lease(key) {
                LeaseState::Busy if start.elapsed() < timeout && !cancelled() => {
                    std::thread::sleep(pause.min(timeout.saturating_sub(start.elapsed())));
                    pause = (pause * 2).min(Duration::from_millis(20));
                }
                state => return state,
            }
        }
    }

    // --- care ---

    /// Ends a run: writes memos and history, syncs unless [`Fsync::Off`], and rewrites a log of which
    /// most is dead.
    ///
    /// # Errors
    /// When writing or syncing fails: see [`Error`]. A blob that could not be synced is removed.
    pub fn flush(&self) -> Result<()> {
        let Some(folder) = self.folder.as_deref().filter(|_| !self.is_read_only()) else { return Ok(()) };
        reach(failpoint::FLUSH_BEFORE).at("flush", folder)?;
        self.write_notes()?;
        if self.fsync != Fsync::Off {
            self.blobs.sync()?;
            lock(&self.records).sync()?;
        }
        self.blobs.tidy()?;
        let mut records = lock(&self.records);
        if records.wants_compaction() {
            records.compact(|_, _| true)?;
        }
        records.save_index()?;
        drop(records);
        reach(failpoint::FLUSH_AFTER).at("flush", folder)
    }

    /// Removes what killed processes left in the cache folder: leases, and half-written files older than a
    /// day. Returns how many of the latter.
    pub fn sweep(&self) -> usize {
        let Some(folder) = self.folder.as_deref().filter(|_| !self.is_read_only()) else { return 0 };
        let leases = fs::read_dir(folder.join("leases")).into_iter().flatten().flatten();
        // Getting a lease and giving it back removes its file.
        leases.for_each(|lease| drop(try_lease(&lease.path())));
        sweep_temp(&folder.join("temp"))
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        if !self.is_read_only() {
            // Notes may be lost.
            let _ = self.write_notes();
        }
    }
}

/// The day, as the seconds since 1970 at which it began: the step in which uses of results are noted.
pub fn today() -> u64 {
    gc::seconds(SystemTime::now()) / DAY_SECONDS * DAY_SECONDS
}

/// Creates the cache folder, marked so that backup programs leave it out.
fn create_folder(folder: &Path, root: &Path) -> Result<()> {
    if root.is_dir() {
        return Ok(());
    }
    fs::create_dir_all(root).at("create", root)?;
    let tag = "Signature: 8a477f597d28d172789f06886806bc55\n# This folder is a cache of lightharmony.\n";
    // Only a courtesy.
    let _ = fs::write(folder.join("CACHEDIR.TAG"), tag);
    Ok(())
}

/// Locks a mutex. A thread that panicked in here left nothing half done that a later read would believe.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
