//! Storage for the parts of nodes.

use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use cache::{Digest, Lease, LeaseState, Store};

use crate::graph::node::Node;
use crate::kind::part::{Part, PartStore};
use crate::record::key::part_key;
use crate::record::record::PartRecord;
use crate::run::event::{Event, State};
use crate::run::message::Message;
use crate::run::trace::Tracer;
use crate::run::value_cache::{Name, ValueCache};
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;
use crate::value::error::NodeError;

/// Storage for the parts of a node. In the store, the record of a part names the blob that holds its value. Parts
/// that are never stored are kept in memory.
pub(crate) struct StoredParts {
    store: Arc<Store>,
    prepared: Arc<ValueCache>,
    id: String,
    kind: &'static str,
    profile: &'static str,
    inputs: Vec<(&'static str, Vec<Digest>)>,
    sender: Mutex<Sender<Message>>,
    tracer: Tracer,
}

impl StoredParts {
    /// Makes the storage for the parts of `node`, whose inputs have the digests `inputs`. Events are sent to
    /// `sender`.
    pub fn new(
        node: &Node,
        store: Arc<Store>,
        prepared: Arc<ValueCache>,
        inputs: Vec<(&'static str, Vec<Digest>)>,
        sender: Sender<Message>,
        tracer: Tracer,
    ) -> Self {
        let (id, kind, profile) = (node.id.clone(), node.kind.name, node.kind.profile);
        Self { store, prepared, id, kind, profile, inputs, sender: Mutex::new(sender), tracer }
    }

    fn key(&self, part: Part<'_>, extra: &str) -> Option<Digest> {
        part_key(self.kind, self.profile, part, &self.inputs, extra).ok().map(|key| key.digest)
    }

    fn emit(&self, part: Part<'_>, state: State, key: Digest, seconds: f64) {
        let event = Event::Part { id: self.id.clone(), part: part.name.to_owned(), state, key, seconds };
        let sender = self.sender.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let _ = sender.send(Message::Event(event));
    }
}

impl PartStore for StoredParts {
    fn load(&self, part: Part<'_>, extra: &str) -> Option<(Vec<u8>, Effort)> {
        let (key, begin) = (self.key(part, extra)?, Instant::now());
        let record = PartRecord::decode(&self.store.get_record(&key)?).ok()?;
        let bytes = self.store.get_blob(&record.blob).ok()??;
        self.tracer.record(&self.id, part.name, begin.elapsed().as_secs_f64());
        self.emit(part, State::Cached, key, 0.0);
        Some((bytes, record.spent))
    }

    fn claim(&self, part: Part<'_>, extra: &str) -> Result<Option<Lease>, NodeError> {
        let Some(key) = self.key(part, extra) else { return Ok(None) };
        match self.store.lease(&key) {
            LeaseState::Acquired(lease) | LeaseState::Stalled(lease) => Ok(Some(lease)),
            LeaseState::Busy => Err(NodeError::busy(key)),
        }
    }

    fn save(&self, part: Part<'_>, extra: &str, encoded: &[u8], spent: Effort) -> Result<(), NodeError> {
        let seconds = spent.seconds;
        self.tracer.record(&self.id, part.name, seconds);
        let Some(key) = self.key(part, extra) else { return Ok(()) };
        // A part that cannot be stored is recomputed later. The result of the node reports the problem.
        if let Ok(blob) = self.store.put_blob(encoded) {
            let _ = self.store.put_record(&key, &PartRecord { blob, spent }.encode());
        }
        self.emit(part, State::Ran, key, seconds);
        Ok(())
    }

    fn recall(&self, part: Part<'_>, extra: &str) -> Option<AnyArtifact> {
        self.prepared.get(&of_part(self.key(part, extra)?, part))
    }

    fn keep(&self, part: Part<'_>, extra: &str, value: AnyArtifact, bytes: u64) {
        if let Some(key) = self.key(part, extra) {
            self.prepared.put(&of_part(key, part), &value, bytes);
        }
    }
}

/// The name of a part in the memory cache, made from the key of the part.
fn of_part(key: Digest, part: Part<'_>) -> Name {
    (key, "part", part.version)
}
