//! Results that other machines share: looking them up, and fetching their values.

use std::sync::atomic::Ordering;

use cache::Digest;

use crate::graph::node::Node;
use crate::kind::contract::Keep;
use crate::record::record::{Output, Record};
use crate::remote::entry::Entry;
use crate::remote::shared::local_record;
use crate::run::code::stored_value;
use crate::run::engine::Engine;
use crate::run::event::{Event, State};
use crate::run::message::{Message, Owed};
use crate::run::options::RunOptions;
use crate::run::scheduler::Run;
use crate::run::slot::Life;
use crate::value::artifact::{AnyArtifact, decode_with};
use crate::value::counts::Effort;
use crate::value::error::NodeError;

impl Run<'_> {
    /// Looks for the result of a node in the results that machines share. Returns false if no other machine shares
    /// any, if the node takes less time than the question, or if it runs a program.
    pub(super) fn ask(&mut self, index: usize, key: Digest) -> bool {
        let (engine, options) = (self.engine, self.options);
        let kind = &self.graph.nodes[index].kind;
        let asks = !kind.instant && !kind.runs_programs;
        let Some(shared) = engine.shared.as_deref().filter(|_| asks) else { return false };
        self.slots[index].life = Life::Asking;
        self.known.begin(key);
        let (graph, sender, tracer) = (self.graph, self.sender.clone(), self.tracer.clone());
        self.send(index, move || {
            let owed = Owed::new(&sender, |error| Message::Asked { node: index, found: Err(error) });
            let find = || engine.threads().waiting(|| shared.find(&key, &options.cancel));
            let found = tracer.span(&graph.nodes[index].id, "look up", find);
            owed.send(Message::Asked { node: index, found: found.map(|entry| entry.map(Box::new)) });
        });
        true
    }

    /// Uses the result of another machine, or computes the node if that result is not available.
    pub(super) fn asked(&mut self, index: usize, found: Result<Option<Box<Entry>>, NodeError>) {
        // The node was skipped meanwhile.
        if self.slots[index].life != Life::Asking {
            return;
        }
        let entry = match found {
            Ok(entry) => entry,
            Err(error) => return self.fail(index, &error),
        };
        let graph = self.graph;
        let Some((entry, record)) = entry.and_then(|entry| {
            // A result of a kind whose types have changed is not one of this kind.
            let record = Record::decode(&entry.record, &graph.nodes[index]).ok()?;
            Some((entry, record))
        }) else {
            return match self.forecast(index) {
                Ok(()) => self.place(index),
                Err(error) => self.fail(index, &error),
            };
        };
        if let Err(error) = self.put_local(&entry) {
            self.warn_unstored("cache-write", error.to_string());
        }
        for follower in self.take_followers(index) {
            self.settle(follower, record.clone(), State::Cached, Effort::default());
        }
        self.settle(index, record, State::Cached, Effort::default());
    }

    /// Stores the record of a result of another machine, with only those values marked as stored that are here.
    pub(super) fn put_local(&self, entry: &Entry) -> Result<(), NodeError> {
        let store = &self.engine.store;
        match local_record(&entry.record, |digest| store.has_blob(digest)) {
            Ok(local) => Ok(store.put_record(&entry.key, &local)?),
            // The record was decoded before.
            Err(_) => Ok(()),
        }
    }

    /// Emits the warnings of the shared results.
    pub(super) fn remark(&mut self) {
        let remarks = self.engine.shared.as_deref().map(|shared| shared.remarks());
        for (id, text) in remarks.into_iter().flatten() {
            (self.emit)(Event::Warning { id, text });
        }
    }
}

/// True if the value of an output may be in the store, or among the shared results. A record that came from there
/// states that only digests are stored, although a value may have been fetched or computed since then.
pub(super) fn may_be_available(engine: &Engine, node: &Node, output: &Output) -> bool {
    let is_kept = node.kind.store == Keep::Always;
    output.stored || is_kept && (may_fetch(engine, node) || engine.store.has_blob(&output.digest))
}

fn may_fetch(engine: &Engine, node: &Node) -> bool {
    let kind = &node.kind;
    engine.shared.is_some() && kind.store == Keep::Always && !kind.instant && !kind.runs_programs
}

/// Reads a value from the store, or fetches it from the shared results and stores it. `None` if neither has it.
///
/// # Errors
/// If the run must not continue without the shared results.
pub(super) fn value_of(
    engine: &Engine,
    options: &RunOptions,
    node: &Node,
    port: usize,
    key: Option<Digest>,
    digest: &Digest,
) -> Result<Option<AnyArtifact>, NodeError> {
    let (store, artifact) = (&engine.store, &node.kind.outputs[port].artifact);
    if let Some(value) = stored_value(store, artifact, digest) {
        return Ok(Some(value));
    }
    let (Some(shared), Some(key), true) = (engine.shared.as_deref(), key, may_fetch(engine, node)) else {
        return Ok(None);
    };
    let fetch = || shared.fetch(&key, digest, &options.cancel);
    let Some(bytes) = engine.threads().waiting(fetch)? else { return Ok(None) };
    if options.cancel.load(Ordering::Relaxed) || Digest::of(&bytes) != *digest {
        return Ok(None);
    }
    let Ok(value) = decode_with(artifact, &bytes) else { return Ok(None) };
    // If this fails, the value is fetched again by the next run.
    if store.put_blob_as(digest, &bytes).is_ok()
        && let Some(record) = store.get_record(&key)
        && let Ok(local) = local_record(&record, |digest| store.has_blob(digest))
    {
        let _ = store.put_record(&key, &local);
    }
    Ok(Some(value))
}
