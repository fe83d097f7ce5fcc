use std::collections::BTreeMap;

use engine::{Source, SourceRoot};

use super::*;

/// The wires of a graph around `between`, which has a mesh `mesh`, splats `scene`, and a light `light`.
fn graph(axes: &str, between: &str) -> Graph {
    let text = format!(
        r#"Graph(version: 1, {axes} scene: (up: "+z", seed: 1), nodes: (
            demo:   DemoScene(place: Courtyard),
            pose:   Pose(),
            placed: Place(object: "demo.object", pose: "pose"),
            probe:  CubeRig(at: "pose", height_metres: 0.5, size_px: 16),
            cam:    Camera(eye: (2.0, -2.5, 1.2), target: (0.0, 0.0, 0.2), width_px: 16, height_px: 9, fov_y_deg: 40.0),
            photo:  LoadImage(path: "photo.png"),
            light:  LoadEnvironment(path: "light.exr"),
            {between}
        ))"#
    );
    // Only their existence is checked.
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    for name in ["photo.png", "light.exr", "mesh.ply", "a.png", "a.ply", "b.ply", "c.ply", "d.ply"] {
        std::fs::write(folder.path().join(name), "").unwrap_or_else(|e| panic!("{e}"));
    }
    let source = Source::new("graph.ron", text);
    Graph::parse(source, &nodes::registry(), SourceRoot::new(folder.path()))
        .unwrap_or_else(|e| panic!("{e:?}"))
}

/// Digests of outputs that are equal where kind and parameters are equal. A `pick-cameras` without `pick` passes
/// its rig on. The nodes in `without` have no values.
fn digests<'a>(graph: &'a Graph, without: &'a [&str]) -> impl Fn(Wire) -> Option<Digest> + 'a {
    move |wire| {
        let mut node = wire.node;
        if without.contains(&graph.nodes[node].id.as_str()) {
            return None;
        }
        while graph.nodes[node].kind.name == "pick-cameras" {
            node = wires(graph, node, "rig").first()?.node;
        }
        let of = &graph.nodes[node];
        Some(Digest::of(format!("{} {:?} {}", of.kind.name, of.values(), wire.port).as_bytes()))
    }
}

/// Each pair as `splats mesh rigs objects`.
fn found(graph: &Graph, without: &[&str]) -> Vec<String> {
    let name = |wire: &Wire| graph.nodes[wire.node].id.clone();
    let list = |wires: &[Wire]| wires.iter().map(name).collect::<Vec<_>>().join(",");
    let text = |pair: Pair| {
        format!("{} {} {} {}", name(&pair.splats), name(&pair.mesh), list(&pair.rigs), list(&pair.objects))
    };
    pairs(graph, &digests(graph, without)).into_iter().map(text).collect()
}

const TRACE: &str = r#"trace: PathTrace(receiver: "mesh", objects: ["placed"], rig: "cam", env: "light", samples: 1),
    mesh: LoadMesh(path: "mesh.ply"), final: Composite(background: "back", object: "trace.object"),"#;

/// Splats and mesh belong together however the graph connects them. The cases after the first fail if rigs are
/// compared as wires.
#[test]
fn the_wiring_does_not_matter() {
    let camera = r#"other: Camera(eye: (2.0, -2.5, 1.2), target: (0.0, 0.0, 0.2), width_px: 16, height_px: 9, fov_y_deg: 40.0),"#;
    for back in [
        r#"back: SplatRender(splats: "demo.splats", rig: "cam"),"#.to_owned(),
        format!(r#"{camera} back: SplatRender(splats: "demo.splats", rig: "other"),"#),
        r#"picked: PickCameras(rig: "cam"), back: SplatRender(splats: "demo.splats", rig: "picked"),"#
            .to_owned(),
        // A photograph as background, and splats of equal cameras that are not composited, or of other cameras.
        format!(
            r#"back: LoadImage(path: "a.png"), {camera} view: SplatRender(splats: "demo.splats", rig: "other"),"#
        ),
        r#"back: LoadImage(path: "a.png"), view: SplatRender(splats: "demo.splats", rig: "probe"),"#
            .to_owned(),
    ] {
        assert_eq!(found(&graph("", &format!("{back} {TRACE}")), &[]), ["demo mesh cam placed"], "{back}");
    }
    // A photograph as background, and splats for the light.
    let lit = TRACE.replace("\"light\"", "\"env\"");
    let light = r#"back: LoadImage(path: "a.png"), faces: SplatRender(splats: "demo.splats", rig: "probe"),
        pano: Stitch(views: "faces", width_px: 64), dark: PredictExposure(pano: "pano", evs: [-6.0, -3.0]),
        env: FuseHdr(base: "pano", brackets: "dark"),"#;
    assert_eq!(found(&graph("", &format!("{light} {lit}")), &[]), ["demo mesh cam placed"]);
}

/// A run of some frames compares these frames, and equal meshes are compared once. A mesh at another value of an
/// axis does not belong to the splats.
#[test]
fn what_took_part_is_compared() {
    let frames = r#"axes: (frame: Range(0, 3)),"#;
    let along = r#"moves: Camera(eye: Track("frame", [(0, (2.0, -2.5, 1.2)), (2, (3.0, -2.5, 1.2))]), target: (0.0, 0.0, 0.2),
            width_px: 16, height_px: 9, fov_y_deg: 40.0),
        back: SplatRender(splats: "demo.splats", rig: "moves"),"#;
    let graph_of = |axes: &str, text: String| graph(axes, &text);
    let all = graph_of(frames, format!("{along} {}", TRACE.replace("\"cam\"", "\"moves\"")));
    assert_eq!(found(&all, &[]), ["demo mesh moves/frame=0,moves/frame=1,moves/frame=2 placed"]);
    assert_eq!(found(&all, &["moves/frame=0", "moves/frame=1"]), ["demo mesh moves/frame=2 placed"]);
    assert_eq!(found(&all, &["mesh"]), [""; 0]);
    // Five meshes, and two of them are equal.
    let meshes = r#"axes: (p: List(["a.ply", "b.ply", "c.ply", "d.ply"])),"#;
    let many = TRACE.replace("\"mesh.ply\"", "Axis(\"p\")");
    let back = r#"back: SplatRender(splats: "demo.splats", rig: "cam"),"#;
    let again = r#"same: LoadMesh(path: "a.ply"),
        again: PathTrace(receiver: "same", objects: ["placed"], rig: "cam", env: "light", samples: 2),"#;
    let many = graph_of(meshes, format!("{back} {many} {again}"));
    let mut names = found(&many, &[]);
    names.sort();
    assert_eq!(names.len(), 4, "{names:?}");
    assert!(names.iter().any(|name| name == "demo mesh/p=d.ply cam placed"), "{names:?}");
    // Two places along an axis.
    let places = r#"axes: (p: List(["a.ply", "b.ply"])),"#;
    let scene = r#"scene: LoadSplats(path: Axis("p")), back: SplatRender(splats: "scene", rig: "cam"),"#;
    let both = graph_of(places, format!("{scene} {}", TRACE.replace("\"mesh.ply\"", "Axis(\"p\")")));
    let wanted = ["scene/p=a.ply mesh/p=a.ply cam placed", "scene/p=b.ply mesh/p=b.ply cam placed"];
    assert_eq!(found(&both, &[]), wanted);
    let names: BTreeMap<&str, String> =
        (0..both.nodes.len()).map(|node| (written(&both, node), instance(&both, node))).collect();
    assert_eq!((names["mesh"].as_str(), names["cam"].as_str()), ("`mesh` (at `p=b.ply`)", "`cam`"));
}

#[test]
fn indices_are_spread_evenly() {
    assert_eq!(spread(6, 3), [0, 3, 5]);
    assert_eq!(spread(300, 4), [0, 100, 199, 299]);
    assert_eq!((spread(2, 3), spread(5, 1), spread(5, 0)), (vec![0, 1], vec![0], vec![]));
}
