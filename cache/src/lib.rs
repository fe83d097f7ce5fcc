//! Bytes and digests: what lightharmony keeps between runs.
#![cfg_attr(test, allow(clippy::unwrap_used, reason = "a test may panic"))]

mod blobs;
mod digest;
mod entry;
mod error;
pub mod failpoint;
mod key;
mod lease;
mod log;
mod manifest;
mod memo;
mod publish;
mod stamp;
mod store;
mod temp;

pub use digest::{Digest, DigestWriter};
pub use error::{Error, Result};
pub use key::{Key, KeyError, KeyWriter};
pub use lease::{Lease, LeaseState};
pub use manifest::{Change, Line, Manifest, Value};
pub use publish::publish_file;
pub use stamp::FileStamp;
pub use store::{Fsync, Incident, Options, Store};
pub use temp::sweep_temp;
