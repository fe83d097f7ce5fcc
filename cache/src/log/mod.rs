//! [`Log`]: an append-only file of small checksummed entries, shared by threads and processes.

use std::collections::HashMap;
use std::fs::{self, File, Metadata, OpenOptions};
use std::hash::BuildHasherDefault;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::PathBuf;
use std::sync::Arc;

use crate::digest::Digest;
use crate::digest_hasher::DigestHasher;
use crate::entry::{self, Entry};
use crate::error::{At, Result};
use crate::file_lock::FileLock;
use crate::index::{Damaged, Index};
use crate::location::{EntryId, Location, LogSizes};
use crate::log_head;
use crate::page_cache::PageCache;
use crate::regular;
use crate::stamp::same_file;

mod write;

#[cfg(test)]
mod tests;

/// Flag in the kind of an entry. An entry with this flag removes the previous entry of the same kind and key.
const REMOVED: u8 = 0x80;

/// Number of bytes that are read at a time.
const READ_BYTES: u64 = 1 << 20;

/// Settings of a log: its files and how they are written.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub path: PathBuf,
    /// The file that is locked while the log is written. Unlike the log it is never replaced.
    pub lock: PathBuf,
    pub temp: PathBuf,
    pub quarantine: PathBuf,
    pub writable: bool,
    /// True if the log is synced after every append.
    pub sync: bool,
}

/// A log, either in a file or only in memory. For each kind and key, only the last entry is valid.
#[derive(Debug)]
pub(crate) struct Log {
    settings: Option<Arc<Settings>>,
    open: Option<Open>,
    lock: Option<FileLock>,
    /// The index of the first part of the file; `None` if no part is indexed.
    index: Option<Index>,
    /// True if an index was found to be wrong. From then on, no index is read.
    index_rejected: bool,
    /// The locations of the entries that follow the indexed part of the file; `None` for a removed entry.
    recent: HashMap<EntryId, Option<Location>, BuildHasherDefault<DigestHasher>>,
    /// All entries, encoded, if the log has no file.
    memory: Vec<u8>,
    pages: PageCache,
    /// Offset in the file of the end of the last entry that was read.
    parsed: u64,
    /// The length of the file when it was last read.
    length: u64,
    sizes: LogSizes,
    /// Number of damaged bytes that have not been reported.
    unreported: u64,
    unsynced: bool,
    /// True if the last request for the lock timed out. The next request then does not wait.
    lock_timed_out: bool,
}

#[derive(Debug)]
struct Open {
    file: File,
    metadata: Metadata,
    salt: u32,
}

/// An entry to append: kind, key and payload.
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

    /// Opens the log and reads its index. Creates a missing log unless `settings.writable` is false.
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

    /// True if this process has read an entry of this kind and key that is still valid. Entries that other
    /// processes appended since the last refresh are not found.
    pub fn contains(&mut self, kind: u8, key: &Digest) -> Result<bool> {
        Ok(self.find(&(kind, *key))?.is_some())
    }

    /// The payload of the entry of this kind and key. Its checksums are verified by every call. Entries that other
    /// processes appended since the last refresh are not found.
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
            // The entry was damaged after it was indexed. Reading the whole log shows what else is damaged.
            self.rescan()?;
        }
        self.drop_entry(kind, key);
        Ok(None)
    }

    /// The keys of all entries of a kind, sorted.
    pub fn keys(&mut self, kind: u8) -> Result<Vec<Digest>> {
        let all = self.all()?.into_iter();
        Ok(all.filter(|((found, _), _)| *found == kind).map(|((_, key), _)| key).collect())
    }

    /// The identity and location of every valid entry, sorted by key and then by kind.
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

    /// Discards the index and reads the whole log.
    fn rescan(&mut self) -> Result<()> {
        self.index_rejected = true;
        self.reopen()?;
        self.read_tail()
    }

    /// Reads the whole file again without the index and returns the number of damaged bytes. Bytes at the end that
    /// may belong to an entry still being written are not counted.
    pub fn reread(&mut self) -> Result<u64> {
        self.rescan()?;
        Ok(self.sizes.damaged)
    }

    /// The total size in bytes of the entries that were replaced or removed, or are incomplete.
    pub fn dead(&self) -> u64 {
        self.sizes.dead
    }

    /// The key of every entry of a kind, and the length of its payload.
    pub fn lengths(&mut self, kind: u8) -> Result<Vec<(Digest, u64)>> {
        let all = self.all()?.into_iter().filter(|((found, _), _)| *found == kind);
        Ok(all.map(|((_, key), location)| (key, location.length.into())).collect())
    }

    /// The number of damaged bytes found since the last call.
    pub fn take_damaged(&mut self) -> u64 {
        std::mem::take(&mut self.unreported)
    }

    /// Reads what other processes have appended since the last call. Returns true if there were new bytes.
    pub fn refresh(&mut self) -> Result<bool> {
        if self.is_current()? {
            return Ok(false);
        }
        // Prevents reading half an entry; without the lock, the checksums prevent it.
        let _shared = self.lock.as_ref().and_then(FileLock::shared);
        self.catch_up()?;
        Ok(true)
    }

    /// True if the file at the log's path is still the file that was read, and all its bytes have been read.
    fn is_current(&self) -> Result<bool> {
        let (Some(settings), Some(open)) = (&self.settings, &self.open) else {
            return Ok(self.settings.is_none());
        };
        let Some(metadata) = regular::metadata(&settings.path).at("read", &settings.path)? else {
            return Ok(false);
        };
        // The bytes after the last complete entry may have become another complete entry by now.
        let complete = self.parsed == self.length && metadata.len() == self.length;
        Ok(complete && same_file(&open.metadata, &metadata))
    }

    /// Like [`refresh`](Self::refresh), but does not lock the file. Callers that hold the lock must use this
    /// function, since the lock must not be taken twice.
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

    /// Discards everything that was read and opens the file that is now at the path of the log.
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
            let path = settings.index();
            let index = if self.index_rejected { None } else { Index::open(&path, salt, metadata.len()) };
            if let Some(index) = index {
                (self.parsed, self.sizes) = (index.covered, index.sizes);
                self.index = Some(index);
            } else if settings.writable
                && file.metadata().is_ok_and(|now| Index::is_beyond(&path, salt, now.len()))
            {
                let _ = fs::remove_file(&path);
            }
            self.open = Some(Open { file, metadata, salt });
        }
        Ok(())
    }

    /// Reads all bytes of the file after the last known entry.
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

    /// Registers the entries in `bytes`. `base` is the distance in bytes from the end of the file's head to the
    /// start of `bytes`. Returns the offset in `bytes` at which the last entry ends.
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
                // A damaged page is detected when its entry is requested. Until then, only these sums are wrong.
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

    /// Reads `length` bytes at `offset`, which is counted from the end of the file's head. Returns fewer bytes if
    /// the file is shorter.
    fn read(&mut self, offset: u64, length: usize) -> Result<&[u8]> {
        let (Some(open), Some(settings)) = (&self.open, &self.settings) else {
            return Ok(self.memory.get(offset as usize..offset as usize + length).unwrap_or_default());
        };
        // Bytes after `parsed` may belong to an entry that is still being written.
        self.pages.read(&open.file, self.parsed, log_head::LENGTH + offset, length).at("read", &settings.path)
    }
}
