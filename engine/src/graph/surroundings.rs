//! Everything that the code of a node may read in addition to its parameters, values and files.

use std::sync::Arc;

use crate::graph::graph::Graph;
use crate::kind::context::{Context, ContextField, ReadSource};
use crate::kind::port::Wired;
use crate::kind::registry::KindEntry;
use crate::kind::scene::{Point, Scene};
use crate::value::root::SourceRoot;

/// The context fields of a node; see [`ContextField`].
pub(crate) struct Surroundings {
    /// The settings that all nodes share. The key contains only the settings that the kind declares.
    pub scene: Scene,
    /// Empty unless the kind declares [`ContextField::Wired`].
    pub wired: Wired,
    /// Empty unless the kind declares [`ContextField::Points`].
    pub points: Vec<(&'static str, Vec<Point>)>,
    /// `None` unless the kind declares [`ContextField::Recipe`].
    pub recipe: Option<Arc<str>>,
}

impl Surroundings {
    /// The context fields of a node of a graph.
    pub fn of(graph: &Graph, index: usize, recipe: Option<Arc<str>>) -> Self {
        let reads = |field| graph.nodes[index].kind.reads.contains(&field);
        Self {
            scene: graph.scene,
            wired: if reads(ContextField::Wired) { graph.wired(index) } else { Wired::default() },
            points: if reads(ContextField::Points) { graph.points(index) } else { Vec::new() },
            recipe,
        }
    }

    /// The context for the code of a node, without parts, threads and cancellation.
    pub fn context(self, kind: &KindEntry, root: SourceRoot, sources: Vec<ReadSource>) -> Context {
        Context {
            reads: kind.reads,
            recipe: self.recipe,
            wired: self.wired,
            points: self.points,
            root,
            sources,
            ..Context::detached(self.scene, "")
        }
    }
}
