//! Detects pictures whose sizes do not match. The sizes are taken from cameras and file headers.

use std::sync::Arc;

use engine::{Code, Context, Diagnostic, Diagnostics, Graph, Kind, Scene, Up, Wire};
use nodes::kinds::camera::Camera;
use nodes::kinds::demo_scene::DemoScene;
use nodes::kinds::load_cameras::{self, LoadCameras};
use nodes::kinds::load_image::{LoadImage, Orientation};
use scene::io::picture;

/// Width and height of each view in pixels.
type Sizes = Vec<[u64; 2]>;

/// Kinds whose output pictures have the same size as one of their inputs, each with the name of that input.
const FOLLOWS: [(&str, &str); 9] = [
    ("splat-render", "rig"),
    ("path-trace", "rig"),
    ("denoise", "object"),
    ("shadow-ratio", "with"),
    ("alpha-shadow", "with"),
    ("composite", "background"),
    ("region-masks", "object"),
    ("run-ocio", "image"),
    ("average-images", "images"),
];

/// The inputs that `composite` combines.
const LAYERS: [&str; 4] = ["background", "object", "shadow", "front"];

/// Reports each `composite` whose inputs have different sizes, if these sizes are known without a run.
pub fn check(graph: &Graph) -> Result<(), Diagnostics> {
    let mut known: Vec<Option<Option<Sizes>>> = vec![None; graph.nodes.len()];
    let mut mistakes = Vec::new();
    for &node in graph.order() {
        if graph.nodes[node].kind.name != "composite" {
            continue;
        }
        let mut first: Option<(&str, Sizes)> = None;
        for layer in LAYERS {
            let sizes = wire(graph, node, layer).and_then(|wire| sizes(graph, wire, &mut known));
            match (&first, sizes) {
                (None, Some(sizes)) => first = Some((layer, sizes)),
                (Some((name, expected)), Some(sizes)) if !fit(expected, &sizes) => {
                    let text =
                        |sizes: &Sizes| sizes.first().map_or(String::new(), |[w, h]| format!("{w}x{h}"));
                    let message =
                        format!("`{layer}` is {} pixels, but `{name}` is {}", text(&sizes), text(expected));
                    mistakes.push(
                        Diagnostic::of(Code::Wiring, graph.place(node, Some(layer)), message)
                            .hint("render with a camera of the same size as the picture, or load a picture of the same size as the camera"),
                    );
                }
                _ => {}
            }
        }
    }
    if mistakes.is_empty() { Ok(()) } else { Err(Diagnostics::new(graph.source.clone(), mistakes)) }
}

/// True unless both lists contain sizes but have no size in common.
fn fit(a: &Sizes, b: &Sizes) -> bool {
    a.is_empty() || b.is_empty() || a.iter().any(|size| b.contains(size))
}

fn wire(graph: &Graph, node: usize, input: &str) -> Option<Wire> {
    let node = &graph.nodes[node];
    let port = node.kind.inputs.iter().position(|port| port.name == input)?;
    node.inputs[port].first().copied()
}

/// The sizes of the pictures or cameras that an output contains; `None` if they are known only after a run.
fn sizes(graph: &Graph, wire: Wire, known: &mut [Option<Option<Sizes>>]) -> Option<Sizes> {
    // Follows inputs up to the first node with its own size. This is a loop, since graphs may be deep.
    let (mut at, mut path) = (wire, Vec::new());
    let found = loop {
        if let Some(found) = &known[at.node] {
            break found.clone();
        }
        path.push(at.node);
        let name = graph.nodes[at.node].kind.name;
        match FOLLOWS.iter().find(|(kind, _)| *kind == name) {
            Some((_, input)) => match self::wire(graph, at.node, input) {
                Some(above) => at = above,
                None => break None,
            },
            None => break own(graph, at.node),
        }
    };
    for node in path {
        known[node] = Some(found.clone());
    }
    found
}

/// The sizes of the pictures or cameras that a node makes or loads, determined from its parameters and source
/// files. `None` if they cannot be determined.
fn own(graph: &Graph, node: usize) -> Option<Sizes> {
    let node = &graph.nodes[node];
    let pair = |width: u32, height: u32| vec![[u64::from(width), u64::from(height)]];
    match node.kind.name {
        "camera" => node.params::<Camera>().map(|camera| pair(camera.width_px, camera.height_px)),
        "demo-scene" => node.params::<DemoScene>().map(|demo| pair(demo.width_px, demo.height_px)),
        "load-image" => {
            let image: LoadImage = node.params()?;
            let paths = std::iter::once(&image.path).chain(&image.more);
            let size = match image.orientation {
                Orientation::Upright => picture::upright_size,
                Orientation::Stored => picture::size,
            };
            paths.map(|path| size(&graph.root.folder().join(&path.0))).collect()
        }
        "load-cameras" => {
            let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
            let cx = Context::detached(scene, graph.root.folder());
            let (out, _) = LoadCameras::run(&node.params()?, load_cameras::In {}, &cx).ok()?;
            let cameras = Arc::unwrap_or_clone(out.rig).cameras;
            Some(
                cameras
                    .iter()
                    .map(|camera| [u64::from(camera.width_px), u64::from(camera.height_px)])
                    .collect(),
            )
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Source, SourceRoot};

    fn checked(plate: [u32; 2], camera: &str) -> Result<(), Diagnostics> {
        let folder = tempfile::tempdir().expect("a folder");
        let [width, height] = plate.map(|side| side as usize);
        let codes = vec![9; width * height * 3];
        let raster = scene::io::png::Raster {
            width,
            height,
            channels: 3,
            largest: 255,
            codes,
            ignored: Vec::new(),
            colour: None,
        };
        let bytes = scene::io::png::write(&raster, true, &[]).unwrap_or_default();
        std::fs::write(folder.path().join("plate.png"), bytes).expect("it is written");
        let text = format!(
            r#"Graph(version: 1, scene: (up: "+z"), nodes: (
                demo:  DemoScene(place: Courtyard, splats: 2000, width_px: 32, height_px: 24),
                pose:  Pose(), put: Place(object: "demo.object", pose: "pose"),
                cam:   {camera},
                plate: LoadImage(path: "plate.png"),
                trace: PathTrace(receiver: "demo.proxy", objects: ["put"], rig: "cam", env: "demo.truth_env"),
                final: Composite(background: "plate", object: "trace.object"),
                save:  WriteImage(image: "final", path: "a.png"),
            ))"#
        );
        let root = SourceRoot::new(folder.path());
        let graph = Graph::parse(Source::new("graph.ron", text), &nodes::registry(), root);
        check(&graph.unwrap_or_else(|mistakes| panic!("{mistakes}")))
    }

    // This test fails if `fit` always returns true.
    #[test]
    fn a_plate_and_a_camera_of_different_sizes_are_found_before_the_run() {
        let camera = "Camera(eye: (2.0, 0.0, 1.0), target: (0.0, 0.0, 0.0), width_px: 64, height_px: 48)";
        assert!(checked([64, 48], camera).is_ok());
        let text =
            checked([32, 48], camera).map_err(|mistakes| mistakes.to_string()).expect_err("they differ");
        assert!(text.contains("`object` is 64x48 pixels, but `background` is 32x48"), "{text}");
        assert!(
            checked(
                [32, 48],
                "Camera(eye: (2.0, 0.0, 1.0), target: (0.0, 0.0, 0.0), width_px: 32, height_px: 48)"
            )
            .is_ok()
        );
    }
}
