//! CPU time: what threads spend on a node, whatever else they take over while they wait for it.

use std::cell::Cell;
use std::time::Duration;

thread_local! {
    /// What measured code inside of the code that this thread measures now has spent.
    static INSIDE: Cell<Duration> = const { Cell::new(Duration::ZERO) };
}

/// Runs code and tells the CPU time that this thread spent on it. A thread that waits for tiles may run those of another
/// node; what is measured inside counts there alone.
pub(crate) fn measured<T>(code: impl FnOnce() -> T) -> (T, Duration) {
    let (beside, start) = (INSIDE.take(), of_thread());
    let value = code();
    let all = of_thread().saturating_sub(start);
    let inside = INSIDE.replace(beside + all);
    (value, all.saturating_sub(inside))
}

/// CPU time of all threads of this process so far.
pub(crate) fn of_process() -> Duration {
    clock(rustix::time::ClockId::ProcessCPUTime)
}

fn of_thread() -> Duration {
    clock(rustix::time::ClockId::ThreadCPUTime)
}

fn clock(id: rustix::time::ClockId) -> Duration {
    Duration::try_from(rustix::time::clock_gettime(id)).unwrap_or_default()
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

    // Bounds from below hold however busy the machine is, and a clock of CPU time stands still where a thread waits.
    #[test]
    fn what_is_measured_inside_counts_there_alone() {
        let [short, long] = [2, 20].map(Duration::from_millis);
        let (((), inside), outside) = measured(|| {
            spin(short);
            let inside = measured(|| spin(long));
            std::thread::sleep(long);
            inside
        });
        assert!(inside >= long && outside >= short, "{inside:?} {outside:?}");
        assert!(outside < long, "{outside:?}");
        let (_, after) = measured(|| spin(short));
        assert!(after >= short && after <= of_process());
    }
}
