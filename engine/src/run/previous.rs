//! The end state of the previous run in the same process. If few nodes of the graph changed, the next run inspects
//! only the changed nodes and the nodes downstream of them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use cache::Store;

use crate::graph::graph::Graph;
use crate::graph::node::Node;
use crate::kind::scene::Scene;
use crate::record::action::known_sources;
use crate::run::sink;
use crate::run::slot::{Life, Slot};
use crate::value::root::SourceRoot;

/// The end state of a run.
pub(crate) struct PreviousRun {
    nodes: Vec<Arc<Node>>,
    scene: Scene,
    root: SourceRoot,
    only: Vec<usize>,
    pub slots: Vec<Slot>,
}

/// The nodes whose results may differ from their results in the previous run.
pub(crate) struct Cone {
    /// For each node, true if its result may differ, or if no target needs the node.
    pub of: Vec<bool>,
    /// The output files of the sinks for which `of` is false, each with the index of its sink. All of these files
    /// are up to date.
    pub kept: Vec<(usize, PathBuf)>,
}

impl PreviousRun {
    /// Keeps the end state of each node, without values. Returns `None` for an untrusted graph, since every run of
    /// such a graph must check the output folder for links.
    pub fn of(graph: &Graph, only: &[usize], mut slots: Vec<Slot>) -> Option<Self> {
        slots.iter_mut().for_each(Slot::rest);
        let (nodes, root) = (graph.nodes.clone(), graph.root.clone());
        (!root.is_confined()).then(|| Self { nodes, scene: graph.scene, root, only: only.to_vec(), slots })
    }

    /// The nodes that the run must inspect. A node must be inspected if it is needed and has changed, has changed
    /// source files, did not succeed, or has output files that are not up to date. All nodes downstream of such
    /// nodes must be inspected too. `None` if the two graphs differ in anything other than individual nodes, such
    /// as the scene or the number of nodes.
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

    /// True if the result of an unchanged node is still up to date. If the node is a sink, adds its files to
    /// `kept`.
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
