//! Other graphs near the watched one, whose pictures outputs can be compared with.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use cache::Digest;
use engine::{Engine, Graph, Source, SourceRoot, Wire, bundle_around};
use serde::Serialize;

use crate::near;
use crate::values::{SHOWN, Shown};

/// Maximum number of graphs that are read.
const MOST_GRAPHS: usize = 40;
/// Maximum number of nodes of a graph that is read.
const MOST_NODES: usize = 2000;
/// Maximum number of pictures of a graph that are offered.
const MOST_PICTURES: usize = 24;

/// A graph that is offered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Other {
    /// Path relative to the folder of the watched graph.
    name: String,
    /// The pictures that its sinks read and that are in the cache, each with its output and its digest.
    pictures: Vec<(String, String)>,
}

/// A picture of another graph.
#[derive(Clone)]
pub struct OtherPicture {
    graph: Arc<Graph>,
    wire: Wire,
    digest: Digest,
}

impl OtherPicture {
    /// Reads the picture from the cache; `None` if it is gone.
    pub fn read(&self, engine: &Engine) -> Option<Shown> {
        let type_name = self.graph.nodes[self.wire.node].kind.outputs[self.wire.port].artifact.name;
        Shown::read(engine, type_name, &self.digest, Some((&self.graph, self.wire)))
    }
}

/// The pictures that were offered, by their digests. A client names a picture by its digest, so a request cannot
/// contain a path, and only pictures of graphs below the folder of the watched graph are given.
#[derive(Default)]
pub struct Graphs(Mutex<BTreeMap<Digest, OtherPicture>>);

impl Graphs {
    /// Lists the other graphs in the folder of the watched graph and in its subfolders. Graphs with mistakes, and graphs
    /// without a picture in the cache, are left out. The pictures are those of the graphs as their text is now.
    pub fn list(&self, engine: &Engine, watched: &Path) -> Vec<Other> {
        let folder = watched.parent().unwrap_or(Path::new("."));
        let (mut list, mut known) = (Vec::new(), BTreeMap::new());
        for path in near::files(folder, &["ron"]).into_iter().take(MOST_GRAPHS) {
            if path == watched {
                continue;
            }
            let Some(graph) = read(&path) else { continue };
            let pictures: Vec<_> = pictures(engine, &graph);
            if !pictures.is_empty() {
                let entries = pictures.iter().map(|one| (name_of(&graph, one.wire), one.digest.to_string()));
                list.push(Other { name: near::name(folder, &path), pictures: entries.collect() });
                known.extend(pictures.into_iter().map(|one| (one.digest, one)));
            }
        }
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = known;
        list
    }

    /// The picture with this digest, if it was offered.
    pub fn find(&self, digest: &Digest) -> Option<OtherPicture> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(digest).cloned()
    }
}

fn name_of(graph: &Graph, wire: Wire) -> String {
    let node = &graph.nodes[wire.node];
    format!("{}.{}", node.id, node.kind.outputs[wire.port].name)
}

/// Reads a graph; `None` if it has mistakes or is too large.
fn read(path: &Path) -> Option<Arc<Graph>> {
    let folder = path.parent()?;
    // The graph of an unpacked bundle reads files of the bundle only.
    let root = match bundle_around(folder) {
        Some(bundle) => SourceRoot::confined(&bundle, &[]).ok()?.at(folder),
        None => SourceRoot::new(folder),
    };
    let text = engine::read_text(path, engine::MAX_GRAPH_BYTES).ok()?;
    let (source, _) = Source::new(path.display().to_string(), text).including(&root);
    let graph = Graph::parse(source, &nodes::registry(), root).ok()?;
    (graph.nodes.len() <= MOST_NODES).then(|| Arc::new(graph))
}

/// The pictures that the sinks of a graph read and that the cache has.
fn pictures(engine: &Engine, graph: &Arc<Graph>) -> Vec<OtherPicture> {
    let plan = engine.plan(graph, &[]);
    let wires = graph.targets().into_iter().flat_map(|target| graph.nodes[target].inputs.iter().flatten());
    let picture = |wire: &Wire| {
        let node = &graph.nodes[wire.node];
        // The digest of a manifest is the key.
        let key = Digest::of(plan.get(wire.node)?.manifest.as_ref()?.as_bytes());
        let output = engine.outputs(node, &key)?.into_iter().nth(wire.port)?;
        let digest = output.digest;
        SHOWN.contains(&output.type_name).then(|| OtherPicture { graph: graph.clone(), wire: *wire, digest })
    };
    let mut found: Vec<OtherPicture> = Vec::new();
    for one in wires.filter_map(picture) {
        if found.len() < MOST_PICTURES && !found.iter().any(|known| known.wire == one.wire) {
            found.push(one);
        }
    }
    found
}
