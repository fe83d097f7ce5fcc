//! What the last run of a graph looked up, node by node: one read where records would cost a search each.
//!
//! It is asked with the key that a node has now, and answers only where that is the key it had then, so it tells
//! nothing that the records would not.

use cache::{Digest, Store};

use crate::graph::graph::Graph;
use crate::record::record::Record;
use crate::run::slot::Slot;
use crate::value::artifact::{Decoder, Encoder};

/// Raised when the bytes change their form. Records have theirs by the types that they name.
const FORMAT: u32 = 1;

/// The key and the record of each node of the graph, where it had one.
#[derive(Default)]
pub(crate) struct LookupMemo {
    bytes: Vec<u8>,
    /// Where the entry of each node begins.
    starts: Vec<u32>,
}

impl LookupMemo {
    /// What is kept under the name of a graph's book; nothing where it is not of as many nodes.
    pub fn read(store: &Store, book: &str, nodes: usize) -> Self {
        let bytes = store.last_run_get(book).unwrap_or_default();
        Self::starts(&bytes, nodes).map_or_else(Self::default, |starts| Self { bytes, starts })
    }

    fn starts(bytes: &[u8], nodes: usize) -> Option<Vec<u32>> {
        let mut from = Decoder::new(bytes);
        if from.u32().ok()? != FORMAT || from.u32().ok()? as usize != nodes {
            return None;
        }
        let mut starts = Vec::with_capacity(nodes);
        for _ in 0..nodes {
            starts.push(u32::try_from(bytes.len() - from.left()).ok()?);
            from.array::<32>().ok()?;
            from.raw().ok()?;
        }
        from.end().is_ok().then_some(starts)
    }

    /// The record of a node of the graph, if its key is the one it had.
    pub fn record(&self, graph: &Graph, index: usize, key: &Digest) -> Option<Record> {
        let (known, body) = self.entry(index)?;
        let ours = known == key.as_bytes() && !body.is_empty();
        ours.then(|| Record::decode_body(body, &graph.nodes[index]).ok()).flatten()
    }

    fn entry(&self, index: usize) -> Option<(&[u8; 32], &[u8])> {
        let entry = self.bytes.get(*self.starts.get(index)? as usize..)?;
        let (key, rest) = entry.split_first_chunk::<32>()?;
        Some((key, Decoder::new(rest).raw().ok()?))
    }

    /// Keeps the keys and records of a run for the next one; of nodes that the run did not come to, those before.
    pub fn write(&self, store: &Store, book: &str, slots: &[Slot]) {
        let mut to = Encoder::default();
        to.u32(FORMAT);
        to.u32(slots.len() as u32);
        for (index, slot) in slots.iter().enumerate() {
            if let (Some(key), Some(record), false) = (&slot.key, &slot.record, slot.rough) {
                to.raw(key.as_bytes());
                to.u8s(&record.body());
            } else {
                let (key, body) = self.entry(index).unwrap_or((&[0; 32], &[]));
                to.raw(key);
                to.u8s(body);
            }
        }
        store.last_run_put(book, &to.finish());
    }
}
