//! [`Log`]: an append-only file of small checksummed entries, shared by threads and processes.

use std::collections::HashMap;
use std::fs::{self, File, Metadata, OpenOptions};
use std::hash::BuildHasherDefault;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::digest::Digest;
use crate::entry::{self, Entry, MAX_PAYLOAD};
use crate::error::{At, Error, Result};
use crate::failpoint::{self, reach};
use crate::file_lock::{FileGuard, FileLock};
use crate::fold::Fold;
use crate::index::{Damaged, Index};
use crate::log_head;
use crate::slot::{Health, Place, Slot};
use crate::stamp::same_file;
use crate::temp::{TempFile, sync_folder};
use crate::window::Window;

/// An entry of this kind plus another's removes the other.
const REMOVED: u8 = 0x80;

/// How much is read at once.
const WINDOW: u64 = 1 << 20;

/// Compaction leaves logs with less dead weight than this alone, in bytes.
const DEAD_ENOUGH: u64 = 1 << 20;

/// An index is renewed when at least this much of the log is not in it, in bytes, and a sixteenth of all.
const UNINDEXED_ENOUGH: u64 = 64 << 10;

/// How long an append waits for another process, once. A stopped one must not stop us: appending without the
/// lock is safe but for the last instant of a compaction, which would cost us the entry.
const PATIENCE: Duration = Duration::from_secs(2);

/// Where a log lives and how it is treated.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub path: PathBuf,
    /// Locked while the log is written; never replaced, unlike the log.
    pub lock: PathBuf,
    pub temp: PathBuf,
    pub quarantine: PathBuf,
    pub writable: bool,
    /// Sync after every append.
    pub sync: bool,
}

/// The last entry of each kind and key in a file, or in memory only.
#[derive(Debug)]
pub(crate) struct Log {
    settings: Option<Arc<Settings>>,
    open: Option<Open>,
    lock: Option<FileLock>,
    /// The index of the first part of the file, and whether it turned out wrong.
    index: Option<Index>,
    distrusted: bool,
    /// The entries after that part; `None` where one was removed.
    recent: HashMap<Place, Option<Slot>, BuildHasherDefault<Fold>>,
    /// All bytes of a log without a file.
    memory: Vec<u8>,
    window: Window,
    /// How far the file is understood, and how long it was when last looked at.
    scanned: u64,
    seen: u64,
    health: Health,
    /// Damaged bytes that were not told of yet.
    news: u64,
    unsynced: bool,
    /// The last wait for the lock was in vain; the next one is not repeated.
    impatient: bool,
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
    /// A log without a file.
    pub fn in_memory() -> Log {
        Log {
            settings: None,
            open: None,
            lock: None,
            index: None,
            distrusted: false,
            recent: HashMap::default(),
            memory: Vec::new(),
            window: Window::default(),
            scanned: 0,
            seen: 0,
            health: Health::default(),
            news: 0,
            unsynced: false,
            impatient: false,
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

    /// Whether the entry is there, as far as this process has read.
    pub fn contains(&mut self, kind: u8, key: &Digest) -> Result<bool> {
        Ok(self.find(&(kind, *key))?.is_some())
    }

    /// The payload of the entry, as far as this process has read: checked, whenever it was written.
    pub fn get(&mut self, kind: u8, key: &Digest) -> Result<Option<Vec<u8>>> {
        let place = (kind, *key);
        for _ in 0..2 {
            let Some(slot) = self.find(&place)? else { return Ok(None) };
            let salt = self.open.as_ref().map_or(0, |open| open.salt);
            let raw = self.read(slot.offset, Entry::length(slot.length as usize))?;
            if let Some(entry) = entry::decode(salt, raw)
                && (entry.kind, entry.key) == place
            {
                return Ok(Some(entry.payload.to_vec()));
            }
            // It went bad since it was indexed. Reading everything shows what else did.
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
    fn all(&mut self) -> Result<Vec<(Place, Slot)>> {
        let mut all = match self.index.as_mut().map(Index::all) {
            None => Vec::new(),
            Some(Ok(all)) => all,
            Some(Err(Damaged)) => {
                self.rescan()?;
                Vec::new()
            }
        };
        all.retain(|(place, _)| !self.recent.contains_key(place));
        #[allow(clippy::iter_over_hash_type, reason = "sorted below")]
        all.extend(self.recent.iter().filter_map(|(place, slot)| Some((*place, (*slot)?))));
        all.sort_unstable_by_key(|((kind, key), _)| (*key, *kind));
        Ok(all)
    }

    fn find(&mut self, place: &Place) -> Result<Option<Slot>> {
        if let Some(known) = self.recent.get(place) {
            return Ok(*known);
        }
        match self.index.as_mut().map(|index| index.find(place)) {
            None => Ok(None),
            Some(Ok(slot)) => Ok(slot),
            Some(Err(Damaged)) => {
                self.rescan()?;
                Ok(self.recent.get(place).copied().flatten())
            }
        }
    }

    /// Forgets the index and reads the whole log.
    fn rescan(&mut self) -> Result<()> {
        self.distrusted = true;
        self.reopen()?;
        self.read_tail()
    }

    /// Reads the whole file once more, whatever the index says, and gives its damaged bytes: what a writer may
    /// be writing is none.
    pub fn reread(&mut self) -> Result<u64> {
        self.rescan()?;
        Ok(self.health.damaged)
    }

    /// Bytes of entries that were replaced or removed.
    pub fn dead(&self) -> u64 {
        self.health.dead
    }

    /// The length of the payload of every entry of a kind, by key.
    pub fn lengths(&mut self, kind: u8) -> Result<Vec<(Digest, u64)>> {
        let all = self.all()?.into_iter().filter(|((found, _), _)| *found == kind);
        Ok(all.map(|((_, key), slot)| (key, slot.length.into())).collect())
    }

    /// How many damaged bytes were found since the last call.
    pub fn take_damaged(&mut self) -> u64 {
        std::mem::take(&mut self.news)
    }

    /// Reads what other processes appended since the last look; says whether there was something to read.
    pub fn refresh(&mut self) -> Result<bool> {
        if self.is_current()? {
            return Ok(false);
        }
        // So that no entry is seen half written; where there is no lock, the checksums see to that.
        let _shared = self.lock.as_ref().and_then(FileLock::shared);
        self.catch_up()?;
        Ok(true)
    }

    /// Whether the file is the one known, and no longer than known.
    fn is_current(&self) -> Result<bool> {
        let (Some(settings), Some(open)) = (&self.settings, &self.open) else {
            return Ok(self.settings.is_none());
        };
        match fs::metadata(&settings.path) {
            Ok(metadata) => {
                // A tail that is not understood yet may be replaced by one of the same length.
                let understood = self.scanned == self.seen && metadata.len() == self.seen;
                Ok(understood && same_file(&open.metadata, &metadata))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(Error::io("read", &settings.path, error)),
        }
    }

    /// `refresh` for those who hold the lock: taking it twice would give it up.
    fn catch_up(&mut self) -> Result<()> {
        let Some(settings) = self.settings.clone() else { return Ok(()) };
        let metadata = match fs::metadata(&settings.path) {
            Ok(metadata) => metadata,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                self.forget();
                return Ok(());
            }
            Err(error) => return Err(Error::io("read", &settings.path, error)),
        };
        let known = self.open.as_ref().is_some_and(|open| same_file(&open.metadata, &metadata));
        if !known || metadata.len() < self.scanned {
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
            self.take_in(0, self.memory.len() as u64, &bytes);
            self.memory.extend_from_slice(&bytes);
            return Ok(());
        };
        if !settings.writable || items.is_empty() {
            return Ok(());
        }
        let guard = self.exclusive();
        self.catch_up()?;
        self.ensure_file(&settings, guard.is_some())?;
        let Some(open) = &self.open else { return Ok(()) };
        let bytes = encode(items, open.salt);
        if guard.is_some() && self.scanned < self.seen {
            // What a killed writer left. Best effort: if it stays, readers step over it.
            let _ = open.file.set_len(self.scanned);
            self.seen = open.file.metadata().at("read", &settings.path)?.len();
        }
        // On an error half an entry may be left: the next append cuts it off.
        write_halves(&open.file, &bytes).at("append to", &settings.path)?;
        if settings.sync {
            open.file.sync_data().at("sync", &settings.path)?;
        }
        self.unsynced = true;
        if guard.is_none() || self.scanned != self.seen {
            return self.catch_up();
        }
        let salt = open.salt;
        self.take_in(salt, self.scanned - log_head::LENGTH, &bytes);
        self.scanned += bytes.len() as u64;
        self.seen = self.scanned;
        Ok(())
    }

    /// Removes an entry, for every process.
    pub fn remove(&mut self, kind: u8, key: &Digest) -> Result<()> {
        self.refresh()?;
        if !self.contains(kind, key)? {
            return Ok(());
        }
        self.append(&[(kind | REMOVED, *key, &[])])
    }

    /// Forgets an entry that turned out bad, for every process if possible and for this one in any case.
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

    /// Whether so much of the file is dead or damaged that rewriting it pays.
    pub fn wants_compaction(&self) -> bool {
        let Health { live, dead, damaged } = self.health;
        damaged > 0 || (dead > live && dead > DEAD_ENOUGH)
    }

    /// Rewrites the file with only its live entries that `keep` wants. Other processes go on reading the old
    /// file until they look again, and append to the new one. Does nothing where locks do not work; says
    /// whether it did something.
    pub fn compact(&mut self, keep: impl Fn(u8, &Digest) -> bool) -> Result<bool> {
        let Some(settings) = self.settings.clone().filter(|settings| settings.writable) else {
            return Ok(false);
        };
        let Some(_guard) = self.exclusive() else { return Ok(false) };
        self.catch_up()?;
        let Some(open) = &self.open else { return Ok(false) };
        let old_salt = open.salt;
        let old_length = self.seen;
        let all = self.all()?.into_iter();
        let mut slots: Vec<Slot> =
            all.filter(|((kind, key), _)| keep(*kind, key)).map(|(_, slot)| slot).collect();
        slots.sort_unstable_by_key(|slot| slot.offset);

        let salt = log_head::fresh_salt();
        let mut temp = TempFile::create(&settings.temp, &failpoint::LOG)?;
        let mut bytes = log_head::with(salt);
        for slot in slots {
            let raw = self.read(slot.offset, Entry::length(slot.length as usize))?;
            // Checked once more: what went bad since it was read is left behind, not signed anew.
            if let Some(entry) = entry::decode(old_salt, raw) {
                entry.encode(salt, &mut bytes);
            }
            if bytes.len() as u64 > WINDOW {
                temp.write(&bytes)?;
                bytes.clear();
            }
        }
        temp.write(&bytes)?;
        // Somebody was too impatient for the lock.
        let now = self.open.as_ref().and_then(|open| open.file.metadata().ok());
        if now.is_none_or(|now| now.len() != old_length) {
            return Ok(false);
        }
        // Always: the old file is about to go, and with it all that was safe.
        temp.sync()?;
        temp.persist(&settings.path)?;
        settings.path.parent().into_iter().for_each(sync_folder);
        self.catch_up()?;
        Ok(true)
    }

    /// Writes the index anew where much of the log is not in it. A log whose index is lost is read whole.
    pub fn save_index(&mut self) -> Result<()> {
        let (Some(settings), Some(open)) = (self.settings.clone(), &self.open) else { return Ok(()) };
        let salt = open.salt;
        let indexed = self.index.as_ref().map_or(0, |index| index.covered);
        if !settings.writable || self.scanned - indexed < UNINDEXED_ENOUGH.max(self.scanned / 16) {
            return Ok(());
        }
        let all = self.all()?;
        let path = settings.index();
        Index::write(&path, &settings.temp, salt, self.scanned, self.health, &all)?;
        // Another process may have put an older one in its place already, which leaves recent entries out.
        let index = Index::open(&path, salt, self.scanned).filter(|index| index.covered == self.scanned);
        if index.is_some() {
            (self.index, self.recent) = (index, HashMap::default());
        }
        Ok(())
    }

    fn exclusive(&mut self) -> Option<FileGuard> {
        let patience = if self.impatient { Duration::ZERO } else { PATIENCE };
        let guard = self.lock.as_ref()?.exclusive(patience);
        self.impatient = guard.is_none();
        guard
    }

    fn forget(&mut self) {
        *self = Log {
            settings: self.settings.take(),
            lock: self.lock.take(),
            impatient: self.impatient,
            distrusted: self.distrusted,
            news: self.news,
            ..Log::in_memory()
        };
    }

    /// Opens whatever file is there now and starts over.
    fn reopen(&mut self) -> Result<()> {
        self.forget();
        let Some(settings) = &self.settings else { return Ok(()) };
        let mut file = match OpenOptions::new().read(true).append(settings.writable).open(&settings.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            result => result.at("open", &settings.path)?,
        };
        let metadata = file.metadata().at("read", &settings.path)?;
        let mut head = Vec::new();
        Read::by_ref(&mut file).take(log_head::LENGTH).read_to_end(&mut head).at("read", &settings.path)?;
        // Without its salt nothing in the file can be believed; the next append puts it aside.
        if let Some(salt) = log_head::salt(&head) {
            self.scanned = log_head::LENGTH;
            if !self.distrusted
                && let Some(index) = Index::open(&settings.index(), salt, metadata.len())
            {
                (self.scanned, self.health) = (index.covered, index.health);
                self.index = Some(index);
            }
            self.open = Some(Open { file, metadata, salt });
        }
        Ok(())
    }

    /// Takes in everything after what is understood.
    fn read_tail(&mut self) -> Result<()> {
        let (Some(open), Some(settings)) = (&self.open, &self.settings) else { return Ok(()) };
        let (salt, path) = (open.salt, settings.path.clone());
        let mut file = open.file.try_clone().at("read", &path)?;
        file.seek(SeekFrom::Start(self.scanned)).at("read", &path)?;
        let mut window = Vec::new();
        loop {
            let read = Read::by_ref(&mut file).take(WINDOW).read_to_end(&mut window).at("read", &path)?;
            let end = self.take_in(salt, self.scanned - log_head::LENGTH, &window);
            self.scanned += end as u64;
            window.drain(..end);
            if read == 0 {
                self.seen = self.scanned + window.len() as u64;
                return Ok(());
            }
        }
    }

    /// Indexes the entries in `bytes`, which lie `base` bytes after the file's head.
    fn take_in(&mut self, salt: u32, base: u64, bytes: &[u8]) -> usize {
        let Log { index, recent, health, .. } = self;
        let scanned = entry::scan(salt, bytes, |at, entry| {
            let length = entry.payload.len() as u32;
            let size = Entry::length(entry.payload.len()) as u64;
            let place = (entry.kind & !REMOVED, entry.key);
            let slot = (entry.kind & REMOVED == 0).then_some(Slot { offset: base + at as u64, length });
            *if slot.is_some() { &mut health.live } else { &mut health.dead } += size;
            let old = match recent.insert(place, slot) {
                Some(known) => known,
                // A damaged page shows when its entry is asked for, and until then only these sums are wrong.
                None => index.as_mut().and_then(|index| index.find(&place).unwrap_or(None)),
            };
            if let Some(old) = old {
                let size = Entry::length(old.length as usize) as u64;
                health.live = health.live.saturating_sub(size);
                health.dead += size;
            }
        });
        self.health.damaged += scanned.damaged as u64;
        self.news += scanned.damaged as u64;
        scanned.end
    }

    /// Bytes at an offset from the end of the file's head; fewer if the file was cut meanwhile.
    fn read(&mut self, offset: u64, length: usize) -> Result<&[u8]> {
        let (Some(open), Some(settings)) = (&self.open, &self.settings) else {
            return Ok(self.memory.get(offset as usize..offset as usize + length).unwrap_or_default());
        };
        // What lies behind may be half an entry, which the next append cuts off.
        self.window
            .read(&open.file, self.scanned, log_head::LENGTH + offset, length)
            .at("read", &settings.path)
    }

    /// Makes sure that there is a file to append to. Called under the lock.
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
            // Its head is gone. Kept for whoever wants to know why; if that fails, it is replaced.
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

/// Appends in one call, so that even without a lock no other writer comes between; in two where a test may
/// stop us in the middle.
fn write_halves(mut file: &File, bytes: &[u8]) -> io::Result<()> {
    reach(failpoint::APPEND_BEFORE)?;
    let (first, second) = bytes.split_at(if cfg!(feature = "failpoints") { bytes.len() / 2 } else { 0 });
    file.write_all(first)?;
    reach(failpoint::APPEND_MIDDLE)?;
    file.write_all(second)?;
    reach(failpoint::APPEND_AFTER)
}
