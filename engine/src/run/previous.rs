//! What a run left behind, for the next one in the same process: where the graph is the same but for some nodes, only
//! these and what follows from them is looked at.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use cache::Store;

use crate::graph::graph::Graph;
use crate::graph::node::Node;
use crate::kind::context::Scene;
use crate::record::action::known_sources;
use crate::run::sink;
use crate::run::slot::{Life, Slot};
use crate::value::root::SourceRoot;

/// The end of a run.
pub(crate) struct PreviousRun {
    nodes: Vec<Arc<Node>>,
    scene: Scene,
    root: SourceRoot,
    only: Vec<usize>,
    pub slots: Vec<Slot>,
}

/// What of a graph may have another result than in the run before.
pub(crate) struct Cone {
    /// Whether a node is in it, or not wanted.
    pub of: Vec<bool>,
    /// The files of sinks that are not, all in place.
    pub kept: Vec<(usize, PathBuf)>,
}

impl PreviousRun {
    /// Keeps what became of each node, and no values. Nothing is kept of a stranger's graph, the links in whose folder
    /// have to be looked at each time.
    pub fn of(graph: &Graph, only: &[usize], mut slots: Vec<Slot>) -> Option<Self> {
        slots.iter_mut().for_each(Slot::rest);
        let (nodes, root) = (graph.nodes.clone(), graph.root.clone());
        (!root.is_confined()).then(|| Self { nodes, scene: graph.scene, root, only: only.to_vec(), slots })
    }

    /// The wanted nodes that are other ones now, that read other files, that did not come to a good end, or whose files are not
    /// in place, and all below; `None` where the graph is another one altogether.
    pub fn cone(
        &self,
        graph: &Graph,
        only: &[usize],
        wanted: &[bool],
        out: &Path,
        store: &Store,
    ) -> Option<Cone> {
        let alike = self.scene == graph.scene
            && self.root.folder() == graph.root.folder()
            && !graph.root.is_confined()
            && self.only == only
            && self.nodes.len() == graph.nodes.len();
        if !alike {
            return None;
        }
        let (mut of, mut kept) = (vec![false; graph.nodes.len()], Vec::new());
        for &index in graph.order() {
            of[index] = !wanted[index]
                || !Arc::ptr_eq(&self.nodes[index], &graph.nodes[index])
                || graph.reads(index).iter().any(|&above| of[above])
                || !self.stands(graph, index, out, store, &mut kept);
        }
        Some(Cone { of, kept })
    }

    /// Whether what became of a node that is the same as before is still so.
    fn stands(
        &self,
        graph: &Graph,
        index: usize,
        out: &Path,
        store: &Store,
        kept: &mut Vec<(usize, PathBuf)>,
    ) -> bool {
        let (node, slot) = (&graph.nodes[index], &self.slots[index]);
        let ended = slot.life == Life::Done && !slot.lost && slot.remaking.is_none();
        let Some(record) = slot.record.as_ref().filter(|_| ended) else { return false };
        if node.kind.reads_files {
            let known = node.step.sources(&graph.root).ok().and_then(|files| known_sources(&files, store));
            if known.as_ref() != Some(&slot.action.sources) {
                return false;
            }
        }
        if let Some(template) = &node.sink_path {
            let targets = sink::targets(out, template, &record.files).unwrap_or_default();
            let Some(placed) = sink::in_place(store, &targets, None) else { return false };
            kept.extend(placed.into_iter().map(|(path, _)| (index, path)));
        }
        true
    }
}
