//! Keys: digests of everything that a result depends on, and of nothing else.
//!
//! Inputs enter by content digest. So if a node runs again and gives equal outputs, the nodes downstream of it do
//! not run again. Node names, layout, output paths, threads and the machine do not enter.

use cache::{Digest, Key, KeyWriter};

use crate::graph::graph::Graph;
use crate::graph::node::Wire;
use crate::kind::context::{ContextField, ReadSource};
use crate::record::record::Output;

/// Text that is part of every key. It is changed when the encoding of keys or records changes.
pub(crate) const FORMAT: &str = "lightharmony action 1";
const PART_FORMAT: &str = "lightharmony part 1";

/// The key of a node with known inputs, using `memory` as a buffer. `output` returns the output from which a wire
/// comes.
pub(crate) fn node_key<'s>(
    graph: &Graph,
    index: usize,
    output: impl Fn(Wire) -> &'s Output,
    sources: &[ReadSource],
    recipe: Option<&str>,
    memory: Vec<u8>,
) -> Result<Key, cache::KeyError> {
    let (node, scene) = (&graph.nodes[index], &graph.scene);
    let mut to = KeyWriter::in_memory_of(memory, FORMAT);
    to.str("kind", node.kind.name);
    to.u64("version", node.kind.version.into());
    to.str("profile", node.kind.profile);
    if !node.kind.data.is_empty() {
        to.digest("data", Digest::of(node.kind.data));
    }
    node.write_key(&mut to);
    for (port, wires) in node.kind.inputs.iter().zip(&node.inputs) {
        to.list(port.name, |to| {
            for value in wires.iter().map(|wire| output(*wire)) {
                to.str("type", value.type_name);
                to.u64("format", value.format.into());
                to.digest("content", value.digest);
            }
        });
    }
    to.list("sources", |to| {
        for source in sources {
            to.digest(&source.file.name, source.digest);
        }
    });
    for field in node.kind.reads {
        match field {
            ContextField::Up => to.str("scene.up", scene.up.name()),
            ContextField::MetresPerUnit => to.f64("scene.metres_per_unit", scene.metres_per_unit),
            ContextField::Seed => to.u64("scene.seed", scene.seed),
            ContextField::Exhaustive => to.u64("scene.exhaustive", scene.exhaustive.into()),
            ContextField::Wired => {
                for (port, names) in graph.wired(index).0 {
                    to.list(&format!("wired.{port}"), |to| names.iter().for_each(|name| to.str("", name)));
                }
            }
            ContextField::Points => {
                for (port, points) in graph.points(index) {
                    for (place, point) in points.iter().enumerate() {
                        let name = |axis: &str| format!("points.{port}.{place}.{axis}");
                        point.iter().for_each(|(axis, value)| to.str(&name(axis), value));
                    }
                }
            }
            ContextField::Recipe => to.str("recipe", recipe.unwrap_or_default()),
        }
    }
    to.finish()
}

/// The key of a part of a node's work; see [`crate::Context::part`].
pub(crate) fn part_key(
    kind: &str,
    profile: &str,
    part: crate::kind::part::Part<'_>,
    inputs: &[(&'static str, Vec<Digest>)],
    extra: &str,
) -> Result<Key, cache::KeyError> {
    let mut to = KeyWriter::new(PART_FORMAT);
    to.str("kind", kind);
    to.str("part", part.name);
    to.u64("version", part.version.into());
    to.str("profile", profile);
    for name in part.inputs {
        to.list(name, |to| {
            for digest in inputs.iter().filter(|(port, _)| port == name).flat_map(|(_, digests)| digests) {
                to.digest("content", *digest);
            }
        });
    }
    to.str("extra", extra);
    to.finish()
}
