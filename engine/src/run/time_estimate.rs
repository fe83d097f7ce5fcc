//! The expected time of a node, from its kind, its work and earlier runs.

use std::time::{Duration, Instant};

/// A node is short if its forecast in seconds is below this. Short nodes do not wait for other nodes to end.
const SHORT: f64 = 1.0;
/// Time after which a node without a forecast counts as long.
const TRIAL: Duration = Duration::from_secs(1);
/// A node is much shorter than another if the other node is expected to take at least this many times as long.
const MUCH_SHORTER: f64 = 10.0;

/// The expected time of a node.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct TimeEstimate {
    /// Name of the node's kind.
    pub kind: &'static str,
    /// Work in the units of the kind.
    pub work: f64,
    /// Forecast in seconds; `None` if no node of the kind has run.
    pub seconds: Option<f64>,
}

/// A node that runs, with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Running {
    pub time: TimeEstimate,
    /// Start of the code.
    pub since: Instant,
}

impl TimeEstimate {
    /// True if the forecast is below [`SHORT`].
    pub fn is_short(&self) -> bool {
        self.seconds.is_some_and(|seconds| seconds < SHORT)
    }

    /// True if a node with this estimate may start in addition to `running`, which is as many nodes as there are
    /// threads, or more.
    ///
    /// - A short node may, if no other short node runs.
    /// - A node with a longer forecast may, if each running node is expected to run much longer than it.
    /// - A node without a forecast may, if no other node without a forecast has started within the time [`TRIAL`],
    ///   and if no node of its kind runs, unless with much more work. So each kind is tried for a short time, and
    ///   the other nodes of the kind wait until their time is known.
    pub fn may_join<'r>(&self, mut running: impl Iterator<Item = &'r Running>, now: Instant) -> bool {
        match self.seconds {
            Some(seconds) if seconds < SHORT => running.all(|other| !other.time.is_short()),
            Some(seconds) => running.all(|other| other.remaining(now) >= MUCH_SHORTER * seconds),
            None => running.all(|other| {
                let is_known = other.time.kind != self.kind || other.time.work >= MUCH_SHORTER * self.work;
                is_known && !other.is_on_trial(now)
            }),
        }
    }
}

impl Running {
    fn elapsed(&self, now: Instant) -> Duration {
        now.saturating_duration_since(self.since)
    }

    /// True for a short time after the start of a node without a forecast.
    fn is_on_trial(&self, now: Instant) -> bool {
        self.time.seconds.is_none() && self.elapsed(now) < TRIAL
    }

    /// Expected time in seconds until the node ends. A node that has no forecast, or that runs longer than its
    /// forecast, is expected to run as long as it has run so far.
    fn remaining(&self, now: Instant) -> f64 {
        let elapsed = self.elapsed(now).as_secs_f64();
        self.time.seconds.map(|seconds| seconds - elapsed).filter(|left| *left > 0.0).unwrap_or(elapsed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(kind: &'static str, work: f64, seconds: Option<f64>) -> TimeEstimate {
        TimeEstimate { kind, work, seconds }
    }

    /// A long node may join nodes that still take ten times as long, and this changes with time.
    #[test]
    fn the_remaining_time_counts() {
        let since = Instant::now();
        let after = |seconds| since + Duration::from_secs(seconds);
        let two = [Some(100.0), None].map(|seconds| Running { time: estimate("trace", 1.0, seconds), since });
        let may = |seconds, now| estimate("fuse", 1.0, Some(seconds)).may_join(two.iter(), after(now));
        assert!(!may(5.0, 0), "nothing is known of the second node");
        assert!(may(5.0, 50) && !may(5.1, 50), "both take 50 s more");
        assert!(!may(5.0, 99), "the first takes 1 s more");
        assert!(may(5.0, 200), "both take longer than the forecast");
    }

    /// One node of a kind without a forecast is tried at a time, and one kind per second.
    #[test]
    fn kinds_are_tried_one_by_one() {
        let since = Instant::now();
        let running = [Running { time: estimate("trace", 100.0, None), since }];
        let may = |kind, work, millis| {
            estimate(kind, work, None).may_join(running.iter(), since + Duration::from_millis(millis))
        };
        assert!(!may("score", 1.0, 999) && may("score", 1.0, 1000));
        assert!(
            !may("trace", 100.0, 5000) && !may("trace", 11.0, 5000),
            "the running node will show the pace"
        );
        assert!(may("trace", 10.0, 5000), "with much less work");
    }
}
