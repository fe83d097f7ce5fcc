//! [`Deadline`]: stops a run at a given time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Instant;

/// Stops a run at a given time, unless the deadline is dropped before that time.
pub(crate) struct Deadline {
    end: Option<Sender<()>>,
    thread: Option<JoinHandle<bool>>,
}

impl Deadline {
    /// Creates a deadline that sets `cancel` at the given time.
    pub fn at(time: Instant, cancel: Arc<AtomicBool>) -> Self {
        let (end, ended) = channel();
        let wait = move || {
            let left = time.saturating_duration_since(Instant::now());
            let over = ended.recv_timeout(left) == Err(RecvTimeoutError::Timeout);
            // An interruption by the user does not count.
            over && !cancel.swap(true, Ordering::Relaxed)
        };
        Self { end: Some(end), thread: Some(std::thread::spawn(wait)) }
    }

    /// Cancels the deadline. Returns true if the deadline had already stopped the run.
    pub fn end(mut self) -> bool {
        drop(self.end.take());
        self.thread.take().is_some_and(|thread| thread.join().unwrap_or(false))
    }
}

impl Drop for Deadline {
    fn drop(&mut self) {
        drop(self.end.take());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn it_stops_a_run_that_is_too_long_and_no_other() {
        let cancel = Arc::new(AtomicBool::new(false));
        let soon = Deadline::at(Instant::now() + Duration::from_secs(3600), cancel.clone());
        assert!(!soon.end() && !cancel.load(Ordering::Relaxed));
        let over = Deadline::at(Instant::now(), cancel.clone());
        while !cancel.load(Ordering::Relaxed) {
            std::thread::yield_now();
        }
        assert!(over.end());
        let by_the_user = Deadline::at(Instant::now(), cancel);
        std::thread::sleep(Duration::from_millis(20));
        assert!(!by_the_user.end(), "it was asked for before");
    }
}
