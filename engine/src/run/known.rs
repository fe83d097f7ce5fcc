//! What is known of keys: what this run made and is making, and how long kinds took.

use std::collections::{BTreeMap, HashMap};

use cache::{Digest, Store};

use crate::kind::registry::KindEntry;
use crate::record::pace::Pace;
use crate::run::slot::{Life, Slot};

/// See the [module](self).
pub(crate) struct Known {
    /// Name of the history in which the keys of the graph's nodes are remembered.
    history: String,
    /// Nodes whose code ran in this run, by key: asked before the store, which may not keep everything.
    made: HashMap<Digest, usize>,
    /// Keys that are being computed, each with the nodes that wait for it to follow.
    in_flight: HashMap<Digest, Vec<usize>>,
    paces: BTreeMap<&'static str, Pace>,
}

impl Known {
    /// Nothing but the name of the history.
    pub fn new(history: String) -> Self {
        let (made, in_flight, paces) = (HashMap::new(), HashMap::new(), BTreeMap::new());
        Self { history, made, in_flight, paces }
    }

    /// Name of the history in which the keys of the graph's nodes are remembered.
    pub fn history(&self) -> &str {
        &self.history
    }

    /// The node of this run whose code made this key.
    pub fn made_by(&self, key: &Digest) -> Option<usize> {
        self.made.get(key).copied()
    }

    /// The code of a node made this key.
    pub fn set_made(&mut self, key: Digest, index: usize) {
        self.made.insert(key, index);
    }

    /// Has a node wait for its key, where that is being computed. False where it is not.
    pub fn follow(&mut self, key: &Digest, index: usize) -> bool {
        let followers = self.in_flight.get_mut(key);
        followers.map(|followers| followers.push(index)).is_some()
    }

    /// A key is being computed from now on.
    pub fn begin(&mut self, key: Digest) {
        self.in_flight.insert(key, Vec::new());
    }

    /// A key is no longer being computed. Gives the nodes that wait for it.
    pub fn end(&mut self, key: &Digest) -> Vec<usize> {
        self.in_flight.remove(key).unwrap_or_default()
    }

    /// Seconds that this much work of a kind takes, by its earlier runs.
    pub fn seconds(&mut self, store: &Store, kind: &KindEntry, work: f64) -> Option<f64> {
        self.paces.entry(kind.name).or_insert_with(|| Pace::of(store, kind)).seconds(work)
    }

    /// Compares all of it with what the slots say; for debug builds.
    pub fn check(&self, slots: &[Slot]) {
        let leading = slots.iter().filter(|slot| slot.leads());
        let mut keys = 0;
        for key in leading.filter_map(|slot| slot.key) {
            let followers = self.in_flight.get(&key).map(Vec::as_slice).expect("what is computed is known");
            for &follower in followers {
                let follower = &slots[follower];
                assert!(follower.life == Life::Following && follower.key == Some(key), "nodes that follow");
            }
            keys += 1;
        }
        assert_eq!(self.in_flight.len(), keys, "keys that are being computed");
    }
}
