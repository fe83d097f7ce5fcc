//! Functions that write a [`Log`]: appending, compaction, and the index.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::time::Duration;

use super::{Item, Log, READ_BYTES, REMOVED, Settings};
use crate::digest::Digest;
use crate::entry::{self, Entry, MAX_PAYLOAD};
use crate::error::{At, Error, Result};
use crate::failpoint::{self, reach};
use crate::file_lock::FileGuard;
use crate::index::Index;
use crate::location::{Location, LogSizes};
use crate::log_head;
use crate::stamp::same_file;
use crate::temp::{TempFile, sync_folder};

/// Minimum number of dead bytes at which an undamaged log is compacted.
const MIN_DEAD: u64 = 1 << 20;

/// An index is rewritten when the part of the log that is not indexed has at least this many bytes, and is at least
/// a sixteenth of the log.
const MIN_UNINDEXED: u64 = 64 << 10;

/// Maximum time for which an append waits for the lock, so that a stopped process does not block other processes.
/// After a timeout, appends try to lock without waiting, until one of them obtains the lock.
///
/// Appending without the lock is safe: existing bytes of a log are never changed or cut off, and a writer without
/// the lock detects whether a compaction replaced the file in the meantime.
const LOCK_TIMEOUT: Duration = Duration::from_secs(2);

/// Maximum number of attempts to append entries. An attempt fails if a compaction replaces the file in the
/// meantime.
const APPEND_ATTEMPTS: usize = 5;

impl Log {
    /// Appends all items in a single write.
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

    /// Appends all items to the file. `locked` is true if the caller holds the lock.
    pub(super) fn append_to_file(
        &mut self,
        settings: &Settings,
        items: &[Item<'_>],
        locked: bool,
    ) -> Result<()> {
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
            // Without the lock, the file may have been replaced between opening and writing it. The new file may
            // lack these entries.
            let written = open.metadata.clone();
            self.catch_up()?;
            if locked || self.open.as_ref().is_some_and(|open| same_file(&open.metadata, &written)) {
                return Ok(());
            }
        }
        let source = io::Error::other("other processes repeatedly replaced the file");
        Err(Error::io("append to", &settings.path, source))
    }

    /// Removes an entry by appending a removal, which other processes read too.
    pub fn remove(&mut self, kind: u8, key: &Digest) -> Result<()> {
        self.refresh()?;
        if !self.contains(kind, key)? {
            return Ok(());
        }
        self.append(&[(kind | REMOVED, *key, &[])])
    }

    /// Removes an entry that was found to be damaged. If the removal cannot be written, the entry is removed only
    /// for this process.
    pub fn drop_entry(&mut self, kind: u8, key: &Digest) {
        let _ = self.remove(kind, key);
        self.recent.insert((kind, *key), None);
    }

    /// Syncs the file, so that appended entries survive a loss of power.
    pub fn sync(&mut self) -> Result<()> {
        if let (true, Some(open), Some(settings)) = (self.unsynced, &self.open, &self.settings) {
            open.file.sync_data().at("sync", &settings.path)?;
            settings.path.parent().into_iter().for_each(sync_folder);
            self.unsynced = false;
        }
        Ok(())
    }

    /// True if the file should be rewritten, because it contains damage or mostly dead entries.
    pub fn wants_compaction(&self) -> bool {
        let LogSizes { live, dead, damaged } = self.sizes;
        damaged > 0 || (dead > live && dead > MIN_DEAD)
    }

    /// Rewrites the file with only those live entries for which `keep` returns true. Returns whether the file was
    /// rewritten. Other processes read the old file until their next refresh, and append to the new file. Does
    /// nothing on file systems without locks.
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
        // If the length changed, another process has appended without the lock.
        let now = self.open.as_ref().and_then(|open| open.file.metadata().ok());
        if now.is_none_or(|now| now.len() != old_length) {
            return Ok(false);
        }
        // The new file is always synced, since the old one, which may already be safe on the disk, is about to be
        // replaced.
        temp.sync()?;
        self.replace_file(&settings, temp, old_length)?;
        Ok(true)
    }

    /// Renames a compacted log over the file. `old_length` is the number of bytes of the old file that were
    /// compacted. If other writers have appended more entries to the old file without the lock, these are copied to
    /// the new file.
    pub(super) fn replace_file(&mut self, settings: &Settings, new: TempFile, old_length: u64) -> Result<()> {
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

    /// Rewrites the index if much of the log is not indexed. Without an index, the whole log must be read when it
    /// is opened.
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
        // Another process may have replaced the index by an older one, which lacks recent entries.
        let index = Index::open(&path, salt, self.parsed).filter(|index| index.covered == self.parsed);
        if index.is_some() {
            (self.index, self.recent) = (index, HashMap::default());
        }
        Ok(())
    }

    pub(super) fn exclusive(&mut self) -> Option<FileGuard> {
        let timeout = if self.lock_timed_out { Duration::ZERO } else { LOCK_TIMEOUT };
        let guard = self.lock.as_ref()?.exclusive(timeout);
        self.lock_timed_out = guard.is_none();
        guard
    }

    /// Creates the file, unless there is a file with an undamaged head.
    pub(super) fn ensure_file(&mut self, settings: &Settings, locked: bool) -> Result<()> {
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
            // The head of this file is damaged. The file is kept for inspection; if that fails, it is replaced.
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

/// Appends `bytes` in a single call, so that no other writer can write in between, even without a lock. With the
/// feature `failpoints`, appends them in two calls, so that a test can stop the process between the halves.
fn write_halves(mut file: &File, bytes: &[u8]) -> io::Result<()> {
    reach(failpoint::APPEND_BEFORE)?;
    let (first, second) = bytes.split_at(if cfg!(feature = "failpoints") { bytes.len() / 2 } else { 0 });
    file.write_all(first)?;
    reach(failpoint::APPEND_MIDDLE)?;
    file.write_all(second)?;
    reach(failpoint::APPEND_AFTER)
}
