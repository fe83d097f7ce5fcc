//! Repetition of calls that failed temporarily.

use std::time::Duration;

use cache::Digest;

/// Time limits of calls, the number of attempts, and the pauses between attempts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Retry {
    /// Maximum number of attempts.
    pub attempts: u32,
    /// Pause after the first attempt. The pause doubles after each further attempt.
    pub pause: Duration,
    /// Maximum pause.
    pub longest_pause: Duration,
    /// Time limit of an attempt, without the time to send or receive its bytes.
    pub limit: Duration,
    /// Minimum speed of a usable connection in bytes per second. The time limit of an attempt increases by the time
    /// that its bytes take at this speed.
    pub speed: u64,
}

impl Default for Retry {
    fn default() -> Self {
        Self {
            attempts: 4,
            pause: Duration::from_millis(100),
            longest_pause: Duration::from_secs(2),
            limit: Duration::from_secs(10),
            speed: 64 << 10,
        }
    }
}

impl Retry {
    /// The pause after attempt number `attempt`, counted from 0. It is shortened by up to half, depending on
    /// `what`, so that many clients do not repeat their calls at the same time. Equal arguments give equal pauses.
    pub fn pause_after(&self, attempt: u32, what: &str) -> Duration {
        let whole = self.pause.saturating_mul(1 << attempt.min(16)).min(self.longest_pause);
        let digest = Digest::of(format!("{what}\n{attempt}").as_bytes());
        let [a, b, ..] = *digest.as_bytes();
        whole / 2 + whole.mul_f64(f64::from(u16::from_le_bytes([a, b])) / f64::from(u16::MAX) / 2.0)
    }

    /// The time limit of an attempt that sends or receives this number of bytes.
    pub fn limit_for(&self, bytes: u64) -> Duration {
        self.limit + Duration::from_millis(bytes.saturating_mul(1000) / self.speed.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_are_limited_and_differ_between_calls() {
        let retry = Retry::default();
        let pauses = |what: &str| -> Vec<Duration> { (0..9).map(|n| retry.pause_after(n, what)).collect() };
        for (n, pause) in pauses("a").into_iter().enumerate() {
            let whole = Duration::from_millis(100 << n).min(retry.longest_pause);
            assert!(pause >= whole / 2 && pause <= whole, "{n}: {pause:?}");
        }
        assert_eq!(pauses("a"), pauses("a"));
        assert!(pauses("a").iter().zip(pauses("b")).all(|(a, b)| *a != b));
        assert!(retry.pause_after(u32::MAX, "a") <= retry.longest_pause);
        assert_eq!(retry.limit_for(64 << 20), Duration::from_secs(10 + 1024));
        assert!(retry.limit_for(u64::MAX) > retry.limit);
    }
}
