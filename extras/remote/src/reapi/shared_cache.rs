//! The results on a server, for use by the engine.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use cache::{Digest, Store};
use engine::{Entry, NodeError, SharedResults};

use super::address::Address;
use super::call_error::CallError;
use super::connection::Connection;
use super::places::Places;
use super::results::UnverifiedResult;
use super::retry::Retry;
use super::server::Server;
use crate::credentials::Credentials;
use crate::secret_key::SecretKey;
use crate::signed::{self, Distrust};
use crate::trusted_keys::TrustedKeys;

/// Options for the use of a server.
pub struct SharedCacheOptions {
    /// The address of the server.
    pub address: Address,
    /// Certificates and a token.
    pub credentials: Credentials,
    /// Results signed by these keys are used.
    pub trusted: TrustedKeys,
    /// The key that signs new results. If `None`, nothing is stored on the server.
    pub publish_as: Option<SecretKey>,
    /// True if runs continue without the server if it cannot be reached.
    pub fallback: bool,
    /// Time limits and repetition of calls.
    pub retry: Retry,
}

/// Numbers of results and bytes that were sent and received.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Traffic {
    /// Number of results that were found on the server and used.
    pub found: u64,
    /// Number of results that were stored on the server.
    pub stored: u64,
    /// Number of nodes that workers computed.
    pub executed: u64,
    /// Number of values that were fetched.
    pub values: u64,
    /// Number of bytes that were fetched.
    pub bytes_down: u64,
    /// Number of bytes that were sent.
    pub bytes_up: u64,
}

/// The results on a server.
pub struct SharedCache {
    server: Server,
    trusted: TrustedKeys,
    publish_as: Option<SecretKey>,
    fallback: bool,
    pub(super) places: Places,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// The reason why the server is not used any more.
    lost: Option<String>,
    /// True if no further results are stored on the server.
    stores_nothing: bool,
    remarks: Vec<(&'static str, String)>,
    /// Ids of the remarks so far. There is at most one remark per id.
    said: BTreeSet<&'static str>,
    traffic: Traffic,
}

impl SharedCache {
    /// Connects to a server.
    ///
    /// # Errors
    /// If the server cannot be reached or lacks a required capability.
    pub fn connect(options: SharedCacheOptions, cancel: &AtomicBool) -> Result<Self, CallError> {
        let SharedCacheOptions { address, credentials, trusted, publish_as, fallback, retry } = options;
        let server = Server::open(Connection::new(address, &credentials, retry)?, cancel)?;
        let refuses = publish_as.is_some() && !server.takes_results;
        let state = Mutex::new(State { stores_nothing: refuses, ..State::default() });
        let places = Places::default();
        let cache = Self { server, trusted, publish_as, fallback, places, state };
        if refuses {
            let why = "the server does not accept results from clients".to_owned();
            cache.stop_storing(&CallError::Refused { what: "storing results", why });
        }
        Ok(cache)
    }

    /// Remembers in `store` under which digests the server stores values, for later runs.
    pub fn remember_in(mut self, store: Arc<Store>) -> Self {
        let Address { encrypted, authority, instance, .. } = self.address();
        let name = format!("{encrypted} {authority} {instance} {:?}", self.server.function);
        self.places = Places::of(store, &name);
        self
    }

    /// The traffic so far.
    pub fn traffic(&self) -> Traffic {
        self.state().traffic
    }

    /// The server.
    pub(crate) fn server(&self) -> &Server {
        &self.server
    }

    pub(super) fn address(&self) -> &Address {
        &self.server.connection.address
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn remark(&self, id: &'static str, text: String) {
        let mut state = self.state();
        if state.said.insert(id) {
            state.remarks.push((id, text));
        }
    }

    /// The answer to every question after the server was given up; `None` while the server is used.
    pub(super) fn without<T>(&self) -> Option<Result<Option<T>, NodeError>> {
        let why = self.state().lost.clone()?;
        Some(if self.fallback { Ok(None) } else { Err(self.refusal(&why)) })
    }

    fn refusal(&self, why: &str) -> NodeError {
        NodeError::new(format!("the shared results on {} are not available: {why}", self.address()))
            .hint("run without `--no-remote-fallback` to compute everything here")
    }

    /// The answer to a question whose call failed. From then on the server is not used, since every further call
    /// would take as long to fail.
    pub(super) fn failed<T>(&self, error: &CallError) -> Result<Option<T>, NodeError> {
        if matches!(error, CallError::Cancelled) {
            return Ok(None);
        }
        let why = error.to_string();
        self.state().lost = Some(why.clone());
        if !self.fallback {
            return Err(self.refusal(&why));
        }
        self.remark(
            "remote-lost",
            format!("{}: {why}; the run continues without this server", self.address()),
        );
        Ok(None)
    }

    /// True if the server is not used any more.
    pub(super) fn is_lost(&self) -> bool {
        self.state().lost.is_some()
    }

    /// Adds to the numbers of the traffic.
    pub(super) fn count(&self, add: impl FnOnce(&mut Traffic)) {
        add(&mut self.state().traffic);
    }

    /// True if runs continue without the server if it is not available.
    pub(super) fn has_fallback(&self) -> bool {
        self.fallback
    }

    /// The key that signs new results, unless no results are stored on the server.
    fn publishes(&self) -> Option<&SecretKey> {
        let state = self.state();
        self.publish_as.as_ref().filter(|_| !state.stores_nothing && state.lost.is_none())
    }

    /// Stores a result whose values are on the server, if this client stores results.
    pub(super) fn publish_entry(&self, entry: &Entry, places: &[(Digest, api::Digest)], cancel: &AtomicBool) {
        let Some(key) = self.publishes() else { return };
        match self.server.store_entry(&entry.key, &signed::seal(entry, key), places, cancel) {
            Ok(sent) => self.count(|traffic| {
                traffic.stored += 1;
                traffic.bytes_up += sent;
            }),
            Err(error) => self.stop_storing(&error),
        }
    }

    fn stop_storing(&self, error: &CallError) {
        self.state().stores_nothing = true;
        if !matches!(error, CallError::Cancelled) {
            let text =
                format!("{}: {error}; no further results of this run are stored there", self.address());
            self.remark("remote-store", text);
        }
    }

    /// The verified entry in an answer; `None` if the entry must not be used.
    fn verified(&self, key: &Digest, found: &UnverifiedResult) -> Option<Entry> {
        let entry = match signed::open(&found.sealed, key, &self.trusted) {
            Ok(entry) => entry,
            Err(why) => {
                let id = match why {
                    Distrust::Unsigned => "remote-unsigned",
                    Distrust::Unknown(_) => "remote-untrusted",
                    Distrust::Revoked(_) => "remote-revoked",
                    Distrust::Forged(_) | Distrust::Damaged(_) => "remote-forged",
                };
                let text = format!(
                    "a result on {} is not used: {why} (further results like this one are not reported)",
                    self.address()
                );
                self.remark(id, text);
                return None;
            }
        };
        // The places are not signed. A wrong one is noticed when the value is fetched; its size is checked here, so
        // that nothing longer than the value is ever fetched.
        let place = |value: &Digest, length: u64| {
            let places = found.values.iter().filter(|(known, _)| known == value);
            let mut sized = places.filter(|(_, place)| u64::try_from(place.size_bytes) == Ok(length));
            sized.next().map(|(value, place)| (*value, place.clone()))
        };
        let blobs = entry.blobs().ok()?;
        let places: Option<Vec<_>> =
            blobs.iter().zip(&entry.lengths).map(|(value, length)| place(value, *length)).collect();
        match places {
            Some(places) => {
                places.into_iter().for_each(|(value, place)| self.places.put(value, place));
                Some(entry)
            }
            None => {
                let text = format!(
                    "a result on {} is not used, because one of its values is missing there",
                    self.address()
                );
                self.remark("remote-incomplete", text);
                None
            }
        }
    }
}

impl SharedResults for SharedCache {
    fn find(&self, key: &Digest, cancel: &AtomicBool) -> Result<Option<Entry>, NodeError> {
        if let Some(answer) = self.without() {
            return answer;
        }
        match self.server.find(key, cancel) {
            Ok(found) => {
                let entry = self.verified(key, &found);
                self.state().traffic.found += u64::from(entry.is_some());
                Ok(entry)
            }
            Err(CallError::NotFound) => Ok(None),
            // The answer for one key says nothing about the others.
            Err(error @ CallError::Wrong { .. }) => {
                self.remark(
                    "remote-wrong",
                    format!("{}: {error}; the result is computed here", self.address()),
                );
                Ok(None)
            }
            Err(error) => self.failed(&error),
        }
    }

    fn fetch(&self, key: &Digest, value: &Digest, cancel: &AtomicBool) -> Result<Option<Vec<u8>>, NodeError> {
        if let Some(answer) = self.without() {
            return answer;
        }
        let place = || self.places.get(value);
        let place = match place() {
            Some(place) => place,
            // The record came from the store of this machine.
            None => match self.find(key, cancel)?.and_then(|_| place()) {
                Some(place) => place,
                None => return Ok(None),
            },
        };
        match self.server.download(&place, cancel) {
            Ok(bytes) if Digest::of(&bytes) == *value => {
                let mut state = self.state();
                state.traffic.values += 1;
                state.traffic.bytes_down += bytes.len() as u64;
                Ok(Some(bytes))
            }
            Ok(_) => {
                let text = format!("a value on {} is damaged, so it is computed here", self.address());
                self.remark("remote-damaged", text);
                self.places.remove(value);
                Ok(None)
            }
            Err(CallError::NotFound) => {
                self.places.remove(value);
                Ok(None)
            }
            Err(error @ CallError::Wrong { .. }) => {
                self.remark(
                    "remote-wrong",
                    format!("{}: {error}; the value is computed here", self.address()),
                );
                Ok(None)
            }
            Err(error) => self.failed(&error),
        }
    }

    fn publish(&self, entry: &Entry, values: &[(Digest, &[u8])], cancel: &AtomicBool) {
        let Some(key) = self.publishes() else { return };
        match self.server.store(&entry.key, &signed::seal(entry, key), values, cancel) {
            Ok(sent) => {
                let mut state = self.state();
                state.traffic.stored += 1;
                state.traffic.bytes_up += sent;
            }
            Err(error) => self.stop_storing(&error),
        }
    }

    fn remarks(&self) -> Vec<(&'static str, String)> {
        std::mem::take(&mut self.state().remarks)
    }
}
