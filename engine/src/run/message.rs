//! Messages from the threads to the scheduler.

use std::path::PathBuf;

use cache::Digest;

use crate::kind::context::ReadSource;
use crate::record::record::Record;
use crate::run::event::Event;
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;
use crate::value::error::NodeError;

/// What the threads tell the scheduler.
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
    /// Another computes this key, which is that of the node or of a part of it.
    Busy {
        node: usize,
        key: Digest,
        /// What was done until then, of which stored parts are.
        spent: Effort,
    },
    /// `Stored` follows.
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

/// The result of a node's code, or of another process that was faster.
pub(crate) struct Finished {
    pub record: Record,
    /// One value an output; empty where another process made them.
    pub values: Vec<AnyArtifact>,
    /// That of this run.
    pub effort: Effort,
    /// False where another process made them.
    pub ran: bool,
}

/// Each file and whether it had to be written.
pub(crate) type Placed = Vec<(PathBuf, bool)>;
