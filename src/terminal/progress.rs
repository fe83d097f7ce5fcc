//! Progress of a run and the remaining time.

use std::collections::BTreeMap;

use engine::{Fate, Forecast, Planned};

use super::words::seconds_text;

/// A node whose code runs.
#[derive(Debug)]
struct Running {
    /// Time at which the node started.
    begin: f64,
    forecast: Option<f64>,
    /// Progress, from 0 to 1.
    fraction: f64,
    /// The stage of a node that a worker computes; otherwise empty.
    stage: String,
}

impl Running {
    /// Remaining time in seconds at time `now`; `None` if there is neither a forecast nor progress.
    ///
    /// The estimate moves from the forecast to the measured pace as the node progresses.
    fn left(&self, now: f64) -> Option<f64> {
        let elapsed = (now - self.begin).max(0.0);
        let paced = (self.fraction > 0.01).then(|| elapsed / self.fraction);
        let whole = match (self.forecast, paced) {
            (Some(forecast), Some(paced)) => {
                let weight = (4.0 * self.fraction).min(1.0);
                forecast + weight * (paced - forecast)
            }
            (forecast, paced) => paced.or(forecast)?,
        };
        Some(if paced.is_some() { whole * (1.0 - self.fraction) } else { (whole - elapsed).max(0.0) })
    }
}

/// Progress of a run and the remaining time. All times are in seconds and are read from the same clock.
#[derive(Debug, Default)]
pub struct Progress {
    /// Forecasts of the nodes that may run and have not started, by name; empty if only the totals of the plan are
    /// known.
    planned: BTreeMap<String, Option<f64>>,
    /// Sum of the forecasts of the nodes that have not started.
    waiting: f64,
    /// Number of nodes that have not started and have no forecast.
    unknown: usize,
    running: BTreeMap<String, Running>,
    /// Number of nodes that may run.
    open: usize,
    /// Number of nodes that are done, of the nodes counted by `open`.
    done: usize,
    /// Time at which the run started.
    begin: f64,
}

impl Progress {
    /// The progress of a run with a plan.
    pub fn planned(plan: &[Planned], now: f64) -> Self {
        let open = plan.iter().filter(|node| !matches!(node.fate, Fate::Known | Fate::Unwanted));
        let planned = open.map(|node| (node.id.clone(), node.forecast)).collect();
        Self { planned, ..Self::forecast(&Forecast::of(plan), now) }
    }

    /// The progress of a run for which only the totals of a plan are known.
    pub fn forecast(forecast: &Forecast, now: f64) -> Self {
        let Forecast { open, seconds, untimed, .. } = *forecast;
        Self { waiting: seconds, unknown: untimed, open, begin: now, ..Self::default() }
    }

    /// Records that the code of a node starts.
    pub fn start(&mut self, id: &str, forecast: Option<f64>, now: f64) {
        self.not_waiting(id, forecast);
        self.running
            .insert(id.to_owned(), Running { begin: now, forecast, fraction: 0.0, stage: String::new() });
    }

    /// Records the stage of a node that a worker computes.
    pub fn stage(&mut self, id: &str, stage: String) {
        if let Some(node) = self.running.get_mut(id) {
            node.stage = stage;
        }
    }

    /// Records the progress of a running node.
    pub fn advance(&mut self, id: &str, fraction: f32) {
        if let Some(node) = self.running.get_mut(id) {
            node.fraction = f64::from(fraction).clamp(node.fraction, 1.0);
        }
    }

    /// Records that a node is done, whether or not its code ran.
    pub fn end(&mut self, id: &str) {
        let ran = self.running.remove(id).is_some();
        if ran || self.planned.contains_key(id) {
            self.done += 1;
        }
        // The node was planned to run, but its result was known after all, or it was skipped.
        if !ran && let Some(forecast) = self.planned.get(id).copied() {
            self.not_waiting(id, forecast);
        }
    }

    fn not_waiting(&mut self, id: &str, forecast: Option<f64>) {
        match self.planned.remove(id).unwrap_or(forecast) {
            Some(seconds) => self.waiting = (self.waiting - seconds).max(0.0),
            None => self.unknown = self.unknown.saturating_sub(1),
        }
    }

    /// Remaining time in seconds, and the number of nodes without a forecast. The time does not include these
    /// nodes.
    fn left(&self, now: f64) -> (f64, usize) {
        let left = self.running.values().map(|node| node.left(now));
        left.fold((self.waiting, self.unknown), |(sum, unknown), left| match left {
            Some(seconds) => (sum + seconds, unknown),
            None => (sum, unknown + 1),
        })
    }

    /// Fraction of the run that is done, from 0 to 1. It is a fraction of the total time if all forecasts are
    /// known, otherwise a fraction of the number of nodes.
    pub fn fraction(&self, now: f64) -> f64 {
        let (elapsed, (left, unknown)) = ((now - self.begin).max(0.0), self.left(now));
        let of = if unknown == 0 && elapsed + left > 0.0 {
            elapsed / (elapsed + left)
        } else {
            let begun: f64 = self.running.values().map(|node| node.fraction).sum();
            (self.done as f64 + begun) / self.open.max(self.done + self.running.len()).max(1) as f64
        };
        of.clamp(0.0, 1.0)
    }

    /// Formats the state of the bar: `3 of 12 nodes, trace 45 %, about 12 s left`.
    pub fn text(&self, now: f64) -> String {
        const MOST: usize = 2;
        let mut parts =
            vec![format!("{} of {} nodes", self.done, self.open.max(self.done + self.running.len()))];
        let running = |(id, node): (&String, &Running)| match node.fraction {
            f if f > 0.0 => format!("{id} {:.0} %", 100.0 * f),
            _ if !node.stage.is_empty() => format!("{id} {}", node.stage),
            _ => id.clone(),
        };
        parts.extend(self.running.iter().take(MOST).map(running));
        if self.running.len() > MOST {
            parts.push(format!("{} more", self.running.len() - MOST));
        }
        let (left, unknown) = self.left(now);
        parts.push(match (left >= 0.5, unknown) {
            (false, 0) => "nearly done".to_owned(),
            (true, 0) => format!("about {} left", seconds_text(left)),
            (false, _) => "time left unknown".to_owned(),
            (true, _) => format!("at least {} left", seconds_text(left)),
        });
        parts.join(", ")
    }

    /// True if the code of a node is running.
    pub fn is_running(&self) -> bool {
        !self.running.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planned(nodes: &[(&str, Option<f64>)]) -> Progress {
        let node = |(id, forecast): &(&str, Option<f64>)| Planned {
            id: (*id).to_owned(),
            kind: "path-trace",
            fate: Fate::Lost,
            forecast: *forecast,
            manifest: None,
        };
        Progress::planned(&nodes.iter().map(node).collect::<Vec<_>>(), 0.0)
    }

    // A forecast of 47 s for a node that takes 6 s loses its weight as the node progresses. This test fails if
    // `weight` is 0.
    #[test]
    fn the_forecast_follows_progress() {
        let mut run = planned(&[("a", Some(47.0)), ("b", Some(2.0))]);
        assert_eq!(run.left(0.0), (49.0, 0));
        run.start("a", Some(47.0), 0.0);
        run.advance("a", 0.1);
        let (early, _) = run.left(0.6);
        run.advance("a", 0.5);
        let (late, _) = run.left(3.0);
        assert!(early < 35.0 && (late - 5.0).abs() < 1e-9, "{early} {late}");
        assert!((run.fraction(3.0) - 3.0 / 8.0).abs() < 1e-9);
        assert_eq!(run.text(3.0), "0 of 2 nodes, a 50 %, about 5.00 s left");
        run.end("a");
        run.end("b");
        assert_eq!((run.left(6.0), run.done), ((0.0, 0), 2), "b came out as known");
        assert_eq!(run.fraction(6.0), 1.0);
    }

    #[test]
    fn what_was_never_timed_is_not_counted_as_nothing() {
        let mut run = planned(&[("a", None), ("b", Some(2.0)), ("c", None)]);
        assert_eq!(run.text(0.0), "0 of 3 nodes, at least 2.00 s left");
        run.start("a", None, 0.0);
        assert_eq!(run.left(1.0), (2.0, 2));
        run.advance("a", 0.25);
        assert_eq!(run.left(1.0), (5.0, 1), "three times as long as so far");
        assert!((run.fraction(1.0) - 0.25 / 3.0).abs() < 1e-9, "by nodes");
        run.end("a");
        run.end("nobody");
        assert_eq!((run.left(4.0), run.done), ((2.0, 1), 1));
    }

    // For a run in `watch`, only the totals are known.
    #[test]
    fn sums_are_enough() {
        let forecast = Forecast { open: 2, wanted: 9, seconds: 3.0, untimed: 1 };
        let mut run = Progress::forecast(&forecast, 10.0);
        run.start("a", Some(3.0), 10.0);
        run.start("b", None, 10.0);
        assert_eq!(run.left(11.0), (2.0, 1));
        run.end("a");
        run.end("b");
        assert_eq!((run.left(12.0), run.done), ((0.0, 0), 2));
    }
}
