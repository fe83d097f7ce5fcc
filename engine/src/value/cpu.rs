//! CPU time per node. The times remain correct if a thread runs tiles of another node while it waits.

use std::cell::Cell;
use std::time::Duration;

thread_local! {
    /// Total CPU time of the measurements on this thread that are nested in the current measurement.
    static INSIDE: Cell<Duration> = const { Cell::new(Duration::ZERO) };
}

/// Runs code and returns the CPU time that this thread spent on it. A thread that waits for its tiles may run tiles
/// of another node, which are measured separately. The time of such nested measurements is subtracted.
pub(crate) fn measured<T>(code: impl FnOnce() -> T) -> (T, Duration) {
    let (outer, start) = (INSIDE.take(), of_thread());
    let value = code();
    let all = of_thread().saturating_sub(start);
    let inside = INSIDE.replace(outer + all);
    (value, all.saturating_sub(inside))
}

/// CPU time of all threads of this process so far.
pub(crate) fn of_process() -> Duration {
    clock::of(clock::PROCESS)
}

fn of_thread() -> Duration {
    clock::of(clock::THREAD)
}

#[cfg(unix)]
mod clock {
    use std::time::Duration;

    use rustix::time::{ClockId, clock_gettime};

    pub const PROCESS: ClockId = ClockId::ProcessCPUTime;
    pub const THREAD: ClockId = ClockId::ThreadCPUTime;

    pub fn of(id: ClockId) -> Duration {
        Duration::try_from(clock_gettime(id)).unwrap_or_default()
    }
}

/// Replacement on systems that do not report CPU time: all times are 0.
#[cfg(not(unix))]
mod clock {
    use std::time::Duration;

    pub const PROCESS: () = ();
    pub const THREAD: () = ();

    pub fn of((): ()) -> Duration {
        Duration::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spin(time: Duration) {
        let start = of_thread();
        while of_thread() - start < time {
            std::hint::black_box(0);
        }
    }

    // These relations hold however busy the machine is.
    #[cfg(unix)]
    #[test]
    fn what_is_measured_inside_counts_there_alone() {
        let ([short, long], start) = ([2, 20].map(Duration::from_millis), of_thread());
        let (((), inside), outside) = measured(|| {
            spin(short);
            measured(|| spin(long))
        });
        let all = of_thread() - start;
        assert!(inside >= long && outside >= short, "{inside:?} {outside:?}");
        assert!(inside + outside <= all, "nothing counts twice: {inside:?} {outside:?} {all:?}");
        let (_, after) = measured(|| spin(short));
        assert!(after >= short && after <= of_process());
    }
}
