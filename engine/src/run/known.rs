//! The keys of the nodes that ran or are running, and forecasts from earlier runs of each kind.

use std::collections::{BTreeMap, HashMap};

use cache::{Digest, Store};

use crate::kind::registry::KindEntry;
use crate::record::pace::Pace;
use crate::run::slot::{Life, Slot};

/// The keys of a run.
pub(crate) struct Known {
    /// Name of the history that holds the keys of the graph's nodes.
    history: String,
    /// For each key whose result was computed in this run, the node that computed it. This table is searched before
    /// the store, which may lack some results.
    made: HashMap<Digest, usize>,
    /// Keys whose results are being computed, with the nodes that wait for each.
    in_flight: HashMap<Digest, Vec<usize>>,
    paces: BTreeMap<&'static str, Pace>,
}

impl Known {
    /// An empty table of keys.
    pub fn new(history: String) -> Self {
        let (made, in_flight, paces) = (HashMap::new(), HashMap::new(), BTreeMap::new());
        Self { history, made, in_flight, paces }
    }

    /// Name of the history that holds the keys of the graph's nodes.
    pub fn history(&self) -> &str {
        &self.history
    }

    /// The node of this run that computed the result of a key.
    pub fn made_by(&self, key: &Digest) -> Option<usize> {
        self.made.get(key).copied()
    }

    /// Records that a node computed the result of a key.
    pub fn set_made(&mut self, key: Digest, index: usize) {
        self.made.insert(key, index);
    }

    /// Makes a node wait for the result of `key`, which is its own key. Returns false if the result is not being
    /// computed.
    pub fn follow(&mut self, key: &Digest, index: usize) -> bool {
        let followers = self.in_flight.get_mut(key);
        followers.map(|followers| followers.push(index)).is_some()
    }

    /// Records that the result of a key is being computed.
    pub fn begin(&mut self, key: Digest) {
        self.in_flight.insert(key, Vec::new());
    }

    /// Records that the computation of a key ended, and returns the nodes that waited for it.
    pub fn end(&mut self, key: &Digest) -> Vec<usize> {
        self.in_flight.remove(key).unwrap_or_default()
    }

    /// Forecast of the time in seconds that a node of this kind takes for `work`. `None` if the kind has never run.
    pub fn seconds(&mut self, store: &Store, kind: &KindEntry, work: f64) -> Option<f64> {
        self.paces.entry(kind.name).or_insert_with(|| Pace::of(store, kind)).seconds(work)
    }

    /// Records that a node of this kind took `seconds` for `work`. Forecasts from now on use it.
    pub fn learn(&mut self, kind: &KindEntry, work: f64, seconds: f64) {
        if let Some(pace) = self.paces.get_mut(kind.name) {
            pace.add(work, seconds);
        }
    }

    /// Checks, in debug builds only, that the keys agree with the slots.
    pub fn check(&self, slots: &[Slot]) {
        let leading = slots.iter().filter(|slot| slot.leads());
        let mut keys = 0;
        for key in leading.filter_map(|slot| slot.key) {
            let followers = self
                .in_flight
                .get(&key)
                .map(Vec::as_slice)
                .expect("every key that is being computed must be listed");
            for &follower in followers {
                let follower = &slots[follower];
                assert!(
                    follower.life == Life::Following && follower.key == Some(key),
                    "a node that waits for another node must have the same key"
                );
            }
            keys += 1;
        }
        assert_eq!(self.in_flight.len(), keys, "every listed key must have a node that computes it");
    }
}
