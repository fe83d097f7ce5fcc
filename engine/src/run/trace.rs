//! Traces: the work of each thread over time.

use std::sync::mpsc::Sender;
use std::time::Instant;

use crate::run::event::Event;
use crate::run::message::Message;
use crate::run::workers::thread_number;

/// Measures how long threads work, and sends each measurement as an [`Event::Span`]. Does nothing if tracing is
/// off.
#[derive(Clone)]
pub(crate) struct Tracer {
    start: Instant,
    sender: Option<Sender<Message>>,
}

impl Tracer {
    /// A tracer with times relative to `start`.
    pub fn new(start: Instant, sender: Option<Sender<Message>>) -> Self {
        Self { start, sender }
    }

    /// Runs `code`, which does work for the node `id`, and sends an event with its duration.
    pub fn span<T>(&self, id: &str, what: &str, code: impl FnOnce() -> T) -> T {
        if self.sender.is_none() {
            return code();
        }
        let begin = Instant::now();
        let result = code();
        self.record(id, what, begin.elapsed().as_secs_f64());
        result
    }

    /// Sends an event for work that took `seconds` and has just ended.
    pub fn record(&self, id: &str, what: &str, seconds: f64) {
        let Some(sender) = &self.sender else { return };
        let event = Event::Span {
            id: id.to_owned(),
            what: what.to_owned(),
            thread: thread_number(),
            start: (self.start.elapsed().as_secs_f64() - seconds).max(0.0),
            seconds,
        };
        // The scheduler outlives every job, so sending cannot fail.
        let _ = sender.send(Message::Event(event));
    }
}
