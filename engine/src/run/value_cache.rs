//! A cache of values in memory, limited in bytes. No existing crate fits: `lru` limits the number of entries, and
//! crates that limit bytes evict by estimated frequency of use.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Mutex, PoisonError};

use cache::Digest;

use crate::record::record::Output;
use crate::value::artifact::AnyArtifact;

/// The most recently used values, found by digest, type and format.
#[derive(Default)]
pub(crate) struct ValueCache {
    limit: u64,
    entries: Mutex<Entries>,
}

/// The name of a value: digest, type and format.
pub(crate) type Name = (Digest, &'static str, u32);

#[derive(Default)]
struct Entries {
    held: u64,
    clock: u64,
    values: HashMap<Name, Kept>,
    /// Names of the values, sorted by time of last use, the least recent first.
    ages: BTreeMap<u64, Name>,
}

struct Kept {
    value: AnyArtifact,
    bytes: u64,
    used: u64,
}

impl Output {
    /// The name under which the value of this output is kept in memory.
    pub(crate) fn name(&self) -> Name {
        (self.digest, self.type_name, self.format)
    }
}

impl Entries {
    /// Returns a value and marks it as the most recently used.
    fn touch(&mut self, name: &Name) -> Option<AnyArtifact> {
        let kept = self.values.get_mut(name)?;
        self.ages.remove(&kept.used);
        self.clock += 1;
        kept.used = self.clock;
        self.ages.insert(kept.used, *name);
        Some(kept.value.clone())
    }
}

impl ValueCache {
    /// A cache of at most `limit` bytes. If `limit` is 0, nothing is kept.
    pub fn new(limit: u64) -> Self {
        Self { limit, ..Self::default() }
    }

    #[cfg(test)]
    fn held(&self) -> u64 {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner).held
    }

    /// The value with the name `name`, if it is in the cache.
    pub fn get(&self, name: &Name) -> Option<AnyArtifact> {
        if self.limit == 0 {
            return None;
        }
        self.entries.lock().unwrap_or_else(PoisonError::into_inner).touch(name)
    }

    /// Adds a value of the given size. Evicts the least recently used values to make room.
    pub fn put(&self, name: &Name, value: &AnyArtifact, bytes: u64) {
        if bytes > self.limit || self.limit == 0 {
            return;
        }
        // The lock is held from the look-up to the insertion, since two nodes may add the same value at once.
        let entries = &mut *self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        if entries.touch(name).is_some() {
            return;
        }
        while entries.held + bytes > self.limit
            && let Some((_, oldest)) = entries.ages.pop_first()
        {
            entries.held -= entries.values.remove(&oldest).map_or(0, |kept| kept.bytes);
        }
        entries.clock += 1;
        entries.held += bytes;
        entries.ages.insert(entries.clock, *name);
        entries.values.insert(*name, Kept { value: value.clone(), bytes, used: entries.clock });
    }
}

/// The default limit of memory for values and running code, in bytes: three quarters of the free memory.
pub fn default_memory() -> u64 {
    free_memory() / 4 * 3
}

/// Memory in bytes that is available without swapping; 8 GiB if the system does not report it.
fn free_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kib = line.and_then(|rest| rest.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kib.map_or(8 << 30, |kib| kib << 10)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    fn name(number: u64) -> Name {
        (Digest::of(&number.to_le_bytes()), "num", 1)
    }

    #[test]
    fn what_was_not_used_for_longest_makes_room() {
        let cache = ValueCache::new(100);
        let value: AnyArtifact = Arc::new(1_u64);
        for number in 0..3 {
            cache.put(&name(number), &value, 40);
            assert!(cache.get(&name(0)).is_some(), "it is used all the time");
        }
        assert!(cache.get(&name(1)).is_none() && cache.get(&name(2)).is_some());
        assert_eq!(cache.held(), 80);
        cache.put(&name(9), &value, 101);
        assert_eq!(cache.held(), 80, "what is larger than all of it moves nothing out");
        let (digest, type_name, _) = name(0);
        assert!(cache.get(&(digest, type_name, 2)).is_none(), "another format is another value");
    }

    /// Several threads that add the same values leave one entry for each. This test fails if the lock of `put` is released
    /// between the look-up and the insertion.
    #[test]
    fn the_same_value_of_several_threads_is_held_once() {
        for _ in 0..200 {
            let cache = ValueCache::new(1_000);
            let value: AnyArtifact = Arc::new(1_u64);
            std::thread::scope(|scope| {
                for _ in 0..4 {
                    scope.spawn(|| (0..8).for_each(|number| cache.put(&name(number), &value, 10)));
                }
            });
            let entries = cache.entries.lock().expect("no thread panicked");
            let bytes: u64 = entries.values.values().map(|kept| kept.bytes).sum();
            assert_eq!((entries.held, bytes, entries.values.len(), entries.ages.len()), (80, 80, 8, 8));
            assert!(entries.ages.iter().all(|(used, name)| entries.values[name].used == *used));
        }
    }

    #[test]
    fn an_engine_that_runs_once_keeps_nothing() {
        let cache = ValueCache::new(0);
        cache.put(&name(1), &(Arc::new(1_u64) as AnyArtifact), 0);
        assert!(cache.get(&name(1)).is_none());
        assert_eq!(cache.held(), 0);
    }
}
