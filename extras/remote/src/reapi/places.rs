//! The digests under which a server stores values.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use cache::{Digest, Store, today};

/// For values that are believed to be on the server: the digests under which the server stores them. A wrong place is
/// noticed when the value is fetched, since the value is verified by its own digest.
#[derive(Default)]
pub(crate) struct Places {
    known: Mutex<BTreeMap<Digest, Option<api::Digest>>>,
    /// Where the places are kept for later runs, and the name of the table.
    memo: Option<(Arc<Store>, String)>,
}

impl Places {
    /// The places of a server, which are kept in `store`. `name` identifies the server and its digest function.
    pub fn of(store: Arc<Store>, name: &str) -> Self {
        Self { known: Mutex::default(), memo: Some((store, format!("remote places\n{name}\n"))) }
    }

    /// The place of a value.
    pub fn get(&self, value: &Digest) -> Option<api::Digest> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(place) = known.get(value) {
            return place.clone();
        }
        let (store, table) = self.memo.as_ref()?;
        let text = String::from_utf8(store.history_get(table, &value.to_string())?).ok()?;
        let (hash, size) = text.split_once('/')?;
        let place = api::Digest { hash: hash.to_owned(), size_bytes: size.parse().ok()? };
        known.insert(*value, Some(place.clone()));
        Some(place)
    }

    /// Records the place of a value.
    pub fn put(&self, value: Digest, place: api::Digest) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.get(&value).is_some_and(|known| known.as_ref() == Some(&place)) {
            return;
        }
        if let Some((store, table)) = &self.memo {
            let text = format!("{}/{}", place.hash, place.size_bytes);
            store.history_put(table, &value.to_string(), text.as_bytes());
        }
        known.insert(value, Some(place));
    }

    /// True if the workers of the server computed the canary with this key today.
    pub fn was_proved_today(&self, canary: &Digest) -> bool {
        let stored = |(store, table): &(Arc<Store>, String)| store.history_get(table, &proof(canary));
        self.memo.as_ref().and_then(stored).is_some_and(|day| day == today().to_le_bytes())
    }

    /// Records that the workers of the server computed a canary.
    pub fn prove(&self, canary: &Digest) {
        if let Some((store, table)) = &self.memo {
            store.history_put(table, &proof(canary), &today().to_le_bytes());
        }
    }

    /// Records that a value is not on the server any more.
    pub fn remove(&self, value: &Digest) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.insert(*value, None);
        if let Some((store, table)) = &self.memo {
            // An empty text marks a value without a place.
            store.history_put(table, &value.to_string(), &[]);
        }
    }
}

/// The name under which the day of a proof is kept.
fn proof(canary: &Digest) -> String {
    format!("canary {canary}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_kept_for_later_runs() {
        let store = Arc::new(Store::in_memory());
        let (value, other) = (Digest::of(b"a"), Digest::of(b"b"));
        let place = api::Digest { hash: "12ab".to_owned(), size_bytes: 7 };
        let places = Places::of(store.clone(), "server");
        assert_eq!(places.get(&value), None);
        places.put(value, place.clone());
        places.put(other, place.clone());
        places.remove(&other);
        assert!(!places.was_proved_today(&value));
        places.prove(&value);
        for places in [places, Places::of(store.clone(), "server")] {
            assert_eq!((places.get(&value), places.get(&other)), (Some(place.clone()), None));
            assert!(places.was_proved_today(&value) && !places.was_proved_today(&other));
        }
        assert_eq!(Places::of(store, "other").get(&value), None);
        let forgetful = Places::default();
        forgetful.put(value, place.clone());
        assert_eq!(forgetful.get(&value), Some(place));
    }
}
