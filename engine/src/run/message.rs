//! Messages from the threads to the scheduler.

use std::path::PathBuf;

use cache::Digest;

use crate::kind::context::ReadSource;
use crate::record::record::Record;
use crate::run::event::Event;
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;
use crate::value::error::NodeError;

/// A message from a thread to the scheduler.
pub(crate) enum Message {
    Event(Event),
    Sources {
        node: usize,
        sources: Result<Vec<ReadSource>, NodeError>,
    },
    Loaded {
        node: usize,
        port: usize,
        value: Option<AnyArtifact>,
    },
    /// The key of the node or of a part of it is being computed elsewhere.
    Busy {
        node: usize,
        key: Digest,
        /// Work done so far; its parts are stored.
        spent: Effort,
    },
    /// The code ended. `Stored` follows.
    Finished {
        node: usize,
        outcome: Result<Box<Finished>, NodeError>,
    },
    Stored {
        node: usize,
        error: Option<String>,
    },
    Placed {
        node: usize,
        placed: Result<Option<Placed>, NodeError>,
    },
}

/// The result of a node, from its code or from another process.
pub(crate) struct Finished {
    pub record: Record,
    /// One value per output; empty if another process computed them.
    pub values: Vec<AnyArtifact>,
    /// Work done in this run.
    pub effort: Effort,
    /// Whether the code ran here.
    pub ran: bool,
}

/// Output files, and whether each was written.
pub(crate) type Placed = Vec<(PathBuf, bool)>;
