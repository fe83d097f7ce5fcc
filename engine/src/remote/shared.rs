//! Results that several machines share.

use std::sync::atomic::AtomicBool;

use cache::Digest;

use crate::record::record::Record;
use crate::remote::entry::Entry;
use crate::value::codec::Corrupt;
use crate::value::error::NodeError;

/// Results on another machine. A run looks for a result in its store first, and then here.
///
/// An implementation must return only entries whose origin it has verified. The engine verifies the digests of
/// values again. All methods may wait for a network, and may be called on several threads at once. They must return
/// soon after `cancel` is set.
pub trait SharedResults: Send + Sync {
    /// The result of a key; `None` if there is no result that may be used.
    ///
    /// # Errors
    /// If the shared results are not available and the run must not continue without them. The node then fails.
    fn find(&self, key: &Digest, cancel: &AtomicBool) -> Result<Option<Entry>, NodeError>;

    /// The bytes of one of the values of the result of `key`: the value with the digest `value`. `None` if it is no
    /// longer available.
    ///
    /// # Errors
    /// If the shared results are not available and the run must not continue without them.
    fn fetch(&self, key: &Digest, value: &Digest, cancel: &AtomicBool) -> Result<Option<Vec<u8>>, NodeError>;

    /// Offers a new result to other machines. `values` contains the digest and the bytes of each stored value. A
    /// failure becomes a warning; see [`remarks`](Self::remarks).
    fn publish(&self, entry: &Entry, values: &[(Digest, &[u8])], cancel: &AtomicBool);

    /// Id and text of the warnings since the last call, such as that the server cannot be reached.
    fn remarks(&self) -> Vec<(&'static str, String)>;
}

/// A copy of a record in which a value is marked as stored exactly if `here` returns true for it. A later run
/// without the shared results therefore computes the other values again.
///
/// # Errors
/// If the bytes are not a record of a node.
pub(crate) fn local_record(record: &[u8], here: impl Fn(&Digest) -> bool) -> Result<Vec<u8>, Corrupt> {
    Record::marking(record, |digest, _| here(digest))
}
