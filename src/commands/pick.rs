//! `pick`: prints the point of the scene that a pixel of a view shows.

use clap::Args;
use engine::{Graph, Kind, Wire};
use glam::DVec3;
use nodes::kinds::pose::PoseNode;
use render::pick::{Picked, on_mesh, on_splats};
use scene::types::{Mesh, Rig, Splats};

use crate::session::splats::{context, failed};
use crate::session::{EngineArgs, Error, GraphArgs, compute, find, wires};
use crate::terminal;

/// Prints the position and the normal of the surface that a pixel of a view shows, and a `Pose` to paste.
///
/// The view is a `splat-render` or a `path-trace`. The point lies on the splats of a `splat-render`, or on the
/// receiver of a `path-trace`. If the view has several cameras, the first is used unless `--camera` names another.
#[derive(Debug, Args)]
pub struct Pick {
    #[command(flatten)]
    graph: GraphArgs,
    /// The view: a `splat-render` or a `path-trace`
    view: String,
    /// The pixel, counted from the upper left corner, such as 480,300
    #[arg(value_name = "X,Y")]
    pixel: String,
    /// A second pixel: prints the distance between the two points, to measure the scale of a capture
    #[arg(value_name = "X,Y")]
    to: Option<String>,
    /// The name of a camera of the view
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    #[command(flatten)]
    engine: EngineArgs,
}

/// The scene that a view shows.
enum Scene {
    Splats,
    Mesh,
}

impl Pick {
    /// Prints the point. Returns the exit code, which is 1 if the pixel shows nothing.
    pub fn run(self) -> Result<u8, Error> {
        let (from, to) = (pixel(&self.pixel)?, self.to.as_deref().map(pixel).transpose()?);
        let loaded = self.graph.load()?;
        let graph = &loaded.graph;
        let node = find(graph, &self.view)?;
        let (rig, shown, scene) = inputs(graph, node)?;
        let engine = self.engine.open()?;
        let code = compute(&engine, graph, vec![rig.node, shown.node])?;
        if !matches!(code, 0 | 3) {
            return Ok(code);
        }
        let gone = || {
            Error::usage(format!(
                "the inputs of `{}` are no longer in the cache; repeat the command to recompute them",
                self.view
            ))
        };
        let cameras = engine.value::<Rig>(graph, rig).ok_or_else(gone)?.cameras;
        let is_named = |name: &str| self.camera.as_ref().is_none_or(|wanted| wanted == name);
        let Some(camera) = cameras.iter().find(|camera| is_named(&camera.name)) else {
            let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
            return Err(Error::usage(format!(
                "`{}` has no camera with the name in `--camera`; its cameras are {}",
                self.view,
                names.join(", ")
            )));
        };
        let port = if matches!(scene, Scene::Splats) { "splats" } else { "mesh" };
        let (splats, mesh) = match scene {
            Scene::Splats => (Some(engine.value::<Splats>(graph, shown).ok_or_else(gone)?), None),
            Scene::Mesh => (None, Some(engine.value::<Mesh>(graph, shown).ok_or_else(gone)?)),
        };
        let at = |pixel| match (&splats, &mesh) {
            (Some(splats), _) => on_splats(splats, camera, pixel, &context(graph.scene.up)).map(Some),
            (None, Some(mesh)) => on_mesh(mesh, camera, pixel).map(Some),
            (None, None) => Ok(None),
        };
        let picked = at(from).and_then(|first| Ok((first, to.map(at).transpose()?.flatten())));
        let (Picked { position, normal }, second) = match picked {
            Ok((Some(first), second)) => (first, second),
            Ok((None, _)) => return Err(gone()),
            Err(error) => return Ok(failed(&error)),
        };
        let [at, along] = [position, normal].map(vector);
        let distance = second.map_or_else(String::new, |second| {
            let units = (second.position - position).length();
            let metres = units * graph.scene.metres_per_unit;
            format!(
                "distance  {units:.4} units to {}, {metres:.4} m with this scene's `metres_per_unit`\n",
                vector(second.position)
            )
        });
        terminal::print(&format!(
            "position  {at}\n  normal  {along}\n{distance}    pose  Pose(translation: {at})\n      or  Pose(pixel: Some(({:?}, {:?})), \
             rig: \"{}\", {port}: \"{}\")\n{}",
            from[0],
            from[1],
            name(graph, rig),
            name(graph, shown),
            setting(graph, &at),
        ))?;
        Ok(0)
    }
}

/// The option that moves the only object of a graph to a position and keeps its direction and size. Empty if several
/// nodes are poses, or if the pose is a matrix or a pixel.
fn setting(graph: &Graph, position: &str) -> String {
    let poses = graph.nodes.iter().filter(|node| node.kind.name == PoseNode::NAME);
    let poses = poses.filter_map(|node| Some((node, node.params::<PoseNode>()?)));
    match &poses.collect::<Vec<_>>()[..] {
        [(node, pose)] if pose.matrix.is_none() && pose.pixel.is_none() => {
            format!("      or  --set '{}.translation={position}'   keeps direction and size\n", node.id)
        }
        _ => String::new(),
    }
}

/// Parses a pixel of the form `X,Y`.
fn pixel(text: &str) -> Result<[f64; 2], Error> {
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    let both = text.split_once(',').and_then(|(x, y)| Some([number(x)?, number(y)?]));
    both.ok_or_else(|| {
        Error::usage(format!("`{text}` is not the position of a pixel; write X,Y, such as 480,300"))
    })
}

/// The cameras of a view, and the splats or the receiver that it shows.
fn inputs(graph: &Graph, node: usize) -> Result<(Wire, Wire, Scene), Error> {
    let first = |input: &str| wires(graph, node, input).first().copied();
    let shown = |input: &str, scene: Scene| first(input).map(|wire| (wire, scene));
    let scene = shown("splats", Scene::Splats).or_else(|| shown("receiver", Scene::Mesh));
    first("rig").zip(scene).map(|(rig, (wire, scene))| (rig, wire, scene)).ok_or_else(|| {
        let id = &graph.nodes[node].id;
        Error::usage(format!(
            "`{id}` is not a view of the scene; name a node of the kind `splat-render` or `path-trace`"
        ))
    })
}

/// A wire in the notation of graph files: `camera`, or `demo.splats` if its node has several outputs.
fn name(graph: &Graph, wire: Wire) -> String {
    let node = &graph.nodes[wire.node];
    match &node.kind.outputs[..] {
        [_] => node.id.clone(),
        outputs => format!("{}.{}", node.id, outputs[wire.port].name),
    }
}

/// A vector in the notation of graph files. Its components are rounded to a decimal place that keeps six
/// significant digits of the largest component.
fn vector(v: DVec3) -> String {
    let (largest, mut digits, mut unit) = (v.abs().max_element(), 1, 10.0);
    while digits < 9 && largest * unit < 1e5 {
        (digits, unit) = (digits + 1, unit * 10.0);
    }
    let [x, y, z] = v.to_array().map(|c| format!("{:.digits$}", c + 0.0));
    format!("({x}, {y}, {z})")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_and_pixels_are_those_of_graphs() {
        assert_eq!(vector(DVec3::new(5.72, -31.26, -0.0)), "(5.7200, -31.2600, 0.0000)");
        assert_eq!(vector(DVec3::new(1e6, 0.0, 0.0)), "(1000000.0, 0.0, 0.0)");
        assert!(matches!(pixel("480, 300.5"), Ok([x, y]) if (x, y) == (480.0, 300.5)));
        for wrong in ["480", "a,b", "nan,1", "1,2,3"] {
            assert!(pixel(wrong).is_err(), "{wrong}");
        }
    }
}
