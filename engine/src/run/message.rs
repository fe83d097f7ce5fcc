//! Messages from the threads to the scheduler.

use std::path::PathBuf;
use std::sync::mpsc::Sender;

use cache::Digest;

use crate::kind::context::ReadSource;
use crate::record::record::Record;
use crate::remote::entry::Entry;
use crate::remote::workers::Work;
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
    /// The answer of the results that machines share.
    Asked {
        node: usize,
        found: Result<Option<Box<Entry>>, NodeError>,
    },
    /// The answer of the workers.
    Worked {
        node: usize,
        work: Result<Work, NodeError>,
    },
    /// The value is `None` if it is not available. An error means that it must not be computed here.
    Loaded {
        node: usize,
        port: usize,
        value: Result<Option<AnyArtifact>, NodeError>,
    },
    /// The result of the node or of one of its parts is being computed elsewhere.
    Busy {
        node: usize,
        key: Digest,
        /// Time and counts of the work done so far. Parts that were completed are in the store.
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

/// A message that a thread must send, since the scheduler waits for it. If the thread panics before it sends one,
/// the message that `otherwise` makes from an error is sent instead. The thread itself must create this value, so
/// that no message is sent for work that never starts.
pub(crate) struct Owed<'s, F: FnOnce(NodeError) -> Message> {
    sender: &'s Sender<Message>,
    otherwise: Option<F>,
}

impl<'s, F: FnOnce(NodeError) -> Message> Owed<'s, F> {
    pub fn new(sender: &'s Sender<Message>, otherwise: F) -> Self {
        Self { sender, otherwise: Some(otherwise) }
    }

    /// Sends the message. The scheduler outlives every thread, so this cannot fail.
    pub fn send(self, message: Message) {
        let _ = self.sender.send(message);
        self.cancel();
    }

    /// Cancels the duty to send this message, because another message was sent in its place.
    pub fn cancel(mut self) {
        self.otherwise = None;
    }
}

impl<F: FnOnce(NodeError) -> Message> Drop for Owed<'_, F> {
    fn drop(&mut self) {
        if let Some(otherwise) = self.otherwise.take() {
            let error = NodeError::new("a thread that worked on this node panicked")
                .hint("this is a bug in lightharmony, not a mistake in the graph; please report it");
            let _ = self.sender.send(otherwise(error));
        }
    }
}

/// The result of a node, computed by its code or by another process.
pub(crate) struct Finished {
    pub record: Record,
    /// One value per output; empty if another process computed them.
    pub values: Vec<AnyArtifact>,
    /// Work done in this run.
    pub effort: Effort,
    /// True if the code ran here.
    pub ran: bool,
}

/// For each output file of a sink: its path, and true if the file was written or false if it was already up to
/// date.
pub(crate) type Placed = Vec<(PathBuf, bool)>;

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn a_thread_that_panics_sends_what_it_owes() {
        let (sender, receiver) = channel();
        let stored = |error: NodeError| Message::Stored { node: 1, error: Some(error.to_string()) };
        let panicked = catch_unwind(AssertUnwindSafe(|| {
            let _owed = Owed::new(&sender, stored);
            panic!("after the code of the node");
        }));
        assert!(panicked.is_err());
        let message = receiver.try_recv();
        assert!(
            matches!(message, Ok(Message::Stored { node: 1, error: Some(text) }) if text.contains("panicked"))
        );
        Owed::new(&sender, stored).send(Message::Stored { node: 2, error: None });
        Owed::new(&sender, stored).cancel();
        assert!(matches!(receiver.try_recv(), Ok(Message::Stored { node: 2, error: None })));
        assert!(receiver.try_recv().is_err(), "one message each");
    }
}
