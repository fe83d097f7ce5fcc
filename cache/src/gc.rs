//! Garbage collection: the least recently used results are removed first, until the cache is small enough.
//!
//! A record is kept or removed together with the blobs that it names. A blob that several records name is removed
//! with the last of these records. Two events count as a use of a record: a run of a graph whose history table
//! lists the record, and a read of a blob that no other record names. If all blobs of a record are also named by
//! other records, a read of any of them counts. Reads of small blobs are not recorded.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime};

use crate::digest::Digest;
use crate::entry::Entry;
use crate::error::{At, Error, Result};
use crate::failpoint::{self, reach};
use crate::history::{Table, USED, seconds};
use crate::index;
use crate::log::Log;
use crate::obstacle::QUARANTINE;
use crate::settings::{kind, lock};
use crate::store::Store;

/// If the cache exceeds its maximum size, a collection reduces it to this fraction of the maximum, so that the next
/// run does not require another collection.
const LOW_WATER: f64 = 0.9;

/// Limits of a collection.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits {
    /// The maximum size of the cache in bytes; `None` for no limit.
    pub max_size: Option<u64>,
    /// The maximum time since the last use of a result; `None` for no limit.
    pub max_age: Option<Duration>,
    /// True to remove nothing and only report what would be removed.
    pub dry_run: bool,
}

/// The result of a collection, or of a dry run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Collected {
    /// The number of records removed.
    pub records: usize,
    /// The number of blobs removed.
    pub blobs: usize,
    /// The size of the cache folder before the collection, in bytes.
    pub before: u64,
    /// The size of the cache folder after the collection, in bytes. For a dry run, this is an estimate.
    pub after: u64,
    /// The number of records that would have been removed if they were not pinned.
    pub pinned: usize,
}

/// Function that returns the digests of the blobs that the payload of a record names.
pub type Names<'a> = &'a dyn Fn(&[u8]) -> Vec<Digest>;

/// A record that may be removed.
struct Candidate {
    key: Digest,
    /// Stored size of the record in bytes.
    bytes: u64,
    blobs: Vec<Digest>,
    /// Time of the last use, in seconds since 1970.
    used: u64,
}

/// A stored blob.
struct BlobUse {
    /// Stored size in bytes.
    bytes: u64,
    /// Time of the last use, in seconds since 1970.
    used: u64,
    /// Number of records that name the blob.
    named: usize,
    /// Number of records that name the blob and are kept.
    readers: usize,
}

impl Store {
    /// Removes the least recently used results until the limits are met, and all blobs that no record names.
    /// `names` returns the digests of the blobs that a record names.
    ///
    /// No run can be active during a collection, so nothing that a run needs is removed. A collection waits for
    /// active runs to end, for at most `timeout`. Pinned records are kept even if the limits are exceeded. The
    /// cache stays valid if a collection is killed.
    ///
    /// # Errors
    /// [`Error::InUse`] if a run is still active after `timeout`, and errors of the operating system.
    pub fn collect(&self, limits: &Limits, names: Names<'_>, timeout: Duration) -> Result<Collected> {
        let Some(root) = self.folder().filter(|_| limits.dry_run || !self.is_read_only()) else {
            return Ok(Collected::default());
        };
        let _alone = if limits.dry_run { None } else { Some(self.exclusive(timeout)?) };
        let pinned = self.pinned();
        let now = seconds(SystemTime::now());
        let mut blobs = self.found_blobs(root)?;
        let (mut candidates, notes) = self.candidates(names)?;
        for digest in candidates.iter().flat_map(|candidate| &candidate.blobs) {
            if let Some(found) = blobs.get_mut(digest) {
                found.named += 1;
                found.readers += 1;
            }
        }
        for candidate in &mut candidates {
            let named = || candidate.blobs.iter().filter_map(|digest| blobs.get(digest));
            let own = named().filter(|found| found.readers == 1).map(|found| found.used).max();
            let read = own.or_else(|| named().map(|found| found.used).max());
            candidate.used = candidate.used.max(read.unwrap_or(0));
        }
        candidates.sort_by_key(|candidate| (candidate.used, candidate.key));
        let mut collected = Collected { before: size_of(root), ..Collected::default() };
        // Blobs that no record names are useless: no run is active that could still name them.
        let mut dead: BTreeSet<Digest> =
            blobs.iter().filter(|(_, found)| found.readers == 0).map(|(digest, _)| *digest).collect();
        let mut size = notes + candidates.iter().map(|candidate| candidate.bytes).sum::<u64>();
        size += blobs.values().filter(|found| found.readers > 0).map(|found| found.bytes).sum::<u64>();
        let goal = match limits.max_size {
            Some(most) if size > most => (most as f64 * LOW_WATER) as u64,
            _ => u64::MAX,
        };
        let oldest = limits.max_age.map_or(0, |age| now.saturating_sub(age.as_secs()));
        let mut gone = BTreeSet::new();
        for candidate in &candidates {
            if size <= goal && candidate.used >= oldest {
                break;
            }
            if pinned.contains(&candidate.key) {
                collected.pinned += 1;
                continue;
            }
            gone.insert(candidate.key);
            size -= candidate.bytes;
            for digest in &candidate.blobs {
                let Some(found) = blobs.get_mut(digest) else { continue };
                found.readers -= 1;
                if found.readers == 0 {
                    size -= found.bytes;
                    dead.insert(*digest);
                }
            }
        }
        // Memos and history are removed only if removing records and blobs is not enough.
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
        // On a full disk the new log needs space, so blobs that no record names are removed before it is written.
        let unnamed = blobs.iter().filter(|(_, found)| found.named == 0).map(|(digest, _)| *digest);
        self.blobs().remove_files(&unnamed.collect())?;
        self.sweep();
        let _ = fs::remove_dir_all(root.join(QUARANTINE));
        // Records first: a killed collection leaves blobs that no record names, and never the reverse.
        let kept = |found: u8, key: &Digest| match found {
            kind::RECORD => !gone.contains(key),
            _ => !notes_too,
        };
        // A process without a run may append, a memo for example.
        let compact = || -> Result<bool> {
            let done = lock(self.records()).compact(kept)?;
            if done { Ok(true) } else { lock(self.records()).compact(kept) }
        };
        let compacted = match compact() {
            // Here the blobs are removed first. If the process is killed in between, records name missing blobs,
            // which are computed again.
            Err(Error::Full { .. }) => {
                self.blobs().remove_files(&dead)?;
                compact()
            }
            result => result,
        };
        if !compacted? {
            return Err(Error::InUse { waited: timeout });
        }
        reach(failpoint::GC_RECORDS_GONE).at("collect", root)?;
        self.blobs().remove(&dead)?;
        lock(self.records()).save_index()?;
        collected.after = size_of(root);
        Ok(collected)
    }

    /// Returns every record, and the total stored size of all memos and history tables in bytes.
    fn candidates(&self, names: Names<'_>) -> Result<(Vec<Candidate>, u64)> {
        let mut records = lock(self.records());
        records.refresh()?;
        let used = last_used(&mut records)?;
        let mut candidates = Vec::new();
        for key in records.keys(kind::RECORD)? {
            let Some(payload) = records.get(kind::RECORD, &key)? else { continue };
            let mut named = names(&payload);
            named.sort_unstable();
            named.dedup();
            let used = used.get(&key).copied().unwrap_or(0);
            candidates.push(Candidate { key, bytes: stored_size(payload.len() as u64), blobs: named, used });
        }
        let mut notes = 0;
        for kind in [kind::MEMO, kind::HISTORY] {
            notes += records.lengths(kind)?.into_iter().map(|(_, length)| stored_size(length)).sum::<u64>();
        }
        Ok((candidates, notes))
    }

    fn found_blobs(&self, root: &Path) -> Result<BTreeMap<Digest, BlobUse>> {
        let small = self.blobs().small_sizes()?.into_iter();
        let small = small.map(|(digest, bytes)| (digest, stored_size(bytes), 0));
        let large = blob_files(root)
            .into_iter()
            .map(|(digest, meta)| (digest, meta.len(), meta.modified().map_or(0, seconds)));
        Ok(small
            .chain(large)
            .map(|(digest, bytes, used)| (digest, BlobUse { bytes, used, named: 0, readers: 0 }))
            .collect())
    }
}

/// The number of bytes that an entry with a payload of `payload` bytes takes in a log and the log's index.
fn stored_size(payload: u64) -> u64 {
    Entry::length(0) as u64 + payload + index::ENTRY as u64
}

/// The time of the last use of each record that a history table lists, by the key of the record, in seconds since
/// 1970.
fn last_used(records: &mut Log) -> Result<BTreeMap<Digest, u64>> {
    let mut used = BTreeMap::new();
    let times = Table::open(records.get(kind::HISTORY, &Table::key(USED))?.unwrap_or_default());
    for key in records.keys(kind::HISTORY)? {
        let Some(bytes) = records.get(kind::HISTORY, &key)? else { continue };
        let time = times.get(&key.to_string()).and_then(|time| time.first_chunk());
        let time = time.map_or(0, |time| u64::from_le_bytes(*time));
        for (_, value) in Table::open(bytes).rows() {
            for key in value.as_chunks::<32>().0 {
                let known = used.entry(Digest::from_bytes(*key)).or_insert(0);
                *known = time.max(*known);
            }
        }
    }
    Ok(used)
}

/// Returns the digest and metadata of every blob that is stored as a separate file.
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

/// The total size of the files below a folder, in bytes.
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

impl Store {
    /// Waits until no run is active. New runs cannot start while the returned guard is held.
    fn exclusive(&self, timeout: Duration) -> Result<crate::file_lock::FileGuard> {
        let alone = self.runs()?.and_then(|runs| runs.exclusive(timeout));
        alone.ok_or(Error::InUse { waited: timeout })
    }
}
