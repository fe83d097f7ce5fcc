//! [`Store`]: one cache folder, or a store in memory. It is not based on an embedded database: none supports many
//! writing processes, opens in less than a millisecond and also survives a kill at any moment.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant, SystemTime};

use crate::blobs::Blobs;
use crate::digest::Digest;
use crate::error::{At, Error, Result};
use crate::failpoint::{self, reach};
use crate::file_lock::{FileGuard, FileLock};
use crate::history::{Table, USED, seconds};
use crate::lease::{Lease, LeaseState, Leases, try_lease};
use crate::log::{Log, Settings};
use crate::memo;
use crate::obstacle::{self, QUARANTINE};
use crate::settings::{FORMAT, Fsync, Incident, Options, kind, lock};
use crate::stamp::FileStamp;
use crate::temp::{TempFile, remove_stale_files};

const DAY_SECONDS: u64 = 24 * 60 * 60;

/// The maximum number of memos that are only in memory. When this number is reached, they are written to the log.
const MAX_PENDING_MEMOS: usize = 4096;

/// The maximum length of a value in a history table, in bytes.
const MAX_VALUE: usize = 64 << 10;

/// A guard that marks a run as active until the guard is dropped; see [`Store::begin_run`].
#[must_use = "the run counts as ended when this is dropped"]
pub struct Running(#[allow(dead_code, reason = "held until dropped")] Option<FileGuard>);

/// Blobs, records, memos, history and leases in one folder, which any number of threads and processes can share.
///
/// In a read-only store, every operation that would write does nothing and succeeds.
#[derive(Debug)]
pub struct Store {
    folder: Option<PathBuf>,
    /// The reason why nothing is written; `None` if the store is writable.
    read_only: Option<String>,
    fsync: Fsync,
    records: Mutex<Log>,
    blobs: Blobs,
    /// Memos that are not yet in the log.
    pending_memos: Mutex<BTreeMap<Digest, Vec<u8>>>,
    /// The history tables that were opened, by name.
    tables: Mutex<BTreeMap<String, Table>>,
    leases: Leases,
    incidents: Mutex<Vec<Incident>>,
}

impl Store {
    /// Opens the cache in `folder`, creating it if necessary. If the folder cannot be written or the disk is full,
    /// the cache is opened read-only; see [`why_read_only`](Self::why_read_only). A cache that does not exist and
    /// cannot be created is opened as an empty read-only cache. Anything of the wrong type at the path of a file or
    /// folder of the cache is moved to the quarantine and reported as an [`Incident`].
    ///
    /// # Errors
    /// If `folder` is not a folder or cannot be read; see [`unavailable`](Self::unavailable).
    pub fn open(folder: &Path, options: Options) -> Result<Store> {
        let reading = |why: String| Store::open_as(folder, options.fsync, Some(why));
        if options.read_only {
            return reading("the cache was opened as read-only".to_owned());
        }
        match Store::open_as(folder, options.fsync, None) {
            // Stored results can still be read.
            Err(error) if error.is_read_only() || matches!(error, Error::Full { .. }) => {
                let cause = std::error::Error::source(&error).map(|source| format!(": {source}"));
                reading(format!("{error}{}", cause.unwrap_or_default()))
            }
            result => result,
        }
    }

    /// A store without a folder, which keeps everything in memory.
    pub fn in_memory() -> Store {
        Store::new(None, None, Fsync::Off, Log::in_memory(), Blobs::in_memory())
    }

    /// An empty read-only store that replaces a cache that could not be opened. `why` is the reason why it could
    /// not be opened. A run with such a store computes everything and stores nothing.
    pub fn unavailable(why: String) -> Store {
        Store::new(None, Some(why), Fsync::Off, Log::in_memory(), Blobs::Nowhere)
    }

    fn open_as(folder: &Path, fsync: Fsync, read_only: Option<String>) -> Result<Store> {
        let writable = read_only.is_none();
        let root = folder.join(FORMAT);
        let mut obstacles = Vec::new();
        if writable {
            create_folder(folder, &root)?;
            obstacles = obstacle::clear_all(&root);
            // Only creating a file shows whether files can be created: existing logs may be writable although their
            // folder is not.
            TempFile::create(&root.join("temp"), &failpoint::LOG)?;
        }
        let settings = |name: &str| Settings {
            path: root.join(name).with_extension("log"),
            lock: root.join(name).with_extension("lock"),
            temp: root.join("temp"),
            quarantine: root.join(QUARANTINE),
            writable,
            sync: fsync == Fsync::Always,
        };
        let records = Log::open(settings("records"))?;
        let blobs = Blobs::on_disk(root.clone(), settings("blobs"), fsync);
        let store = Store::new(Some(root), read_only, fsync, records, blobs);
        obstacles.into_iter().for_each(|obstacle| store.report(obstacle));
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
        Store {
            folder,
            read_only,
            fsync,
            records: Mutex::new(records),
            blobs,
            pending_memos: Mutex::default(),
            tables: Mutex::default(),
            leases: Leases::default(),
            incidents: Mutex::default(),
        }
    }

    /// True if nothing is written.
    pub fn is_read_only(&self) -> bool {
        self.read_only.is_some()
    }

    /// The reason why nothing is written; `None` if the store is writable.
    pub fn why_read_only(&self) -> Option<&str> {
        self.read_only.as_deref()
    }

    /// The damage found since the last call.
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

    /// The lock that a run holds as shared and a collection holds as exclusive. `None` if the store cannot be
    /// written.
    pub(crate) fn runs(&self) -> Result<Option<FileLock>> {
        match &self.folder {
            Some(folder) if !self.is_read_only() => FileLock::open(&folder.join("runs.lock")).map(Some),
            _ => Ok(None),
        }
    }

    /// Marks a run of `graph` as active until the returned guard is dropped. No collection can start while the run
    /// is active. If a collection is active, this function waits until it ends or `cancelled` returns true. It
    /// also records that the history table named `graph` was used today.
    pub fn begin_run(&self, graph: &str, cancelled: &dyn Fn() -> bool) -> Running {
        let today = today();
        // Stored in a separate table, since reading the table of a large graph takes long.
        let name = Table::key(graph).to_string();
        if self.history_get(USED, &name).as_deref() != Some(&today.to_le_bytes()) {
            self.history_put(USED, &name, &today.to_le_bytes());
        }
        // Where locks do not work there is no collection either.
        let guard = self.runs().ok().flatten().and_then(|runs| runs.shared_when_free(cancelled));
        // Entries that a collection removed since the folder was opened must no longer be found. An error here
        // recurs, and is reported, when an entry is read.
        let _ = lock(&self.records).refresh();
        self.blobs.refresh();
        Running(guard)
    }

    fn report_damage(&self, records: &mut Log) {
        let damaged = records.take_damaged();
        if damaged > 0 {
            let what = format!(
                "the cache's log of records contains damaged data, which was skipped (bytes: {damaged})"
            );
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
    /// If the blob cannot be written: see [`Error`].
    pub fn put_blob(&self, bytes: &[u8]) -> Result<Digest> {
        let digest = Digest::of(bytes);
        self.put_blob_as(&digest, bytes)?;
        Ok(digest)
    }

    /// Stores `bytes` under a digest that the caller has computed. A wrong digest does no harm: it is detected when
    /// the blob is read.
    ///
    /// # Errors
    /// If the blob cannot be written: see [`Error`].
    pub fn put_blob_as(&self, digest: &Digest, bytes: &[u8]) -> Result<()> {
        self.blobs.put(digest, bytes)
    }

    /// The bytes with this digest, verified; `None` if they are not stored. A damaged blob is quarantined and
    /// reported as an [`Incident`], and `None` is returned.
    ///
    /// # Errors
    /// If reading fails because of missing permission, memory or file handles.
    pub fn get_blob(&self, digest: &Digest) -> Result<Option<Vec<u8>>> {
        self.blobs.get(digest, |incident| self.report(incident))
    }

    /// The length in bytes of a blob; `None` if it is not stored. Large blobs are not read.
    pub fn blob_length(&self, digest: &Digest) -> Option<u64> {
        self.blobs.length(digest, |incident| self.report(incident))
    }

    /// True if a blob with this digest exists. The blob is not read, so it is not verified.
    pub fn has_blob(&self, digest: &Digest) -> bool {
        self.blobs.has(digest)
    }

    // --- records ---

    /// Stores `payload` under `key`, replacing any previous payload. Once this returns, the record survives the
    /// death of any process, with one exception: if another process was stopped while it held the lock, the record
    /// is written without the lock. The record is lost if that process later replaces the log with a compacted one
    /// and is killed before it copies the record. The result is then computed again.
    ///
    /// # Errors
    /// If the record cannot be written or is longer than 16 MiB: see [`Error`].
    pub fn put_record(&self, key: &Digest, payload: &[u8]) -> Result<()> {
        if self.is_read_only() {
            return Ok(());
        }
        lock(&self.records).append(&[(kind::RECORD, *key, payload)])
    }

    /// The payload last stored under `key` by any process.
    pub fn get_record(&self, key: &Digest) -> Option<Vec<u8>> {
        let mut records = lock(&self.records);
        let found = match records.get(kind::RECORD, key) {
            // Another process may have stored it.
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

    /// Removes the record that is stored under `key`.
    ///
    /// # Errors
    /// If the removal cannot be written: see [`Error`].
    pub fn remove_record(&self, key: &Digest) -> Result<()> {
        if self.is_read_only() {
            return Ok(());
        }
        lock(&self.records).remove(kind::RECORD, key)
    }

    /// The keys of all records that this process knows, sorted. Records that other processes have stored since the
    /// last refresh may be missing.
    ///
    /// # Errors
    /// If the log cannot be read.
    pub fn record_keys(&self) -> Result<Vec<Digest>> {
        lock(&self.records).keys(kind::RECORD)
    }

    // --- memos and history ---

    /// The stored digest of the file at `path`, if it was stored with an equal stamp that can be trusted; see
    /// [`FileStamp::is_settled`].
    pub fn memo_get(&self, path: &Path, stamp: &FileStamp) -> Option<Digest> {
        let key = memo::key(path).ok()?;
        if let Some(memo) = lock(&self.pending_memos).get(&key) {
            return memo::recall(memo, stamp);
        }
        memo::recall(&lock(&self.records).get(kind::MEMO, &key).ok()??, stamp)
    }

    /// Stores that the file at `path` had this digest when `stamp` was taken. The stamp must have been taken before
    /// the file was read. The memo is written by the next [`flush`](Self::flush).
    pub fn memo_put(&self, path: &Path, stamp: &FileStamp, digest: &Digest) {
        let Ok(key) = memo::key(path) else { return };
        let full = {
            let mut pending = lock(&self.pending_memos);
            pending.insert(key, memo::encode(stamp, digest));
            pending.len() >= MAX_PENDING_MEMOS
        };
        if full {
            // If they cannot be written, the files are read again.
            let _ = self.write_pending();
        }
    }

    /// The digest and length in bytes of the file at `path`, if a valid memo of the file exists.
    pub fn known_digest(&self, path: &Path) -> Option<(Digest, u64)> {
        let stamp = FileStamp::of(path).ok()?;
        Some((self.memo_get(path, &stamp)?, stamp.size))
    }

    /// The digest and length in bytes of the file at `path`. The file is read only if it has no valid memo.
    ///
    /// # Errors
    /// If the file cannot be read, or is not a regular file.
    pub fn digest_file(&self, path: &Path) -> io::Result<(Digest, u64)> {
        self.digest_file_unless(path, &|| false).map(|found| found.expect("not cancelled"))
    }

    /// Like [`digest_file`](Self::digest_file), but returns `None` as soon as `cancelled` returns true. A file of many
    /// gigabytes takes longer to read than a user waits.
    ///
    /// # Errors
    /// If the file cannot be read, or is not a regular file.
    pub fn digest_file_unless(
        &self,
        path: &Path,
        cancelled: &dyn Fn() -> bool,
    ) -> io::Result<Option<(Digest, u64)>> {
        let before = FileStamp::of(path)?;
        if let Some(digest) = self.memo_get(path, &before) {
            return Ok(Some((digest, before.size)));
        }
        let Some((digest, length)) = memo::read_digest(path, cancelled)? else { return Ok(None) };
        if length == before.size && FileStamp::of(path)? == before {
            self.memo_put(path, &before, &digest);
        }
        Ok(Some((digest, length)))
    }

    /// Stores `value` under `name` in a history table, replacing any previous value. Each table is read and written
    /// as a whole. Values over 64 KiB are not stored. The table is written by the next [`flush`](Self::flush);
    /// until then the value may be lost.
    pub fn history_put(&self, table: &str, name: &str, value: &[u8]) {
        if value.len() <= MAX_VALUE {
            self.with_table(table, |table| table.put(name, value));
        }
    }

    /// The value last stored under `name` in a history table.
    pub fn history_get(&self, table: &str, name: &str) -> Option<Vec<u8>> {
        self.with_table(table, |table| table.get(name).map(<[u8]>::to_vec))
    }

    /// If a history table has more than `limit` values, removes each value for whose name `keep` returns false.
    pub fn history_trim(&self, table: &str, limit: usize, keep: impl Fn(&str) -> bool) {
        self.with_table(table, |table| table.trim(limit, keep));
    }

    fn with_table<T>(&self, name: &str, act: impl FnOnce(&mut Table) -> T) -> T {
        let mut tables = lock(&self.tables);
        if let Some(table) = tables.get_mut(name) {
            return act(table);
        }
        let stored = lock(&self.records).get(kind::HISTORY, &Table::key(name));
        let table = Table::open(stored.ok().flatten().unwrap_or_default());
        act(tables.entry(name.to_owned()).insert_entry(table).into_mut())
    }

    /// Writes pending memos and changed history tables to the log.
    fn write_pending(&self) -> Result<()> {
        let memos = std::mem::take(&mut *lock(&self.pending_memos));
        if self.is_read_only() {
            return Ok(());
        }
        let items: Vec<_> = memos.iter().map(|(key, memo)| (kind::MEMO, *key, memo.as_slice())).collect();
        let mut tables = lock(&self.tables);
        let mut records = lock(&self.records);
        if !items.is_empty() {
            records.append(&items)?;
        }
        for (name, table) in tables.iter_mut().filter(|(_, table)| table.is_changed()) {
            let key = Table::key(name);
            records.refresh()?;
            let bytes = table.encode(records.get(kind::HISTORY, &key)?.unwrap_or_default());
            records.append(&[(kind::HISTORY, key, &bytes)])?;
            *table = Table::open(bytes);
        }
        Ok(())
    }

    // --- leases ---

    /// Requests the right to compute `key`. A caller that gets the lease must look for the record again, since the
    /// previous holder may have stored it.
    pub fn lease(&self, key: &Digest) -> LeaseState {
        match &self.folder {
            Some(folder) if !self.is_read_only() => {
                self.leases.request(key, &folder.join("leases").join(key.to_string()))
            }
            _ => LeaseState::Acquired(Lease::unlocked()),
        }
    }

    /// Renews all leases of this store, so that other processes continue to wait for them. Must be called every
    /// second while leases are held; see [`LeaseState::Stalled`].
    pub fn renew_leases(&self) {
        self.leases.renew();
    }

    /// Requests the lease repeatedly until it is no longer busy. Returns `Busy` after `timeout`, or when
    /// `cancelled` returns true.
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

    /// Ends a run: writes memos and history, syncs unless the policy is [`Fsync::Off`], and compacts logs that are
    /// damaged or contain mostly dead entries.
    ///
    /// # Errors
    /// If writing or syncing fails: see [`Error`]. A blob that could not be synced is removed.
    pub fn flush(&self) -> Result<()> {
        let Some(folder) = self.folder.as_deref().filter(|_| !self.is_read_only()) else { return Ok(()) };
        reach(failpoint::FLUSH_BEFORE).at("flush", folder)?;
        self.write_pending()?;
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

    /// Removes the lease files and temporary files that killed processes left in the cache folder. Returns the
    /// number of temporary files removed.
    pub fn sweep(&self) -> usize {
        let Some(folder) = self.folder.as_deref().filter(|_| !self.is_read_only()) else { return 0 };
        let leases = fs::read_dir(folder.join("leases")).into_iter().flatten().flatten();
        // Acquiring and dropping a lease removes its file.
        leases.for_each(|lease| drop(try_lease(&lease.path())));
        remove_stale_files(&folder.join("temp"))
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        if !self.is_read_only() {
            // If this fails, memos and history are lost, which is allowed.
            let _ = self.write_pending();
        }
    }
}

/// The start of the current day (UTC) in seconds since 1970. For the last use of a result, only the day is
/// recorded.
pub fn today() -> u64 {
    seconds(SystemTime::now()) / DAY_SECONDS * DAY_SECONDS
}

/// Creates the cache folder with a tag file. The tag file makes backup programs skip the folder.
fn create_folder(folder: &Path, root: &Path) -> Result<()> {
    if root.is_dir() {
        return Ok(());
    }
    fs::create_dir_all(root).at("create", root)?;
    let tag = "Signature: 8a477f597d28d172789f06886806bc55\n# This folder is a cache of lightharmony.\n";
    // Optional: if it cannot be written, backups contain the cache.
    let _ = fs::write(folder.join("CACHEDIR.TAG"), tag);
    Ok(())
}
