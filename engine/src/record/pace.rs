//! Forecasts from the times of earlier runs of a kind.
//!
//! Work is in units of the kind ([`Kind::work`](crate::Kind::work)), so earlier runs apply to any node of the kind,
//! whatever its name, graph, sample count or image size.

use cache::Store;

use crate::kind::registry::KindEntry;

/// Name of the history that contains the runs of each kind.
const HISTORY: &str = "pace";
/// Number of runs kept for each kind.
const KEPT: usize = 16;
/// Length in bytes of the stored entry for one run.
const RUN: usize = 16;

/// Pairs (work, seconds) of the last runs of a kind, newest first.
pub(crate) struct Pace(Vec<(f64, f64)>);

impl Pace {
    /// The stored runs of this version of a kind.
    pub fn of(store: &Store, kind: &KindEntry) -> Self {
        let bytes = store.history_get(HISTORY, &name(kind)).unwrap_or_default();
        let number = |bytes: &[u8]| bytes.first_chunk().map_or(0.0, |raw| f64::from_le_bytes(*raw));
        let runs = bytes.as_chunks::<RUN>().0.iter().map(|run| (number(&run[..8]), number(&run[8..])));
        let sound = |(work, seconds): &(f64, f64)| *work > 0.0 && work.is_finite() && *seconds >= 0.0;
        Self(runs.filter(sound).collect())
    }

    /// Adds a run that took `seconds` for `work`.
    pub fn add(&mut self, work: f64, seconds: f64) {
        self.0.insert(0, (work.max(1.0), seconds));
        self.0.truncate(KEPT);
    }

    /// Stores a run of a kind that took `seconds` for `work`.
    pub fn learn(store: &Store, kind: &KindEntry, work: f64, seconds: f64) {
        let mut pace = Self::of(store, kind);
        pace.add(work, seconds);
        let bytes: Vec<u8> = pace
            .0
            .iter()
            .flat_map(|(work, seconds)| [work.to_le_bytes(), seconds.to_le_bytes()])
            .flatten()
            .collect();
        store.history_put(HISTORY, &name(kind), &bytes);
    }

    /// Forecast in seconds for this work. The time of the earlier run with the nearest work (by ratio) is scaled in
    /// proportion to the work; of equally near runs, the newest is used. `None` if the kind has never run.
    pub fn seconds(&self, work: f64) -> Option<f64> {
        let work = work.max(1.0);
        // The larger of both ratios orders like the distance of logarithms.
        let apart = |known: f64| (work / known).max(known / work);
        let nearest = self.0.iter().reduce(|best, run| if apart(run.0) < apart(best.0) { run } else { best });
        nearest.map(|(known, seconds)| seconds * (work / known)).filter(|seconds| seconds.is_finite())
    }
}

fn name(kind: &KindEntry) -> String {
    format!("{}\n{}\n{}", kind.name, kind.version, kind.profile)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_is_in_proportion_to_the_nearest_run() {
        let pace = Pace(vec![(100.0, 2.0), (100.0, 1.0), (10.0, 1.0), (1e6, 500.0)]);
        assert_eq!(pace.seconds(100.0), Some(2.0), "the newest of equal ones");
        assert_eq!(pace.seconds(400.0), Some(8.0));
        assert_eq!(pace.seconds(5.0), Some(0.5), "small work has a pace of its own");
        assert_eq!(pace.seconds(0.0), Some(0.1));
        assert_eq!(Pace(Vec::new()).seconds(1.0), None);
    }
}
