//! Results that several machines share.

use std::sync::atomic::AtomicBool;

use cache::Digest;

use crate::record::record::Record;
use crate::remote::entry::Entry;
use crate::value::artifact::Corrupt;
use crate::value::error::NodeError;

/// Results on another machine. The store of a run is asked first, then this.
///
/// An implementation returns only entries whose origin it has verified. The engine verifies the digests of values
/// again. All methods may wait for a network, and are called on several threads at once; they return soon after
/// `cancel` is set.
pub trait SharedResults: Send + Sync {
    /// The result of a key; `None` if none may be used.
    ///
    /// # Errors
    /// Only if the run must not continue without the shared results. The node then fails.
    fn find(&self, key: &Digest, cancel: &AtomicBool) -> Result<Option<Entry>, NodeError>;

    /// The bytes with the digest `value`, one of the values of the result of `key`; `None` if they are not
    /// available any more.
    ///
    /// # Errors
    /// Only if the run must not continue without the shared results.
    fn fetch(&self, key: &Digest, value: &Digest, cancel: &AtomicBool) -> Result<Option<Vec<u8>>, NodeError>;

    /// Offers a new result to others. `values` has the digest and the bytes of each stored value. A failure is a
    /// remark.
    fn publish(&self, entry: &Entry, values: &[(Digest, &[u8])], cancel: &AtomicBool);

    /// Id and text of the warnings since the last call, such as that the server cannot be reached.
    fn remarks(&self) -> Vec<(&'static str, String)>;
}

/// A copy of a record in which exactly the values accepted by `here` are marked as stored. So a later run without
/// the shared results computes the other values again.
///
/// # Errors
/// If the bytes are not a record of a node.
pub(crate) fn local_record(record: &[u8], here: impl Fn(&Digest) -> bool) -> Result<Vec<u8>, Corrupt> {
    Record::marking(record, |digest, _| here(digest))
}
