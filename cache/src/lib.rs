//! Bytes and digests: what lightharmony keeps between runs. Knows nothing of graphs or images.
//!
//! - [`Digest`] names content; [`KeyWriter`] makes the [`Key`] of a result, and its readable [`Manifest`].
//! - [`Store`] is a cache folder: *blobs* (content by its own digest), *records* (what came of a key), *memos*
//!   (a file's digest while its stamp stays), *history* (small notes in books, for forecasts) and *leases* (so that two
//!   processes do not compute one key twice).
//! - [`publish_file`] writes a user's file whole or not at all.
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
//! # What holds
//! - No reader ever gets bytes of another digest, or a record that was not stored whole.
//! - What a put acknowledged outlives a killed process. A loss of power may take what was put since the last
//!   [`Store::flush`] (see [`Fsync`]), and never makes anything wrong.
//! - No lock to remove, no repair to run: any number of processes may start, stop and die at any time.
//! - Damage costs what it lies in and nothing else, is reported once as an [`Incident`], and is then gone.
//!
//! # On disk, format 1
//! ```text
//! CACHEDIR.TAG               tells backup programs to leave the folder out; never read
//! v1/                        all of format 1; another format is another folder beside it
//!   records.log  .lock  .index   records, memos, history
//!   blobs.log    .lock  .index   blobs shorter than 4096 bytes
//!   blobs/ab/abcd…           every other blob, by the 64 digits of its digest below the first two
//!   temp/.PID-N.lightharmony-temp   files being written, locked (flock) by their writer
//!   quarantine/abcd…         bad blobs (the last of each digest) and logs without a head; never read
//!   last/abcd…               what the last run of a graph looked up, then the BLAKE3 of that; saves time only
//!   leases/abcd…             by key, locked by the holder, removed by it before it unlocks
//!   pins/abcd…               what no collection removes: a name, then keys, a line each
//!   runs.lock                locked shared while a run is at work, and alone by a collection
//! ```
//! A **blob file** is the content and nothing else. It is written in `temp` and renamed.
//!
//! A **log** starts with 64 bytes, twice the same 32 so that damage to one copy does no harm:
//! ```text
//!  0  8  "LHlog" 0 0 1
//!  8  4  salt: random per file, so that an entry of another log inside a payload is never taken for ours
//! 12  4  CRC-32 of bytes 0..12
//! 16 16  zero
//! ```
//! Entries follow with no gaps. All numbers are little-endian.
//! ```text
//!  0  4  "LHe1"
//!  4  4  CRC-32 of bytes 8..64, started from the salt
//!  8  4  CRC-32 of the payload, started from the salt with every bit turned
//! 12  4  length of the payload, at most 16 MiB
//! 16  1  kind: 1 record, 2 blob, 3 memo, 4 history; plus 128: removes the entry of that kind and key
//! 17 15  zero
//! 32 32  key: of a record its key, of a blob its digest, of a memo the BLAKE3 of the absolute path, of
//!        history the BLAKE3 of its book's name
//! 64  n  payload: of a memo the fields of [`FileStamp`] in order, 8 bytes each, then the digest; of a book for
//!        each note the lengths of its name and value, 4 bytes each, then both
//! ```
//! The last entry of a kind and key counts. Kinds not listed are kept as they are by compaction, the last of
//! each key. A reader that meets anything else than an entry looks for the next place where a whole one
//! starts; what follows the last entry may be one that is still being written, and is looked at again.
//!
//! The **index** of a log says where its entries lie, so that opening reads only what was appended since. It is
//! pages of 4096 bytes, each ending with the CRC-32 of the rest, started from the log's salt xor its number. Page
//! 0 starts with `LHindex1` and five numbers of 8 bytes: how much of the log is indexed, how many entries, and
//! how many bytes are live, dead and damaged. Pages of entries hold 85 each, sorted by key and then kind: key,
//! offset after the log's head (8), length of the payload (4), kind (1), three zeros. Between them and page 0
//! stand the first 8 bytes of the first key of each such page, as numbers, 511 a page. An entry is checked when it
//! is read; where it is not what the index says, the index is forgotten and the log read whole.
//!
//! A writer locks `.lock` (flock, exclusive), reads what others appended, cuts off a torn tail, and appends.
//! Readers take it shared while they read what was appended, if they can have it at once. Compaction writes
//! a new log under the lock and renames it over the old one; everybody notices by the file's identity.
//! Where locks do not work there is no compaction, and appends are single writes at the end of the file.
#![cfg_attr(test, allow(clippy::unwrap_used, reason = "a test may panic"))]

mod blobs;
mod digest;
mod entry;
mod error;
pub mod failpoint;
mod file_lock;
mod fold;
mod gc;
mod history;
mod index;
mod inspect;
mod key;
mod last_run;
mod lease;
mod log;
mod log_head;
mod manifest;
mod memo;
mod pin;
mod publish;
mod slot;
mod stamp;
mod store;
mod temp;
mod temp_folder;
mod window;

pub use digest::{Digest, DigestWriter};
pub use error::{Error, Result};
pub use gc::{Collected, Limits, Names};
pub use inspect::{Checked, Stat};
pub use key::{Key, KeyError, KeyWriter};
pub use last_run::last_run;
pub use lease::{Lease, LeaseState};
pub use manifest::{Change, Line, Manifest, Value};
pub use publish::{publish_file, publish_through};
pub use stamp::FileStamp;
pub use store::{Fsync, Incident, Options, Running, Store, today};
pub use temp_folder::TempFolder;
