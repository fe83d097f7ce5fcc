//! Delays the handling of changes until shortly after the last change, but at most for a limited time after the
//! first.

use std::time::{Duration, Instant};

/// Collects notifications until the files should be inspected.
#[derive(Debug)]
pub(crate) struct Settling {
    settle: Duration,
    longest: Duration,
    /// Time of the first notification, and the time at which the files are to be inspected if no further
    /// notifications follow.
    pending: Option<(Instant, Instant)>,
}

impl Settling {
    /// Creates the state. The files are to be inspected `settle` after the last notification, and at most `longest`
    /// after the first.
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

    /// Time of the inspection.
    pub fn due(&self) -> Option<Instant> {
        self.pending.map(|(_, due)| due)
    }

    /// Returns true once when the time of the inspection has come. Afterwards no inspection is pending.
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
