//! Canaries: small nodes with known results, which prove that workers compute the right values.

use cache::Digest;

use crate::graph::graph::Graph;
use crate::graph::surroundings::Surroundings;
use crate::record::action::prepare;
use crate::remote::action_file::{self, ActionFile};
use crate::remote::outputs::VALUES;
use crate::remote::workers::{WorkContent, WorkFile};
use crate::value::error::NodeError;

/// A node without inputs whose result is known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Canary {
    /// The key of the node.
    pub key: Digest,
    /// The files of the action folder.
    pub files: Vec<WorkFile>,
    /// Paths of the values within the outputs folder, in the order of their digests in the record.
    pub values: Vec<String>,
    /// The digests of the values.
    pub expected: Vec<Digest>,
}

impl Canary {
    /// The canary that consists of the first node of a graph, which must have neither inputs nor source files. `expected`
    /// contains the digests of its outputs.
    ///
    /// # Errors
    /// If the graph has no such node, or if its key cannot be computed.
    pub fn new(graph: &Graph, expected: Vec<Digest>) -> Result<Self, NodeError> {
        let fits = |kind: &crate::kind::registry::KindEntry| kind.inputs.is_empty() && !kind.reads_files;
        let Some(node) = graph.nodes.first().filter(|node| fits(&node.kind)) else {
            return Err(NodeError::new("a canary is a node without inputs and source files"));
        };
        let unknown = |_| unreachable!("the node has no inputs");
        let action = prepare(graph, 0, Vec::new(), unknown, |_| &[], Vec::new())?;
        let around = Surroundings::of(graph, 0, action.recipe.clone());
        let file = ActionFile::of(node, &around, unknown, &action);
        let content = WorkContent::Text(file.text());
        Ok(Self {
            key: action.digest(),
            files: vec![WorkFile { path: action_file::NAME.to_owned(), content }],
            values: node.kind.outputs.iter().map(|port| format!("{VALUES}/{}", port.name)).collect(),
            expected,
        })
    }
}
