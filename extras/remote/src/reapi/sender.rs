//! Sending of inputs to a server: one thread at a time, with the speed of the connection.

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use bazel_remote_apis::build::bazel::remote::execution::v2 as api;

use super::call_error::CallError;
use super::shared_cache::SharedCache;
use super::worker_options::WorkerOptions;

/// The call, for messages.
pub(crate) const WHAT: &str = "sending a node";
/// Interval at which a thread that waits for another one checks whether the run was cancelled.
const LOOK: Duration = Duration::from_millis(5);
/// Transfers of fewer bytes say little about the speed of the connection.
const MEASURED_FROM: u64 = 1 << 20;

/// Sends the inputs of nodes to a server.
pub(crate) struct Sender {
    /// The server, and what it is known to hold.
    pub cache: Arc<SharedCache>,
    /// The options of the workers.
    pub options: WorkerOptions,
    /// Held while inputs are sent, so that the same input is not sent several times at once.
    sending: Mutex<()>,
    /// The place of the program, once it is known.
    program: Mutex<Option<api::Digest>>,
    /// Bytes and seconds of the large transfers so far.
    measured: Mutex<(u64, f64)>,
}

impl Sender {
    /// Sends to the server of `cache`.
    pub fn new(cache: Arc<SharedCache>, options: WorkerOptions) -> Self {
        let (sending, program, measured) = Default::default();
        Self { cache, options, sending, program, measured }
    }

    /// Records the time of a transfer to the server.
    pub fn measure(&self, bytes: u64, time: Duration) {
        if bytes >= MEASURED_FROM {
            let mut measured = self.measured.lock().unwrap_or_else(PoisonError::into_inner);
            *measured = (measured.0 + bytes, measured.1 + time.as_secs_f64());
        }
    }

    /// Measured speed of the connection in bytes per second; `None` before the first large transfer.
    pub fn speed(&self) -> Option<f64> {
        let (bytes, seconds) = *self.measured.lock().unwrap_or_else(PoisonError::into_inner);
        (seconds > 0.0).then(|| bytes as f64 / seconds)
    }

    /// The place of the program. The file is read once.
    pub fn program_place(&self, path: &Path) -> Result<api::Digest, CallError> {
        let mut known = self.program.lock().unwrap_or_else(PoisonError::into_inner);
        match &*known {
            Some(place) => Ok(place.clone()),
            None => {
                let place = self.cache.server().function.of_bytes(&read(path)?);
                Ok(known.insert(place).clone())
            }
        }
    }

    /// Waits until no other thread sends inputs.
    pub fn turn(&self, cancel: &AtomicBool) -> Result<MutexGuard<'_, ()>, CallError> {
        loop {
            match self.sending.try_lock() {
                Ok(guard) => return Ok(guard),
                Err(TryLockError::Poisoned(guard)) => return Ok(guard.into_inner()),
                Err(TryLockError::WouldBlock) if cancel.load(Ordering::Relaxed) => {
                    return Err(CallError::Cancelled);
                }
                Err(TryLockError::WouldBlock) => std::thread::sleep(LOOK),
            }
        }
    }
}

/// Reads a file that is to be sent.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, CallError> {
    let refused =
        |error| CallError::Refused { what: WHAT, why: format!("cannot read `{}`: {error}", path.display()) };
    fs::read(path).map_err(refused)
}

/// Measures a transfer.
pub(crate) fn timed<T>(transfer: impl FnOnce() -> T) -> (T, Duration) {
    let begin = Instant::now();
    (transfer(), begin.elapsed())
}
