//! Garbage collection: what was used longest ago goes first, until the cache is small enough.
//!
//! A record stays or goes together with the blobs that it names; a blob goes with the last of its records. A
//! record was used when a graph that has it in its book last ran, or when a blob of its own was last read; one
//! that shares all its blobs, when one of them was.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::digest::Digest;
use crate::entry::Entry;
use crate::error::{At, Error, Result};
use crate::failpoint::{self, reach};
use crate::history::Book;
use crate::index;
use crate::log::Log;
use crate::store::{Store, kind, lock};

/// The book that says when each other one was last used: under its key, seconds since 1970, 8 bytes.
pub(crate) const USED: &str = "used";

/// A collection stops this far below the limit, so that the next run does not need another one.
const LOW_WATER: f64 = 0.9;

/// What a collection may remove.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits {
    /// The size in bytes that the cache shall not exceed.
    pub max_size: Option<u64>,
    /// How long a result is kept without being used.
    pub max_age: Option<Duration>,
    /// Only tell what would be removed.
    pub dry_run: bool,
}

/// What a collection removed, or would remove.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Collected {
    /// Records that went.
    pub records: usize,
    /// Blobs that went.
    pub blobs: usize,
    /// Bytes in the cache folder before.
    pub before: u64,
    /// Bytes in it afterwards; as far as can be told, where nothing was removed.
    pub after: u64,
    /// Records that had to go but are pinned.
    pub pinned: usize,
}

/// Reads which blobs the payload of a record names.
pub type Names<'a> = &'a dyn Fn(&[u8]) -> Vec<Digest>;

struct Unit {
    key: Digest,
    bytes: u64,
    blobs: Vec<Digest>,
    used: u64,
}

struct Found {
    bytes: u64,
    used: u64,
    /// How many records name it, and how many of those stay.
    named: usize,
    readers: usize,
}

impl Store {
    /// Removes what was used longest ago, and what nothing names. `names` tells which blobs a record names.
    ///
    /// While it works no run does, and while one works it waits for `patience` at most; so it never takes what
    /// a run needs. Pinned records stay whatever the limits say. A killed collection leaves nothing wrong.
    ///
    /// # Errors
    /// [`Error::InUse`] when a run went on for longer than `patience`, and what the system says.
    pub fn collect(&self, limits: &Limits, names: Names<'_>, patience: Duration) -> Result<Collected> {
        let Some(root) = self.folder().filter(|_| limits.dry_run || !self.is_read_only()) else {
            return Ok(Collected::default());
        };
        let _alone = if limits.dry_run { None } else { Some(self.alone(patience)?) };
        let pinned = self.pinned();
        let now = seconds(SystemTime::now());
        let mut blobs = self.found_blobs(root)?;
        let (mut units, notes) = self.units(names)?;
        for digest in units.iter().flat_map(|unit| &unit.blobs) {
            if let Some(found) = blobs.get_mut(digest) {
                found.named += 1;
                found.readers += 1;
            }
        }
        for unit in &mut units {
            let named = || unit.blobs.iter().filter_map(|digest| blobs.get(digest));
            let own = named().filter(|found| found.readers == 1).map(|found| found.used).max();
            let read = own.or_else(|| named().map(|found| found.used).max());
            unit.used = unit.used.max(read.unwrap_or(0));
        }
        units.sort_by_key(|unit| (unit.used, unit.key));
        let mut collected = Collected { before: size_of(root), ..Collected::default() };
        // What nothing names is of no use to anybody, and no run is at work that may be about to name it.
        let mut dead: BTreeSet<Digest> =
            blobs.iter().filter(|(_, found)| found.readers == 0).map(|(digest, _)| *digest).collect();
        let mut size = notes + units.iter().map(|unit| unit.bytes).sum::<u64>();
        size += blobs.values().filter(|found| found.readers > 0).map(|found| found.bytes).sum::<u64>();
        let goal = match limits.max_size {
            Some(most) if size > most => (most as f64 * LOW_WATER) as u64,
            _ => u64::MAX,
        };
        let oldest = limits.max_age.map_or(0, |age| now.saturating_sub(age.as_secs()));
        let mut gone = BTreeSet::new();
        for unit in &units {
            if size <= goal && unit.used >= oldest {
                break;
            }
            if pinned.contains(&unit.key) {
                collected.pinned += 1;
                continue;
            }
            gone.insert(unit.key);
            size -= unit.bytes;
            for digest in &unit.blobs {
                let Some(found) = blobs.get_mut(digest) else { continue };
                found.readers -= 1;
                if found.readers == 0 {
                    size -= found.bytes;
                    dead.insert(*digest);
                }
            }
        }
        // Memos and books go only where nothing else is left to go.
        let most = limits.max_size.unwrap_or(u64::MAX);
        let notes_too = size > most;
        if notes_too {
            size -= notes;
        }
        (collected.records, collected.blobs) = (gone.len(), dead.len());
        collected.after = size.min(collected.before);
        if limits.dry_run {
            return Ok(collected);
        }
        self.forget_last_runs();
        // On a full disk the log that is left needs room, so what no record names goes before it is written.
        let unnamed = blobs.iter().filter(|(_, found)| found.named == 0).map(|(digest, _)| *digest);
        self.blobs().remove_files(&unnamed.collect())?;
        self.sweep();
        let _ = fs::remove_dir_all(root.join("quarantine"));
        // Records first: a killed collection leaves blobs that nothing names, and never the reverse.
        let kept = |found: u8, key: &Digest| match found {
            kind::RECORD => !gone.contains(key),
            _ => !notes_too,
        };
        // Somebody may append without being at work, such as a memo.
        let compact = || -> Result<bool> {
            let done = lock(self.records()).compact(kept)?;
            if done { Ok(true) } else { lock(self.records()).compact(kept) }
        };
        let compacted = match compact() {
            // Then the other way round: killed in between, records name blobs that are gone, which is a miss.
            Err(Error::Full { .. }) => {
                self.blobs().remove_files(&dead)?;
                compact()
            }
            result => result,
        };
        if !compacted? {
            return Err(Error::InUse { waited: patience });
        }
        reach(failpoint::GC_RECORDS_GONE).at("collect", root)?;
        self.blobs().remove(&dead)?;
        lock(self.records()).save_index()?;
        collected.after = size_of(root);
        Ok(collected)
    }

    /// Every record with what it names and when books say it was used, and the bytes of all else in the log.
    fn units(&self, names: Names<'_>) -> Result<(Vec<Unit>, u64)> {
        let mut records = lock(self.records());
        records.refresh()?;
        let used = last_used(&mut records)?;
        let mut units = Vec::new();
        for key in records.keys(kind::RECORD)? {
            let Some(payload) = records.get(kind::RECORD, &key)? else { continue };
            let mut named = names(&payload);
            named.sort_unstable();
            named.dedup();
            let used = used.get(&key).copied().unwrap_or(0);
            units.push(Unit { key, bytes: stored_size(payload.len() as u64), blobs: named, used });
        }
        let mut notes = 0;
        for kind in [kind::MEMO, kind::HISTORY] {
            notes += records.lengths(kind)?.into_iter().map(|(_, length)| stored_size(length)).sum::<u64>();
        }
        Ok((units, notes))
    }

    fn found_blobs(&self, root: &Path) -> Result<BTreeMap<Digest, Found>> {
        let small = self.blobs().small_sizes()?.into_iter();
        let small = small.map(|(digest, bytes)| (digest, stored_size(bytes), 0));
        let large = blob_files(root)
            .into_iter()
            .map(|(digest, meta)| (digest, meta.len(), meta.modified().map_or(0, seconds)));
        Ok(small
            .chain(large)
            .map(|(digest, bytes, used)| (digest, Found { bytes, used, named: 0, readers: 0 }))
            .collect())
    }
}

/// What an entry takes in a log and its index.
fn stored_size(payload: u64) -> u64 {
    Entry::length(0) as u64 + payload + index::ENTRY as u64
}

/// When each key in a book was used last.
fn last_used(records: &mut Log) -> Result<BTreeMap<Digest, u64>> {
    let mut used = BTreeMap::new();
    let times = Book::open(records.get(kind::HISTORY, &Book::key(USED))?.unwrap_or_default());
    for key in records.keys(kind::HISTORY)? {
        let Some(bytes) = records.get(kind::HISTORY, &key)? else { continue };
        let time = times.get(&key.to_string()).and_then(|time| time.first_chunk());
        let time = time.map_or(0, |time| u64::from_le_bytes(*time));
        for (_, value) in Book::open(bytes).notes() {
            for key in value.as_chunks::<32>().0 {
                let known = used.entry(Digest::from_bytes(*key)).or_insert(0);
                *known = time.max(*known);
            }
        }
    }
    Ok(used)
}

/// Every blob that is a file of its own.
pub(crate) fn blob_files(root: &Path) -> Vec<(Digest, fs::Metadata)> {
    let folders = fs::read_dir(root.join("blobs")).into_iter().flatten().flatten();
    let files = folders.flat_map(|folder| fs::read_dir(folder.path()).into_iter().flatten().flatten());
    let blob = |file: fs::DirEntry| {
        let digest = Digest::from_hex(file.file_name().to_str()?)?;
        Some((digest, file.metadata().ok().filter(fs::Metadata::is_file)?))
    };
    let mut found: Vec<_> = files.filter_map(blob).collect();
    found.sort_unstable_by_key(|(digest, _)| *digest);
    found
}

/// The bytes of every file below a folder.
pub(crate) fn size_of(folder: &Path) -> u64 {
    let mut folders = vec![folder.to_path_buf()];
    let mut size = 0;
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            match entry.metadata() {
                Ok(meta) if meta.is_dir() => folders.push(entry.path()),
                Ok(meta) => size += meta.len(),
                Err(_) => {}
            }
        }
    }
    size
}

/// Since 1970; 0 before. A time to come is no reason to keep something longer than what is used now.
pub(crate) fn seconds(time: SystemTime) -> u64 {
    let now = SystemTime::now();
    time.min(now).duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

impl Store {
    /// Waits until no run is at work, and keeps others from beginning one.
    fn alone(&self, patience: Duration) -> Result<crate::file_lock::FileGuard> {
        let alone = self.runs()?.and_then(|runs| runs.exclusive(patience));
        alone.ok_or(Error::InUse { waited: patience })
    }
}
