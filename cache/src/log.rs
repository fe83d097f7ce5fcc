//! [`Log`]: an append-only file of small checksummed entries, shared by threads and processes.

use std::collections::HashMap;
use std::fs::{self, File, Metadata, OpenOptions};
use std::hash::BuildHasherDefault;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::digest::Digest;
use crate::digest_hasher::DigestHasher;
use crate::entry::{self, Entry, MAX_PAYLOAD};
use crate::error::{At, Error, Result};
use crate::failpoint::{self, reach};
use crate::file_lock::{FileGuard, FileLock};
use crate::index::{Damaged, Index};
use crate::location::{EntryId, Location, LogSizes};
use crate::log_head;
use crate::page_cache::PageCache;
use crate::regular;
use crate::stamp::same_file;
use crate::temp::{TempFile, sync_folder};

/// An entry of this kind plus another's removes the other.
const REMOVED: u8 = 0x80;

/// Bytes per read.
const READ_BYTES: u64 = 1 << 20;

/// Logs with fewer dead bytes than this are not compacted.
const MIN_DEAD: u64 = 1 << 20;

/// An index is rewritten when at least this many bytes of the log are not in it, and a sixteenth of all.
const MIN_UNINDEXED: u64 = 64 << 10;

/// How long an append waits for another process, once: a stopped process must not stop us. Appending without the lock is
/// safe. Bytes of a log are never changed or cut off, and a writer without the lock finds out if a compaction replaced
/// the file meanwhile.
const LOCK_TIMEOUT: Duration = Duration::from_secs(2);

/// How often an append is repeated while compactions replace the file.
const APPEND_ATTEMPTS: usize = 5;

/// Where a log is stored and how it is written.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub path: PathBuf,
    /// The file that is locked while the log is written. Unlike the log it is never replaced.
    pub lock: PathBuf,
    pub temp: PathBuf,
    pub quarantine: PathBuf,
    pub writable: bool,
    /// Sync after every append.
    pub sync: bool,
}

/// The last entry of each kind and key, in a file or in memory only.
#[derive(Debug)]
pub(crate) struct Log {
    settings: Option<Arc<Settings>>,
    open: Option<Open>,
    lock: Option<FileLock>,
    /// The index of the first part of the file.
    index: Option<Index>,
    /// Whether an index turned out wrong; none is read again.
    index_rejected: bool,
    /// The entries after the part that is indexed; `None` for one that was removed.
    recent: HashMap<EntryId, Option<Location>, BuildHasherDefault<DigestHasher>>,
    /// All entries of a log without a file.
    memory: Vec<u8>,
    pages: PageCache,
    /// The end of the last entry that was read, as an offset in the file.
    parsed: u64,
    /// The length of the file when it was last read.
    length: u64,
    sizes: LogSizes,
    /// Damaged bytes that were not reported yet.
    unreported: u64,
    unsynced: bool,
    /// The last request for the lock timed out; the next one does not wait.
    lock_timed_out: bool,
}

#[derive(Debug)]
struct Open {
    file: File,
    metadata: Metadata,
    salt: u32,
}

/// An entry to append: kind, key, payload.
pub(crate) type Item<'a> = (u8, Digest, &'a [u8]);

impl Settings {
    fn index(&self) -> PathBuf {
        self.path.with_extension("index")
    }
}

impl Log {
    /// An empty log without a file.
    pub fn in_memory() -> Log {
        Log {
            settings: None,
            open: None,
            lock: None,
            index: None,
            index_rejected: false,
            recent: HashMap::default(),
            memory: Vec::new(),
            pages: PageCache::default(),
            parsed: 0,
            length: 0,
            sizes: LogSizes::default(),
            unreported: 0,
            unsynced: false,
            lock_timed_out: false,
        }
    }

    /// Opens the log, creating it where allowed, and reads its index.
    pub fn open(settings: Settings) -> Result<Log> {
        let settings = Arc::new(settings);
        let lock = if settings.writable { Some(FileLock::open(&settings.lock)?) } else { None };
        let mut log = Log { settings: Some(Arc::clone(&settings)), lock, ..Log::in_memory() };
        log.refresh()?;
        if settings.writable && log.open.is_none() {
            let guard = log.exclusive();
            log.catch_up()?;
            log.ensure_file(&settings, guard.is_some())?;
        }
        Ok(log)
    }

    /// Whether the entry exists, as far as this process has read.
    pub fn contains(&mut self, kind: u8, key: &Digest) -> Result<bool> {
        Ok(self.find(&(kind, *key))?.is_some())
    }

    /// The payload of the entry, as far as this process has read. Its checksums are verified by every call.
    pub fn get(&mut self, kind: u8, key: &Digest) -> Result<Option<Vec<u8>>> {
        let id = (kind, *key);
        for _ in 0..2 {
            let Some(location) = self.find(&id)? else { return Ok(None) };
            let salt = self.open.as_ref().map_or(0, |open| open.salt);
            let raw = self.read(location.offset, Entry::length(location.length as usize))?;
            if let Some(entry) = entry::decode(salt, raw)
                && (entry.kind, entry.key) == id
            {
                return Ok(Some(entry.payload.to_vec()));
            }
            // Damaged since it was indexed. Reading everything shows what else is.
            self.rescan()?;
        }
        self.drop_entry(kind, key);
        Ok(None)
    }

    /// The keys of all entries of a kind, in order.
    pub fn keys(&mut self, kind: u8) -> Result<Vec<Digest>> {
        let all = self.all()?.into_iter();
        Ok(all.filter(|((found, _), _)| *found == kind).map(|((_, key), _)| key).collect())
    }

    /// Every entry, sorted by key and then kind.
    fn all(&mut self) -> Result<Vec<(EntryId, Location)>> {
        let mut all = match self.index.as_mut().map(Index::all) {
            None => Vec::new(),
            Some(Ok(all)) => all,
            Some(Err(Damaged)) => {
                self.rescan()?;
                Vec::new()
            }
        };
        all.retain(|(id, _)| !self.recent.contains_key(id));
        #[allow(clippy::iter_over_hash_type, reason = "sorted below")]
        all.extend(self.recent.iter().filter_map(|(id, location)| Some((*id, (*location)?))));
        all.sort_unstable_by_key(|((kind, key), _)| (*key, *kind));
        Ok(all)
    }

    fn find(&mut self, id: &EntryId) -> Result<Option<Location>> {
        if let Some(known) = self.recent.get(id) {
            return Ok(*known);
        }
        match self.index.as_mut().map(|index| index.find(id)) {
            None => Ok(None),
            Some(Ok(location)) => Ok(location),
            Some(Err(Damaged)) => {
                self.rescan()?;
                Ok(self.recent.get(id).copied().flatten())
            }
        }
    }

    /// Forgets the index and reads the whole log.
    fn rescan(&mut self) -> Result<()> {
        self.index_rejected = true;
        self.reopen()?;
        self.read_tail()
    }

    /// Reads the whole file again without the index and returns the number of damaged bytes. What may be an entry that
    /// is being written does not count.
    pub fn reread(&mut self) -> Result<u64> {
        self.rescan()?;
        Ok(self.sizes.damaged)
    }

    /// Bytes of entries that were replaced, removed or cut short.
    pub fn dead(&self) -> u64 {
        self.sizes.dead
    }

    /// The length of the payload of every entry of a kind, by key.
    pub fn lengths(&mut self, kind: u8) -> Result<Vec<(Digest, u64)>> {
        let all = self.all()?.into_iter().filter(|((found, _), _)| *found == kind);
        Ok(all.map(|((_, key), location)| (key, location.length.into())).collect())
    }

    /// The number of damaged bytes found since the last call.
    pub fn take_damaged(&mut self) -> u64 {
        std::mem::take(&mut self.unreported)
    }

    /// Reads what other processes appended since the last call. Returns whether there was anything to read.
    pub fn refresh(&mut self) -> Result<bool> {
        if self.is_current()? {
            return Ok(false);
        }
        // Prevents reading half an entry; without the lock, the checksums prevent it.
        let _shared = self.lock.as_ref().and_then(FileLock::shared);
        self.catch_up()?;
        Ok(true)
    }

    /// Whether the file is the one that was read, and has not grown.
    fn is_current(&self) -> Result<bool> {
        let (Some(settings), Some(open)) = (&self.settings, &self.open) else {
            return Ok(self.settings.is_none());
        };
        let Some(metadata) = regular::metadata(&settings.path).at("read", &settings.path)? else {
            return Ok(false);
        };
        // What follows the last whole entry may be another one by now.
        let complete = self.parsed == self.length && metadata.len() == self.length;
        Ok(complete && same_file(&open.metadata, &metadata))
    }

    /// The same as [`refresh`](Self::refresh) for a caller that holds the lock, which must not be taken twice.
    fn catch_up(&mut self) -> Result<()> {
        let Some(settings) = self.settings.clone() else { return Ok(()) };
        let Some(metadata) = regular::metadata(&settings.path).at("read", &settings.path)? else {
            self.forget();
            return Ok(());
        };
        let known = self.open.as_ref().is_some_and(|open| same_file(&open.metadata, &metadata));
        if !known || metadata.len() < self.parsed {
            self.reopen()?;
        }
        self.read_tail()
    }

    /// Appends all items as one write.
    pub fn append(&mut self, items: &[Item<'_>]) -> Result<()> {
        if let Some((_, _, payload)) = items.iter().find(|(_, _, payload)| payload.len() > MAX_PAYLOAD) {
            return Err(Error::RecordTooLarge { length: payload.len(), limit: MAX_PAYLOAD });
        }
        let Some(settings) = self.settings.clone() else {
            let bytes = encode(items, 0);
            self.parse(0, self.memory.len() as u64, &bytes);
            self.memory.extend_from_slice(&bytes);
            return Ok(());
        };
        if !settings.writable || items.is_empty() {
            return Ok(());
        }
        let guard = self.exclusive();
        self.append_to_file(&settings, items, guard.is_some())
    }

    /// Appends to the file, which is `locked` or not.
    fn append_to_file(&mut self, settings: &Settings, items: &[Item<'_>], locked: bool) -> Result<()> {
        for _ in 0..APPEND_ATTEMPTS {
            self.catch_up()?;
            self.ensure_file(settings, locked)?;
            let Some(open) = &self.open else { break };
            let bytes = encode(items, open.salt);
            // On an error a part of an entry may be left, which readers skip.
            write_halves(&open.file, &bytes).at("append to", &settings.path)?;
            if settings.sync {
                open.file.sync_data().at("sync", &settings.path)?;
            }
            self.unsynced = true;
            if locked && self.parsed == self.length {
                let salt = open.salt;
                self.parse(salt, self.parsed - log_head::LENGTH, &bytes);
                self.parsed += bytes.len() as u64;
                self.length = self.parsed;
                return Ok(());
            }
            // Without the lock, the file may have been replaced between opening and writing it. The one that replaced
            // it may lack these entries.
            let written = open.metadata.clone();
            self.catch_up()?;
            if locked || self.open.as_ref().is_some_and(|open| same_file(&open.metadata, &written)) {
                return Ok(());
            }
        }
        let source = io::Error::other("it is replaced again and again");
        Err(Error::io("append to", &settings.path, source))
    }

    /// Removes an entry, for every process.
    pub fn remove(&mut self, kind: u8, key: &Digest) -> Result<()> {
        self.refresh()?;
        if !self.contains(kind, key)? {
            return Ok(());
        }
        self.append(&[(kind | REMOVED, *key, &[])])
    }

    /// Removes an entry that turned out damaged, for every process if possible and for this one in any case.
    pub fn drop_entry(&mut self, kind: u8, key: &Digest) {
        let _ = self.remove(kind, key);
        self.recent.insert((kind, *key), None);
    }

    /// Makes what was appended survive a loss of power.
    pub fn sync(&mut self) -> Result<()> {
        if let (true, Some(open), Some(settings)) = (self.unsynced, &self.open, &self.settings) {
            open.file.sync_data().at("sync", &settings.path)?;
            settings.path.parent().into_iter().for_each(sync_folder);
            self.unsynced = false;
        }
        Ok(())
    }

    /// Whether enough of the file is dead or damaged that it should be rewritten.
    pub fn wants_compaction(&self) -> bool {
        let LogSizes { live, dead, damaged } = self.sizes;
        damaged > 0 || (dead > live && dead > MIN_DEAD)
    }

    /// Rewrites the file with only those of its live entries that `keep` accepts. Other processes go on reading the old
    /// file until their next refresh, and append to the new one. Does nothing where locks do not work; returns whether
    /// the file was rewritten.
    pub fn compact(&mut self, keep: impl Fn(u8, &Digest) -> bool) -> Result<bool> {
        let Some(settings) = self.settings.clone().filter(|settings| settings.writable) else {
            return Ok(false);
        };
        let Some(_guard) = self.exclusive() else { return Ok(false) };
        self.catch_up()?;
        let Some(open) = &self.open else { return Ok(false) };
        let old_salt = open.salt;
        let old_length = self.length;
        let all = self.all()?.into_iter();
        let mut locations: Vec<Location> =
            all.filter(|((kind, key), _)| keep(*kind, key)).map(|(_, location)| location).collect();
        locations.sort_unstable_by_key(|location| location.offset);

        let salt = log_head::fresh_salt();
        let mut temp = TempFile::create(&settings.temp, &failpoint::LOG)?;
        let mut bytes = log_head::with(salt);
        for location in locations {
            let raw = self.read(location.offset, Entry::length(location.length as usize))?;
            // Verified again, so that an entry damaged since it was read does not get good checksums.
            if let Some(entry) = entry::decode(old_salt, raw) {
                entry.encode(salt, &mut bytes);
            }
            if bytes.len() as u64 > READ_BYTES {
                temp.write(&bytes)?;
                bytes.clear();
            }
        }
        temp.write(&bytes)?;
        // Another process has appended without the lock.
        let now = self.open.as_ref().and_then(|open| open.file.metadata().ok());
        if now.is_none_or(|now| now.len() != old_length) {
            return Ok(false);
        }
        // Always synced: the old file, which may be safely on the disk, is about to go.
        temp.sync()?;
        self.replace_file(&settings, temp, old_length)?;
        Ok(true)
    }

    /// Renames a compacted log over the file, and moves to it what was appended without the lock to the old file, of
    /// which `old_length` bytes were compacted.
    fn replace_file(&mut self, settings: &Settings, new: TempFile, old_length: u64) -> Result<()> {
        let Some(old) = self.open.take() else { return Ok(()) };
        new.persist(&settings.path)?;
        settings.path.parent().into_iter().for_each(sync_folder);
        // From here on, writers without the lock find out that the file was replaced.
        let mut late = Vec::new();
        let mut file = &old.file;
        file.seek(SeekFrom::Start(old_length)).at("read", &settings.path)?;
        file.read_to_end(&mut late).at("read", &settings.path)?;
        self.catch_up()?;
        let mut items: Vec<Item<'_>> = Vec::new();
        entry::scan(old.salt, &late, |_, entry| items.push((entry.kind, entry.key, entry.payload)));
        if items.is_empty() { Ok(()) } else { self.append_to_file(settings, &items, true) }
    }

    /// Rewrites the index if much of the log is not in it. A log without an index is read whole.
    pub fn save_index(&mut self) -> Result<()> {
        let (Some(settings), Some(open)) = (self.settings.clone(), &self.open) else { return Ok(()) };
        let salt = open.salt;
        let indexed = self.index.as_ref().map_or(0, |index| index.covered);
        if !settings.writable || self.parsed - indexed < MIN_UNINDEXED.max(self.parsed / 16) {
            return Ok(());
        }
        let all = self.all()?;
        let path = settings.index();
        Index::write(&path, &settings.temp, salt, self.parsed, self.sizes, &all)?;
        // Another process may have replaced it by an older one, which lacks recent entries.
        let index = Index::open(&path, salt, self.parsed).filter(|index| index.covered == self.parsed);
        if index.is_some() {
            (self.index, self.recent) = (index, HashMap::default());
        }
        Ok(())
    }

    fn exclusive(&mut self) -> Option<FileGuard> {
        let timeout = if self.lock_timed_out { Duration::ZERO } else { LOCK_TIMEOUT };
        let guard = self.lock.as_ref()?.exclusive(timeout);
        self.lock_timed_out = guard.is_none();
        guard
    }

    fn forget(&mut self) {
        *self = Log {
            settings: self.settings.take(),
            lock: self.lock.take(),
            lock_timed_out: self.lock_timed_out,
            index_rejected: self.index_rejected,
            unreported: self.unreported,
            ..Log::in_memory()
        };
    }

    /// Forgets everything and opens the file that is there now.
    fn reopen(&mut self) -> Result<()> {
        self.forget();
        let Some(settings) = &self.settings else { return Ok(()) };
        if regular::metadata(&settings.path).at("read", &settings.path)?.is_none() {
            return Ok(());
        }
        let mut file = match OpenOptions::new().read(true).append(settings.writable).open(&settings.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            result => result.at("open", &settings.path)?,
        };
        let metadata = file.metadata().at("read", &settings.path)?;
        let mut head = Vec::new();
        Read::by_ref(&mut file).take(log_head::LENGTH).read_to_end(&mut head).at("read", &settings.path)?;
        // Without its salt no entry can be verified; the next append moves the file to the quarantine.
        if let Some(salt) = log_head::salt(&head) {
            self.parsed = log_head::LENGTH;
            if !self.index_rejected
                && let Some(index) = Index::open(&settings.index(), salt, metadata.len())
            {
                (self.parsed, self.sizes) = (index.covered, index.sizes);
                self.index = Some(index);
            }
            self.open = Some(Open { file, metadata, salt });
        }
        Ok(())
    }

    /// Reads everything after the last entry that was read.
    fn read_tail(&mut self) -> Result<()> {
        let (Some(open), Some(settings)) = (&self.open, &self.settings) else { return Ok(()) };
        let (salt, path) = (open.salt, settings.path.clone());
        let mut file = open.file.try_clone().at("read", &path)?;
        file.seek(SeekFrom::Start(self.parsed)).at("read", &path)?;
        let mut window = Vec::new();
        loop {
            let read = Read::by_ref(&mut file).take(READ_BYTES).read_to_end(&mut window).at("read", &path)?;
            let end = self.parse(salt, self.parsed - log_head::LENGTH, &window);
            self.parsed += end as u64;
            window.drain(..end);
            if read == 0 {
                self.length = self.parsed + window.len() as u64;
                return Ok(());
            }
        }
    }

    /// Registers the entries in `bytes`, which start `base` bytes after the file's head. Returns the end of the last.
    fn parse(&mut self, salt: u32, base: u64, bytes: &[u8]) -> usize {
        let Log { index, recent, sizes, .. } = self;
        let scanned = entry::scan(salt, bytes, |at, entry| {
            let length = entry.payload.len() as u32;
            let size = Entry::length(entry.payload.len()) as u64;
            let id = (entry.kind & !REMOVED, entry.key);
            let location =
                (entry.kind & REMOVED == 0).then_some(Location { offset: base + at as u64, length });
            *if location.is_some() { &mut sizes.live } else { &mut sizes.dead } += size;
            let old = match recent.insert(id, location) {
                Some(known) => known,
                // A damaged page is detected when its entry is asked for; until then only these sums are wrong.
                None => index.as_mut().and_then(|index| index.find(&id).unwrap_or(None)),
            };
            if let Some(old) = old {
                let size = Entry::length(old.length as usize) as u64;
                sizes.live = sizes.live.saturating_sub(size);
                sizes.dead += size;
            }
        });
        self.sizes.dead += scanned.torn as u64;
        self.sizes.damaged += scanned.damaged as u64;
        self.unreported += scanned.damaged as u64;
        scanned.end
    }

    /// Bytes at an offset from the end of the file's head; fewer if the file is shorter.
    fn read(&mut self, offset: u64, length: usize) -> Result<&[u8]> {
        let (Some(open), Some(settings)) = (&self.open, &self.settings) else {
            return Ok(self.memory.get(offset as usize..offset as usize + length).unwrap_or_default());
        };
        // What follows may be an entry that is still being written.
        self.pages.read(&open.file, self.parsed, log_head::LENGTH + offset, length).at("read", &settings.path)
    }

    /// Creates the file if there is none with a good head.
    fn ensure_file(&mut self, settings: &Settings, locked: bool) -> Result<()> {
        if self.open.is_some() {
            return Ok(());
        }
        let mut temp = TempFile::create(&settings.temp, &failpoint::LOG)?;
        temp.write(&log_head::with(log_head::fresh_salt()))?;
        self.catch_up()?;
        if self.open.is_some() && !locked {
            return Ok(());
        }
        if settings.path.exists() {
            // Its head is damaged. Kept for inspection; if that fails, it is replaced.
            let name = format!("{:016x}.log", u64::from(log_head::fresh_salt()));
            let _ = fs::create_dir_all(&settings.quarantine);
            let _ = fs::rename(&settings.path, settings.quarantine.join(name));
        }
        temp.persist(&settings.path)?;
        self.catch_up()
    }
}

fn encode(items: &[Item<'_>], salt: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (kind, key, payload) in items {
        Entry { kind: *kind, key: *key, payload }.encode(salt, &mut bytes);
    }
    bytes
}

/// Appends in one call, so that even without a lock no other writer interferes; in two calls where a test may stop the
/// process in the middle.
fn write_halves(mut file: &File, bytes: &[u8]) -> io::Result<()> {
    reach(failpoint::APPEND_BEFORE)?;
    let (first, second) = bytes.split_at(if cfg!(feature = "failpoints") { bytes.len() / 2 } else { 0 });
    file.write_all(first)?;
    reach(failpoint::APPEND_MIDDLE)?;
    file.write_all(second)?;
    reach(failpoint::APPEND_AFTER)
}
