//! Storage of results between runs, as bytes and digests. This crate knows nothing about graphs or images.
//!
//! - [`Digest`] identifies content; [`KeyWriter`] makes the [`Key`] of a result, and its readable [`Manifest`].
//! - [`Store`] is a cache folder. It contains *blobs* (content by its digest), *records* (results by their key),
//!   *memos* (the digest of a file, valid while its metadata are unchanged), *history* (tables of small values, for
//!   forecasts) and *leases* (so that two processes do not compute one key twice).
//! - [`publish_file`] writes a user's file completely or not at all.
//!
//! ```
//! # let folder = tempfile::tempdir().expect("a folder for the example");
//! let store = cache::Store::open(folder.path(), cache::Options::default())?;
//! let image = store.put_blob(b"pixels")?;
//! store.put_record(&cache::Digest::of(b"the key"), image.as_bytes())?;
//! assert_eq!(store.get_blob(&image)?.as_deref(), Some(&b"pixels"[..]));
//! store.flush()?;
//! # Ok::<(), cache::Error>(())
//! ```
//!
//! # Guarantees
//! - A read never returns bytes that do not match the requested digest, or a record that was not stored completely.
//! - Everything that was stored successfully survives the death of a process, with one exception (see
//!   [`Store::put_record`]). A loss of power may lose what was stored since the last [`Store::flush`] (see
//!   [`Fsync`]), but never makes a read return wrong data.
//! - Processes may start, stop and be killed at any time: no lock ever has to be removed by hand, and no repair has
//!   to be run.
//! - Damage affects only the blob or record that contains it. It is reported once as an [`Incident`] and then
//!   removed.
//! - Anything of the wrong type at the path of a file or folder of the cache is moved to the quarantine. Nothing is
//!   created at the target of a dangling link.
//!
//! # Format 1 on disk
//! ```text
//! CACHEDIR.TAG               asks backup programs to skip the folder; never read
//! v1/                        everything of format 1; another format is another folder next to it
//!   records.log  .lock  .index   records, memos, history
//!   blobs.log    .lock  .index   blobs shorter than 4096 bytes
//!   blobs/ab/abcd…           every other blob; the file is named by the 64 digits of its digest, the folder by two
//!   temp/.PID-N.lightharmony-temp   files being written, locked (flock) by their writer
//!   quarantine/abcd…         damaged blobs (the last of each digest), logs without a head, obstacles; never read
//!   last/abcd…               lookups of the last run of a graph, followed by their BLAKE3; only saves time
//!   leases/abcd…             one per key; locked by the holder, which removes the file before it unlocks it
//!   pins/abcd…               records that no collection removes: a name, then keys, one per line
//!   runs.lock                locked shared by active runs, and exclusively by a collection
//! ```
//! A **blob file** contains only the content of the blob. It is written in `temp` and then renamed.
//!
//! A **log** starts with 64 bytes, two equal copies of 32, so that damage to one copy does no harm:
//! ```text
//!  0  8  "LHlog" 0 0 1
//!  8  4  salt: random per file, so that an entry of another log inside a payload is not taken for one of this log
//! 12  4  CRC-32 of bytes 0..12
//! 16 16  zero
//! ```
//! Entries follow. All numbers are little-endian.
//! ```text
//!  0  4  "LHe1"
//!  4  4  CRC-32 of bytes 8..64, started from the salt
//!  8  4  CRC-32 of the payload, started from the salt with every bit inverted
//! 12  4  length of the payload, at most 16 MiB
//! 16  1  kind: 1 record, 2 blob, 3 memo, 4 history; plus 128: removes the entry of that kind and key
//! 17 15  zero
//! 32 32  key: for a record its key, for a blob its digest, for a memo the BLAKE3 of the absolute path, for
//!        history the BLAKE3 of the name of the table
//! 64  n  payload: for a memo the fields of [`FileStamp`] in order, 8 bytes each, then the digest; for history,
//!        row by row, the lengths of name and value, 4 bytes each, then the name and the value
//! ```
//! The last entry of a kind and key is valid. Compaction also keeps the last entry of each key of an unknown kind,
//! unchanged. Bytes of a log are never changed or cut off. Between complete entries there may be damage, and
//! incomplete entries that a killed writer or a full disk left. A reader then searches for the start of the next
//! complete entry. Bytes after the last entry may belong to an entry that is still being written, and are read
//! again later.
//!
//! The **index** of a log contains the locations of its entries, so that opening the log reads only what was
//! appended after the index was written. The index consists of pages of 4096 bytes. Each page ends with the CRC-32
//! of its other bytes, started from the log's salt XOR the number of the page. Page 0 starts with `LHindex1` and
//! five numbers of 8 bytes: the number of bytes of the log that are indexed, the number of entries, and the numbers
//! of live, dead and damaged bytes. It is followed by the directory: for each page of entries, the first 8 bytes of
//! its first key as a number, 511 per page. Then follow the pages of entries, 85 per page, sorted by key and then
//! by kind. An entry consists of the key (32), the offset after the log's head (8), the length of the payload (4),
//! the kind (1) and three zero bytes. Entries are verified when they are read. If one does not match the index, the
//! index is discarded and the whole log is read.
//!
//! A writer locks `.lock` (flock, exclusive), reads what others appended, and appends. A reader holds a shared lock
//! while it reads what was appended, unless it would have to wait for the lock. Compaction writes a new log under
//! the lock and renames it over the old log. Other processes detect this by the identity of the file. A writer that
//! does not get the lock within two seconds appends without it, and appends again if the log was replaced in the
//! meantime. Where locks do not work there is no compaction, and appends are single writes at the end of the file.
//!
//! The holder of a lease sets the modification time of the lease file every second. Other processes do not wait for
//! a holder that has not done so for ten seconds, but compute the key themselves. This is safe, since equal keys
//! give equal bytes.
#![cfg_attr(test, allow(clippy::unwrap_used, reason = "a test may panic"))]

mod blobs;
mod digest;
mod digest_hasher;
mod entry;
mod error;
pub mod failpoint;
mod file_lock;
mod gc;
mod history;
mod index;
mod inspect;
mod key;
mod last_run;
mod lease;
mod location;
mod log;
mod log_head;
mod manifest;
mod memo;
mod obstacle;
mod page_cache;
mod pin;
mod publish;
mod regular;
mod settings;
mod stamp;
mod store;
mod temp;
mod temp_folder;

pub use digest::{Digest, DigestWriter};
pub use error::{Error, Result};
pub use gc::{Collected, Limits, Names};
pub use inspect::{Checked, Stat};
pub use key::{Key, KeyError, KeyWriter};
pub use last_run::last_run;
pub use lease::{Lease, LeaseState, STALLED_AFTER};
pub use manifest::{Change, Line, Manifest, Value};
pub use publish::{publish_file, publish_through};
pub use settings::{Fsync, Incident, Options};
pub use stamp::FileStamp;
pub use store::{Running, Store, today};
pub use temp_folder::TempFolder;
