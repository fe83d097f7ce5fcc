//! The threads of a run. They start when there is work for them and end with the run.
//!
//! Small nodes may run in addition to as many nodes as threads are permitted. Files are digested, loaded and
//! written on additional threads, so that these small tasks never wait for large tasks.

use std::cell::Cell;
use std::collections::VecDeque;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::Scope;

use crate::kind::tiles::Threads;

/// Work for a thread, which sends its result in a message.
pub(crate) type Work<'a> = Box<dyn FnOnce() + Send + 'a>;

thread_local! {
    static NUMBER: Cell<usize> = const { Cell::new(0) };
}

/// Number of the calling thread within its run, for traces.
pub(crate) fn thread_number() -> usize {
    NUMBER.get()
}

/// The threads of a run, and the work that waits for a thread.
pub(crate) struct Workers<'a> {
    threads: &'a Threads,
    /// Maximum number of threads.
    most: usize,
    queue: Mutex<Queue<'a>>,
    changed: Condvar,
}

#[derive(Default)]
struct Queue<'a> {
    /// Queued code of nodes, which has priority over other work.
    code: VecDeque<Work<'a>>,
    other: VecDeque<Work<'a>>,
    started: usize,
    idle: usize,
    closed: bool,
}

impl Queue<'_> {
    fn waiting(&self) -> usize {
        self.code.len() + self.other.len()
    }
}

impl<'a> Workers<'a> {
    /// At most `most` threads.
    pub fn new(threads: &'a Threads, most: usize) -> Self {
        Self { threads, most, queue: Mutex::default(), changed: Condvar::new() }
    }

    fn queue(&self) -> MutexGuard<'_, Queue<'a>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Passes work to a thread, and starts a thread if none is idle.
    ///
    /// # Errors
    /// If not even one thread can be started. The work is then not done.
    pub fn hand<'s>(&'s self, scope: &'s Scope<'s, '_>, is_code: bool, work: Work<'a>) -> io::Result<()> {
        let mut queue = self.queue();
        if queue.waiting() >= queue.idle && queue.started < self.most {
            let number = queue.started;
            let builder = std::thread::Builder::new().name(format!("node-{number}"));
            match builder.spawn_scoped(scope, move || self.work(number)) {
                Ok(_) => queue.started += 1,
                // The existing threads do the work.
                Err(_) if number > 0 => {}
                Err(error) => return Err(error),
            }
        }
        if is_code {
            queue.code.push_back(work);
        } else {
            queue.other.push_back(work);
        }
        drop(queue);
        self.changed.notify_one();
        Ok(())
    }

    fn work(&self, number: usize) {
        NUMBER.set(number);
        let mut queue = self.queue();
        loop {
            if let Some(work) = queue.code.pop_front().or_else(|| queue.other.pop_front()) {
                drop(queue);
                // Work that panics sends the messages that it owes. The thread continues.
                let _ = catch_unwind(AssertUnwindSafe(|| self.threads.occupied(work)));
                queue = self.queue();
            } else if queue.closed {
                return;
            } else {
                queue.idle += 1;
                queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
                queue.idle -= 1;
            }
        }
    }

    /// Returns a guard. When it is dropped, the threads end after all work is done.
    pub fn closing(&self) -> Closing<'_, 'a> {
        Closing(self)
    }
}

/// Ends the threads of a run when dropped, even if the scheduler panics.
pub(crate) struct Closing<'w, 'a>(&'w Workers<'a>);

impl Drop for Closing<'_, '_> {
    fn drop(&mut self) {
        self.0.queue().closed = true;
        self.0.changed.notify_all();
    }
}
