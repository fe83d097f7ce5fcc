//! `show`: writes the picture of any node, without editing the graph.

use std::path::PathBuf;

use clap::Args;
use engine::{Engine, Graph, Up, Wire};
use glam::DMat4;
use render::look::{of_mesh, of_object};
use scene::types::{Mesh, Object, Placed, Splats};

use crate::session::{EngineArgs, Error, GraphArgs, compute, find, look, sheet, splats};
use crate::terminal;

/// Writes the picture of any node, without editing the graph.
///
/// Computes the node if its result is not known. Linear light is shown with the sRGB curve; depths and other
/// numbers are stretched from black (smallest) to white (largest); normals are shown as colours. Several views
/// become a sheet. Splats, meshes and objects are drawn from above and in four views, whose cameras are printed;
/// objects have the base colours of their materials, without textures.
#[derive(Debug, Args)]
pub struct Show {
    #[command(flatten)]
    graph: GraphArgs,
    /// The node, or one of its outputs, such as `trace.depth`
    node: String,
    /// The PNG file to write [default: NODE.png in the folder `out`]
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Exposure of linear light, in stops
    #[arg(long, value_name = "STOPS", default_value_t = 0.0, allow_negative_numbers = true)]
    exposure: f32,
    #[command(flatten)]
    engine: EngineArgs,
}

impl Show {
    /// Writes the picture. Returns the exit code of the run.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let graph = &loaded.graph;
        let wire = output(graph, &self.node)?;
        let kind = graph.nodes[wire.node].kind.outputs[wire.port].artifact.name;
        if !sheet::is_picture(graph, wire) && !SCENES.contains(&kind) {
            let how =
                "`show` draws outputs of the types image, views, pano, env, splats, mesh, object and placed";
            return Err(Error::usage(format!("`{}` has the type {kind}; {how}", self.node)));
        }
        let name = format!("{}.png", self.node.replace(['/', '='], "_"));
        let path = self.out.clone().unwrap_or_else(|| PathBuf::from("out").join(name));
        loaded.check_output(&path)?;
        let engine = self.engine.open()?;
        let code = compute(&engine, graph, vec![wire.node])?;
        if !matches!(code, 0 | 3) {
            return Ok(code);
        }
        let gone = || {
            Error::usage(format!(
                "the value of `{}` is no longer in the cache; repeat the command to recompute it",
                self.node
            ))
        };
        let (bytes, lines) = if sheet::is_picture(graph, wire) {
            let views = sheet::pictures(&engine, graph, wire).ok_or_else(gone)?;
            let (raster, ranges) = sheet::sheet(&views, self.exposure);
            ranges.iter().for_each(|range| terminal::remark(range));
            let bytes = scene::io::png::write(&raster, true, &[]);
            (bytes.map_err(|error| Error::of_file(&path, &error))?, String::new())
        } else {
            let (scene, up) = scene(&engine, graph, wire).ok_or_else(gone)?;
            match look::of_scene(&scene, up) {
                Ok(drawn) => drawn,
                Err(error) => return Ok(splats::failed(&error)),
            }
        };
        cache::publish_file(&path, &bytes)?;
        terminal::print(&format!("{}\n{lines}", path.display()))?;
        Ok(code)
    }
}

/// Types of outputs that are drawn from above and in views.
const SCENES: [&str; 4] = ["splats", "mesh", "object", "placed"];

/// The splats of a scene, or splats on the surface of a mesh or object, and the up axis. `None` if the value is not
/// in the cache.
fn scene(engine: &Engine, graph: &Graph, wire: Wire) -> Option<(Splats, Up)> {
    let up = graph.scene.up;
    Some(match graph.nodes[wire.node].kind.outputs[wire.port].artifact.name {
        "splats" => (engine.value::<Splats>(graph, wire)?, up),
        "mesh" => (of_mesh(&engine.value::<Mesh>(graph, wire)?), up),
        // In the frame of its file.
        "object" => (of_object(&engine.value::<Object>(graph, wire)?, &DMat4::IDENTITY), Up::PlusY),
        _ => {
            let placed = engine.value::<Placed>(graph, wire)?;
            (of_object(&placed.object, &placed.world_from_object), up)
        }
    })
}

/// Resolves the name of an output: `trace.depth`, or `trace` for the first output.
fn output(graph: &Graph, name: &str) -> Result<Wire, Error> {
    // Nodes of subgraphs have dots in their names.
    if let Some((node, output)) = name.rsplit_once('.')
        && graph.find_all(name).is_empty()
    {
        let node = find(graph, node)?;
        let outputs = &graph.nodes[node].kind.outputs;
        let unknown = || {
            let known: Vec<&str> = outputs.iter().map(|port| port.name).collect();
            let node = &graph.nodes[node].id;
            Error::usage(format!("`{node}` has no output `{output}`; its outputs are {}", known.join(", ")))
        };
        let port = outputs.iter().position(|port| port.name == output).ok_or_else(unknown)?;
        return Ok(Wire { node, port });
    }
    Ok(Wire { node: find(graph, name)?, port: 0 })
}
