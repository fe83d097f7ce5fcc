//! Operations on a whole cache: statistics, verification, repair, and copying to another cache.

use std::fs;
use std::path::Path;

use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::gc::{Names, blob_files, size_of};
use crate::obstacle::QUARANTINE;
use crate::settings::{kind, lock};
use crate::store::Store;

/// The contents of a cache folder; sizes are in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stat {
    /// The total size of all files in the folder.
    pub bytes: u64,
    /// The number of records.
    pub records: usize,
    /// The number of memos.
    pub memos: usize,
    /// The number of blobs that are stored in the log of small blobs.
    pub small_blobs: usize,
    /// The number of blobs that are stored as separate files.
    pub large_blobs: usize,
    /// The total size of the large blobs.
    pub large_bytes: u64,
    /// The total size of the log of records and the log of small blobs.
    pub log_bytes: u64,
    /// The size of those entries in the logs that were replaced or removed. Compaction frees this space.
    pub dead_bytes: u64,
    /// The total size of the files in the quarantine.
    pub quarantine_bytes: u64,
}

/// The result of verifying a whole cache.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Checked {
    /// The number of blobs that were read.
    pub blobs: usize,
    /// The total size in bytes of the blobs that were read.
    pub bytes: u64,
    /// The number of records that were read.
    pub records: usize,
    /// The number of bytes in the logs that belong to no entry.
    pub damaged_bytes: u64,
    /// The digests of damaged blobs.
    pub bad: Vec<Digest>,
    /// The keys of records that name a missing or damaged blob.
    pub incomplete: Vec<Digest>,
}

impl Checked {
    /// True if no damage was found.
    pub fn is_whole(&self) -> bool {
        self.damaged_bytes == 0 && self.bad.is_empty() && self.incomplete.is_empty()
    }
}

impl Store {
    /// Counts the contents of the cache. Reads the logs, but no blob files.
    ///
    /// # Errors
    /// If something cannot be read.
    pub fn stat(&self) -> Result<Stat> {
        let Some(root) = self.folder() else { return Ok(Stat::default()) };
        let large = blob_files(root);
        let length = |name: &str| fs::metadata(root.join(name)).map_or(0, |meta| meta.len());
        let small_blobs = self.blobs().small_sizes()?.len();
        let mut records = lock(self.records());
        records.refresh()?;
        Ok(Stat {
            bytes: size_of(root),
            records: records.keys(kind::RECORD)?.len(),
            memos: records.keys(kind::MEMO)?.len(),
            small_blobs,
            large_blobs: large.len(),
            large_bytes: large.iter().map(|(_, meta)| meta.len()).sum(),
            log_bytes: length("records.log") + length("blobs.log"),
            dead_bytes: records.dead() + self.blobs().small_dead(),
            quarantine_bytes: size_of(&root.join(QUARANTINE)),
        })
    }

    /// Reads and verifies everything. If `repair` is true, damaged blobs are quarantined, records that name missing
    /// blobs are removed, and damaged logs are rewritten. Runs never need such a repair, since every read verifies
    /// and repairs what it reads. `progress` receives the finished fraction of the work, from 0 to 1, and returns
    /// true to continue.
    ///
    /// # Errors
    /// If something cannot be read or written.
    pub fn check(
        &self,
        repair: bool,
        names: Names<'_>,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Checked> {
        let mut checked = Checked::default();
        let Some(root) = self.folder() else { return Ok(checked) };
        if repair {
            self.forget_last_runs();
        }
        checked.damaged_bytes = lock(self.records()).reread()? + self.blobs().reread_small()?;
        let small = self.blobs().small_sizes()?.into_iter();
        let large = blob_files(root).into_iter().map(|(digest, meta)| (digest, meta.len()));
        let all: Vec<(Digest, u64)> = small.chain(large).collect();
        for (done, (digest, bytes)) in all.iter().enumerate() {
            if !progress(done as f64 / all.len() as f64) {
                return Ok(checked);
            }
            checked.blobs += 1;
            checked.bytes += bytes;
            let good =
                if repair { self.get_blob(digest)?.is_some() } else { self.blobs().is_good(digest)? };
            if !good {
                checked.bad.push(*digest);
            }
        }
        checked.bad.sort_unstable();
        checked.bad.dedup();
        for key in self.record_keys()? {
            let Some(payload) = self.get_record(&key) else { continue };
            checked.records += 1;
            let served =
                |digest: &Digest| checked.bad.binary_search(digest).is_err() && self.has_blob(digest);
            if !names(&payload).iter().all(served) {
                checked.incomplete.push(key);
                if repair {
                    self.remove_record(&key)?;
                }
            }
        }
        if repair {
            self.flush()?;
            self.sweep();
        }
        Ok(checked)
    }

    /// Copies records and the blobs that they name to another cache. `keys` selects the records; `None` selects
    /// all. Returns the number of records copied. Records with missing or damaged blobs are not copied; damage is
    /// reported as an [`Incident`](crate::Incident).
    ///
    /// # Errors
    /// If reading or writing fails.
    pub fn copy_to(
        &self,
        other: &Store,
        keys: Option<&[Digest]>,
        names: Names<'_>,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<usize> {
        if other.is_read_only() {
            let why = other.why_read_only().unwrap_or_default().to_owned();
            let source = std::io::Error::new(std::io::ErrorKind::ReadOnlyFilesystem, why);
            let path = other.folder().unwrap_or(Path::new("the other cache"));
            return Err(Error::io("write to", path, source));
        }
        let keys = keys.map_or_else(|| self.record_keys(), |keys| Ok(keys.to_vec()))?;
        let mut copied = 0;
        'records: for (done, key) in keys.iter().enumerate() {
            if !progress(done as f64 / keys.len() as f64) {
                break;
            }
            let Some(payload) = self.get_record(key) else { continue };
            for digest in names(&payload) {
                match self.get_blob(&digest)? {
                    Some(bytes) => other.put_blob_as(&digest, &bytes)?,
                    None => continue 'records,
                }
            }
            other.put_record(key, &payload)?;
            copied += 1;
        }
        other.flush()?;
        Ok(copied)
    }
}
