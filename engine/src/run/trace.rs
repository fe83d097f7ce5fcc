//! Traces: the work of each thread over time. Progress of nodes.

use std::sync::mpsc::Sender;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::graph::node::Node;
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

/// Shortest time between two reports of a node's progress.
const REPORT_EVERY: Duration = Duration::from_millis(50);

/// Sends the progress of `node` as events, at most one per [`REPORT_EVERY`] until the node is done.
pub(crate) fn progress(node: &Node, sender: Sender<Message>) -> Box<dyn Fn(f32) + Send + Sync> {
    let (id, sender, last) = (node.id.clone(), Mutex::new(sender), Mutex::new(Instant::now()));
    Box::new(move |fraction| {
        let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
        if fraction >= 1.0 || last.elapsed() > REPORT_EVERY {
            *last = Instant::now();
            let sender = sender.lock().unwrap_or_else(PoisonError::into_inner);
            let _ = sender.send(Message::Event(Event::Progress { id: id.clone(), fraction }));
        }
    })
}
