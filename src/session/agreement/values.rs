//! The values that a run computed or found in the cache.

use std::cell::RefCell;
use std::collections::BTreeMap;

use engine::{Digest, Engine, Graph, Wire};

use super::memory::Done;

/// Digests of the outputs of the nodes of a run, from the records in the cache.
pub(super) struct Values<'a> {
    engine: &'a Engine,
    graph: &'a Graph,
    done: &'a Done,
    /// The digests of the outputs of each node that was asked for; `None` if its record is not in the cache.
    known: RefCell<BTreeMap<usize, Option<Vec<Digest>>>>,
}

impl<'a> Values<'a> {
    /// The values of a run of a graph.
    pub fn new(engine: &'a Engine, graph: &'a Graph, done: &'a Done) -> Self {
        Self { engine, graph, done, known: RefCell::default() }
    }

    /// Digest of the value of an output. `None` if this run has no result of the node.
    pub fn digest(&self, wire: Wire) -> Option<Digest> {
        let key = self.done.key(self.graph, wire.node)?;
        let outputs = || {
            let outputs = self.engine.outputs(&self.graph.nodes[wire.node], key)?;
            Some(outputs.iter().map(|output| output.digest).collect::<Vec<_>>())
        };
        let mut known = self.known.borrow_mut();
        known.entry(wire.node).or_insert_with(outputs).as_ref()?.get(wire.port).copied()
    }

    /// True if the record of a node of this run is not in the cache.
    pub fn lacks_records(&self) -> bool {
        self.known.borrow().values().any(Option::is_none)
    }
}
