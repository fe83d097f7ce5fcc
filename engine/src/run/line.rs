//! Nodes that wait at the same stage.

use std::collections::{BTreeMap, BTreeSet};

use crate::run::time_estimate::TimeEstimate;

/// Position of a node in topological order, and its index.
pub(crate) type Position = (usize, usize);

/// Nodes that wait at the same stage, in topological order, and the same nodes by their expected time.
#[derive(Default)]
pub(crate) struct Line {
    all: BTreeSet<Position>,
    short: BTreeSet<Position>,
    /// Nodes with a forecast that are not short, sorted by forecast. The first number of an element increases with
    /// the forecast.
    long: BTreeSet<(u64, Position)>,
    /// Nodes without a forecast, by kind, and for each kind sorted by work. The first number of an element
    /// increases with the work.
    untimed: BTreeMap<&'static str, BTreeSet<(u64, Position)>>,
}

/// Maps a value to an integer that increases with the value. Values that are not positive are mapped to 0.
fn ordered(value: f64) -> u64 {
    value.max(0.0).to_bits()
}

impl Line {
    /// Adds a node.
    pub fn insert(&mut self, place: Position, time: &TimeEstimate) {
        self.all.insert(place);
        match time.seconds {
            Some(_) if time.is_short() => self.short.insert(place),
            Some(seconds) => self.long.insert((ordered(seconds), place)),
            None => self.untimed.entry(time.kind).or_default().insert((ordered(time.work), place)),
        };
    }

    /// Removes a node. Returns false if it did not wait here.
    pub fn remove(&mut self, place: Position, time: &TimeEstimate) -> bool {
        match time.seconds {
            Some(_) if time.is_short() => self.short.remove(&place),
            Some(seconds) => self.long.remove(&(ordered(seconds), place)),
            None => {
                let kind = self.untimed.entry(time.kind).or_default();
                let found = kind.remove(&(ordered(time.work), place));
                if kind.is_empty() {
                    self.untimed.remove(time.kind);
                }
                found
            }
        };
        self.all.remove(&place)
    }

    /// True if no node waits here.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// The first node in topological order.
    pub fn first(&self) -> Option<usize> {
        self.all.first().map(|place| place.1)
    }

    /// The first short node in topological order.
    pub fn first_short(&self) -> Option<usize> {
        self.short.first().map(|place| place.1)
    }

    /// The first node that may overtake the nodes before it, as decided by `may`. Short nodes come first, then the
    /// node with the least work of each kind without a forecast, then the node with the shortest forecast.
    pub fn first_small(&self, may: impl Fn(usize) -> bool) -> Option<usize> {
        let may = |place: &Position| may(place.1);
        let untimed = || {
            let least = self.untimed.values().filter_map(|kind| kind.first());
            least.map(|(_, place)| *place).filter(|place| may(place)).min()
        };
        let long = || self.long.first().map(|(_, place)| *place).filter(|place| may(place));
        let short = self.short.first().copied().filter(|place| may(place));
        short.or_else(untimed).or_else(long).map(|place| place.1)
    }

    /// The nodes of a kind that have no forecast.
    pub fn untimed(&self, kind: &str) -> impl Iterator<Item = usize> {
        self.untimed.get(kind).into_iter().flatten().map(|(_, place)| place.1)
    }

    /// Checks, in debug builds only, that the line consists of the nodes `wanted`. `time` returns the estimate of a
    /// node.
    pub fn check(&self, wanted: BTreeSet<Position>, time: impl Fn(usize) -> TimeEstimate) {
        let mut line = Self::default();
        wanted.iter().for_each(|place| line.insert(*place, &time(place.1)));
        assert_eq!(self.all, wanted, "waiting nodes");
        assert_eq!(self.short, line.short, "short nodes");
        assert_eq!(self.long, line.long, "long nodes");
        assert_eq!(self.untimed, line.untimed, "nodes without a forecast");
    }
}
