//! Where a node is computed: here, or by a worker.

use std::fmt::{self, Display, Formatter};

use crate::kind::contract::Keep;
use crate::kind::registry::KindEntry;
use crate::remote::workers::WorkerTerms;
use crate::value::units::bytes_text;

/// The profile of kinds whose results are equal on all machines.
const PORTABLE: &str = "portable";
/// A node with a shorter forecast, in seconds, is computed here.
const SHORT: f64 = 0.5;

/// Where a node is computed, and why. The text of a placement is a part of a sentence, such as `here: it takes less
/// than 0.5 s`.
#[derive(Debug, Clone, PartialEq)]
pub enum Placement {
    /// A worker computes the node. The number is the forecast in seconds; `None` if the kind has never run.
    Worker(Option<f64>),
    /// The node takes microseconds.
    Instant,
    /// The node runs a program that is installed here.
    Program,
    /// The results of the kind may differ between machines. The text is the profile of the kind.
    Profile(&'static str),
    /// The node writes files.
    Sink,
    /// The value of the node is not stored, since computing it is as fast as reading it.
    NotStored,
    /// The forecast is short.
    Short,
    /// Sending the inputs would take longer than the node.
    Transfer {
        /// The inputs that the server does not have, in bytes.
        bytes: u64,
    },
}

impl Placement {
    /// Decides where a node is computed. `seconds` is the forecast, and `bytes` is the total size of the inputs that
    /// the server does not have.
    pub(crate) fn of(
        kind: &KindEntry,
        is_sink: bool,
        seconds: Option<f64>,
        bytes: u64,
        terms: &WorkerTerms,
    ) -> Self {
        let transfer = terms.overhead + bytes as f64 / terms.speed.max(1.0);
        match seconds {
            _ if kind.instant => Self::Instant,
            _ if kind.runs_programs => Self::Program,
            _ if is_sink => Self::Sink,
            _ if kind.profile != PORTABLE => Self::Profile(kind.profile),
            _ if kind.store != Keep::Always => Self::NotStored,
            Some(seconds) if seconds < SHORT => Self::Short,
            Some(seconds) if seconds < transfer => Self::Transfer { bytes },
            _ => Self::Worker(seconds),
        }
    }

    /// True if a worker computes the node.
    pub fn is_remote(&self) -> bool {
        matches!(self, Self::Worker(_))
    }
}

impl Display for Placement {
    fn fmt(&self, to: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Worker(Some(_)) => to.write_str("on a worker"),
            Self::Worker(None) => to.write_str("on a worker: its kind has not run yet"),
            Self::Instant => to.write_str("here: it takes microseconds"),
            Self::Program => to.write_str("here: it runs an installed program"),
            Self::Profile(profile) => {
                write!(to, "here: results of `{profile}` may differ between machines")
            }
            Self::Sink => to.write_str("here: it writes files"),
            Self::NotStored => to.write_str("here: it is as fast to compute as to fetch"),
            Self::Short => write!(to, "here: it takes less than {SHORT} s"),
            Self::Transfer { bytes } => {
                write!(to, "here: sending its inputs ({}) would take longer", bytes_text(*bytes))
            }
        }
    }
}
