//! Workers: other machines that compute nodes for this one.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use cache::Digest;

use crate::remote::entry::Entry;
use crate::value::error::NodeError;

/// Machines that compute nodes on request. A run uses them for the nodes that [`Placement`](crate::Placement)
/// assigns to them.
///
/// The outputs of a node stay where they were computed. Later requests name them by their digests, and
/// [`SharedResults::fetch`](crate::SharedResults::fetch) brings one of them here.
///
/// All methods except [`compute`](Self::compute) return without waiting for a network. All may be called on several
/// threads at once.
pub trait Workers: Send + Sync {
    /// The terms on which workers compute nodes; `None` if they compute no further nodes in this run.
    fn terms(&self) -> Option<WorkerTerms>;

    /// True if the workers are believed to have the value with this digest.
    fn holds(&self, value: &Digest) -> bool;

    /// Computes a node, and waits for the result. `report` receives each new stage. Must return soon after `cancel`
    /// is set, and the work must then be cancelled.
    ///
    /// # Errors
    /// If the run was cancelled, or if the workers are not available and the node must not be computed here.
    fn compute(
        &self,
        request: &WorkRequest<'_>,
        cancel: &AtomicBool,
        report: &dyn Fn(Stage),
    ) -> Result<Work, NodeError>;

    /// Makes the workers compute no further nodes in this run, because a result was wrong.
    fn distrust(&self, why: &str);
}

/// The terms on which workers compute nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorkerTerms {
    /// Maximum number of nodes in progress at once.
    pub in_flight: usize,
    /// Time in seconds for a node in addition to its code and to the transfer of its inputs.
    pub overhead: f64,
    /// Speed of the connection in bytes per second.
    pub speed: f64,
    /// The fraction of the nodes, from 0 to 1, that are computed here as well to check the workers.
    pub checked: f64,
}

/// A node that a worker computes.
pub struct WorkRequest<'a> {
    /// The key of the node.
    pub key: Digest,
    /// The files that the worker reads, in a folder of their own. This is an action folder.
    pub files: &'a [WorkFile],
    /// Returns the bytes of a value, if they are here.
    pub bytes: &'a dyn Fn(&Digest) -> Option<Vec<u8>>,
    /// Path of the [entry](Entry) within the outputs folder.
    pub entry: &'static str,
    /// Paths of the values within the outputs folder, in the order of their digests in the record.
    pub values: &'a [String],
    /// Forecast of the time in seconds that the code takes here.
    pub forecast: Option<f64>,
    /// True if the result will be checked here, so that it must not be offered to others before.
    pub checked: bool,
}

/// A file of an action folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WorkFile {
    /// Path within the folder, with `/` between its parts. No part is empty, `.` or `..`.
    pub path: String,
    /// The content of the file.
    pub content: WorkContent,
}

/// The content of a file of an action folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum WorkContent {
    /// A text.
    Text(String),
    /// The value with this digest.
    Value(Digest),
    /// The content of a file on this machine.
    File {
        /// The file.
        path: PathBuf,
        /// Digest of the content.
        digest: Digest,
    },
}

/// The stage of a node that a worker computes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Stage {
    /// Inputs are being sent.
    Sending,
    /// The node waits for a worker.
    Queued,
    /// A worker computes the node. Its name is empty if it is not known.
    Executing(String),
}

/// The answer to a request.
#[derive(Debug)]
pub enum Work {
    /// The node was computed. The entry belongs to the key of the request, and the lengths of the values were
    /// checked. The values are where the worker stored them.
    Done {
        /// The result.
        entry: Box<Entry>,
        /// The name of the worker, for messages.
        worker: String,
    },
    /// The code of the node failed.
    Failed {
        /// The message.
        message: String,
        /// Advice.
        hint: Option<String>,
    },
    /// Some of the inputs are not on the server any more, and their bytes are not here.
    Missing,
    /// No worker computed the node, for a reason that [`SharedResults::remarks`](crate::SharedResults::remarks)
    /// reports.
    Refused,
}

/// True if the node with this key belongs to the sample of nodes that are checked. The sample depends only on the key.
pub(crate) fn is_checked(key: &Digest, fraction: f64) -> bool {
    let digest = Digest::of(&[b"lightharmony sample 1 ".as_slice(), key.as_bytes()].concat());
    let [a, b, c, d, ..] = *digest.as_bytes();
    f64::from(u32::from_le_bytes([a, b, c, d])) < fraction * (f64::from(u32::MAX) + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sample_has_the_stated_size_and_grows_with_the_fraction() {
        let keys: Vec<Digest> = (0..5000_u32).map(|n| Digest::of(&n.to_le_bytes())).collect();
        let sample =
            |fraction| keys.iter().filter(|key| is_checked(key, fraction)).copied().collect::<Vec<_>>();
        assert_eq!((sample(0.0).len(), sample(1.0).len()), (0, keys.len()));
        let (small, large) = (sample(0.02), sample(0.2));
        assert!((60..140).contains(&small.len()) && (900..1100).contains(&large.len()), "{}", small.len());
        assert!(small.iter().all(|key| large.contains(key)));
    }
}
