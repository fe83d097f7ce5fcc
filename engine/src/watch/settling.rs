//! Decides when changed files are inspected: shortly after the last change, but at most a limited time after the
//! first.

use std::time::{Duration, Instant};

/// Collects notifications until the files are due for an inspection.
#[derive(Debug)]
pub(crate) struct Settling {
    settle: Duration,
    longest: Duration,
    /// Time of the first notification, and the time at which the files are to be inspected if no further
    /// notifications follow.
    pending: Option<(Instant, Instant)>,
}

impl Settling {
    /// Creates a state without a pending inspection. The files are to be inspected `settle` after the last
    /// notification, and at most `longest` after the first.
    pub fn new(settle: Duration, longest: Duration) -> Self {
        Self { settle, longest, pending: None }
    }

    /// Handles a notification.
    pub fn hint(&mut self, now: Instant) {
        self.wait(now, self.settle);
    }

    /// Postpones the inspection by `patience`, since a file may be incomplete.
    pub fn wait(&mut self, now: Instant, patience: Duration) {
        let first = self.pending.map_or(now, |(first, _)| first);
        let latest = first + self.longest.max(patience);
        self.pending = Some((first, (now + patience).min(latest)));
    }

    /// Time at which the files are to be inspected; `None` if no inspection is pending.
    pub fn due(&self) -> Option<Instant> {
        self.pending.map(|(_, due)| due)
    }

    /// Returns true if the inspection is due, and clears it, so that later calls return false until there is
    /// another notification.
    pub fn take(&mut self, now: Instant) -> bool {
        let come = self.due().is_some_and(|due| due <= now);
        if come {
            self.pending = None;
        }
        come
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn several_changes_are_one_look() {
        let (start, mut settling) = (Instant::now(), Settling::new(30 * MS, 200 * MS));
        assert!(settling.due().is_none() && !settling.take(start));
        settling.hint(start);
        settling.hint(start + 20 * MS);
        assert!(!settling.take(start + 30 * MS));
        assert!(settling.take(start + 50 * MS));
        assert!(!settling.take(start + 51 * MS), "and that once");
    }

    #[test]
    fn changes_without_end_do_not_delay_without_end() {
        let (start, mut settling) = (Instant::now(), Settling::new(30 * MS, 200 * MS));
        let looks = (0..100).filter(|step| {
            let now = start + 10 * MS * *step;
            settling.hint(now);
            settling.take(now)
        });
        assert_eq!(looks.count(), 4, "a second of a hint every 10 ms");
    }
}
