//! Tests of the comparison of splats, mesh and object after a run.

use std::fmt::Write as _;

use crate::{INSERT, Place, RunLog};

/// Texts of the warnings with the given id.
fn warnings(log: &RunLog, id: &str) -> Vec<String> {
    let is_one = |event: &&serde_json::Value| event["event"] == "warning" && event["id"] == id;
    log.events.iter().filter(is_one).map(|event| event["text"].as_str().unwrap().to_owned()).collect()
}

/// [`INSERT`] with enough splats for a comparison, with only the sink `save`, and with `from` replaced by `to`.
fn insert(changes: &[(&str, &str)]) -> String {
    let mut text = INSERT.replace("splats: 4000", "splats: 20000");
    let sinks = text.find("        layers: WriteExr").unwrap()..text.find("    ),\n)\n").unwrap();
    text.replace_range(sinks, "");
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    text
}

/// A folder with the mesh of the place of [`INSERT`] as `a.ply` and `b.ply`, the same mesh in centimetres as
/// `cm.ply`, and a picture `photo.png`.
fn with_meshes() -> Place {
    let write = r#"write: WriteMesh(mesh: "demo.proxy", path: "mesh.ply"),
        save:"#;
    let place = Place::new(&insert(&[("save:", write)]));
    place.run(&[]).good();
    std::fs::copy(place.path("out/mesh.ply"), place.path("a.ply")).unwrap();
    let small = r#"small: LoadMesh(path: "a.ply", matrix: Some((0.01, 0.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 1.0))),
        write: WriteMesh(mesh: "small", path: "mesh.ply"),
        save:"#;
    place.write(&insert(&[("save:", small)]));
    place.run(&["--only", "write"]).good();
    for (from, to) in [("a.ply", "b.ply"), ("out/mesh.ply", "cm.ply"), ("out/final.png", "photo.png")] {
        std::fs::copy(place.path(from), place.path(to)).unwrap();
    }
    place
}

const RECEIVER: (&str, &str) = ("receiver: \"demo.proxy\"", "receiver: \"mesh\"");
const MESH: (&str, &str) = ("save:", "mesh: LoadMesh(path: \"cm.ply\"),\n        save:");
const VIEW: &str = r#"view:   SplatRender(splats: "demo.splats", rig: "camera"),"#;

/// A mesh of another frame is reported by a run of some frames, by a run of some nodes, and however the graph
/// connects splats and mesh.
#[test]
fn a_mesh_of_another_frame_is_reported_by_every_run() {
    let place = with_meshes();
    let is_reported = |arguments: &[&str]| {
        let found = warnings(&place.run(arguments).good(), "mesh-elsewhere");
        assert_eq!(found.len(), 1, "{arguments:?}: {found:?}");
        assert!(found[0].contains("with the mesh scaled by 100.0"), "{arguments:?}: {found:?}");
        assert!(found[0].ends_with("on `mesh`"), "{arguments:?}: {found:?}");
    };
    // Frames, each with its own camera.
    let frames = [
        RECEIVER,
        MESH,
        ("version: 1,", "version: 1, axes: (frame: Range(0, 6)),"),
        ("eye: (2.0, -2.5, 1.2)", "eye: Track(\"frame\", [(0, (2.0, -2.5, 1.2)), (5, (2.5, -2.0, 1.2))])"),
        ("\"final.png\"", "\"{frame}.png\""),
    ];
    place.write(&insert(&frames));
    for arguments in
        [&["--frames", "4-5"][..], &["--only", "save/frame=2"], &["--frames", "0-1"], &[], &[], &[]]
    {
        is_reported(arguments);
    }
    // Equal cameras, a picked camera, and a photograph as the background, with splats only for the light.
    let other = r#"other: Camera(eye: (2.0, -2.5, 1.2), target: (0.0, 0.0, 0.2), width_px: 96, height_px: 54, fov_y_deg: 40.0),
        view: SplatRender(splats: "demo.splats", rig: "other"),"#;
    let picked = r#"picked: PickCameras(rig: "camera", pick: ["camera"]),
        view: SplatRender(splats: "demo.splats", rig: "picked"),"#;
    for view in [other, picked, r#"view: LoadImage(path: "photo.png"),"#] {
        place.write(&insert(&[RECEIVER, MESH, (VIEW, view)]));
        is_reported(&[]);
    }
}

/// Each mesh of a graph is compared. The advice names the node as the graph file does.
#[test]
fn the_third_mesh_is_compared() {
    let place = with_meshes();
    let many = [
        RECEIVER,
        ("version: 1,", r#"version: 1, axes: (p: List(["a.ply", "b.ply", "cm.ply"])),"#),
        ("save:", "mesh: LoadMesh(path: Axis(\"p\")),\n        save:"),
        ("\"final.png\"", "\"{p}.png\""),
    ];
    place.write(&insert(&many));
    let found = warnings(&place.run(&[]).good(), "mesh-elsewhere");
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].contains("the mesh `mesh` (at `p=cm.ply`)"), "{found:?}");
    assert!(found[0].ends_with("on `mesh`"), "{found:?}");
    let agrees = place.run(&["--only", "save/p=b.ply"]).good();
    assert_eq!(warnings(&agrees, "mesh-elsewhere"), [""; 0]);
}

/// A floor, and a post between the object and the last two of seven cameras. The mesh has only the floor.
const POST: &str = r#"Graph(version: 1, scene: (up: "+z", seed: 1), nodes: (
    scene:  LoadSplats(path: "post.ply"),
    object: LoadObject(path: "cube.obj"),
    pose:   Pose(),
    placed: Place(object: "object", pose: "pose"),
    mesh:   Plane(at: "pose", splats: "scene"),
    probe:  CubeRig(at: "pose", height_metres: 0.3, size_px: 16),
    faces:  SplatRender(splats: "scene", rig: "probe"),
    pano:   Stitch(views: "faces", width_px: 64),
    dark:   PredictExposure(pano: "pano", evs: [-6.0, -3.0], method: Region),
    env:    FuseHdr(base: "pano", brackets: "dark"),
    rig:    LoadCameras(path: "ring.json"),
    view:   SplatRender(splats: "scene", rig: "rig"),
    trace:  PathTrace(receiver: "mesh", objects: ["placed"], rig: "rig", env: "env", samples: 1),
    layer:  SplatRender(splats: "scene", rig: "rig", limit: "trace.nearest"),
    shadow: ShadowRatio(without: "trace.without", with: "trace.with"),
    final:  Composite(background: "view", object: "trace.object", shadow: "shadow"),
    save:   WriteImage(image: "final", path: "{view}.png"),
    front:  WriteImage(image: "layer.colour", path: "front_{view}.png"),
))"#;

/// Writes the files of [`POST`].
fn with_post() -> Place {
    let place = Place::new(POST);
    let floor =
        (0..31 * 31).map(|i| [f64::from(i % 31) * 0.1 - 1.5, f64::from(i / 31) * 0.2 - 3.0, 0.0, -2.3, -4.0]);
    let post =
        (0..5 * 25).map(|i| [0.5 + 0.05 * f64::from(i % 5), -2.0, 0.05 * f64::from(i / 5), -3.0, -3.0]);
    let all: Vec<[f64; 5]> = floor.chain(post).collect();
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", all.len());
    for name in
        "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split(' ')
    {
        writeln!(text, "property float {name}").unwrap();
    }
    text.push_str("end_header\n");
    for [x, y, z, wide, high] in all {
        writeln!(text, "{x} {y} {z} 0.5 0.5 0.5 6 {wide} {wide} {high} 1 0 0 0").unwrap();
    }
    std::fs::write(place.path("post.ply"), text).unwrap();
    let mut cube = String::new();
    for i in 0..8 {
        let [x, y, z] = [i / 4, i / 2 % 2, i % 2].map(|bit| f64::from(bit) * 0.5);
        writeln!(cube, "v {} {y} {}", x - 0.25, z - 0.25).unwrap();
    }
    cube.push_str("f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n");
    std::fs::write(place.path("cube.obj"), cube).unwrap();
    let frame = |i: u32| {
        let x = f64::from(i) * 0.4 - 1.2;
        format!(
            r#"{{"file_path": "shot_{i}.jpg", "transform_matrix": [[1,0,0,{x}],[0,0,-1,-4],[0,1,0,0.6],[0,0,0,1]]}}"#
        )
    };
    let frames: Vec<String> = (0..7).map(frame).collect();
    let cameras = format!(r#"{{"w": 64, "h": 48, "camera_angle_x": 0.8, "frames": [{}]}}"#, frames.join(","));
    std::fs::write(place.path("ring.json"), cameras).unwrap();
    place
}

/// Splats in front of an object are found in every view of a rig and in every frame, for each `Composite` without
/// `front`.
#[test]
fn splats_before_an_object_are_found_in_every_view() {
    let place = with_post();
    let reports = |arguments: &[&str]| warnings(&place.run(arguments).good(), "splats-before-object");
    let found = reports(&[]);
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(
        found[0].starts_with("`view` and `trace`: in the view `shot_6`, splats are in front"),
        "{found:?}"
    );
    assert!(found[0].ends_with("wire `layer` to `front` of `final`"), "{found:?}");
    // Again from the cache, and by a run that does not even parse the graph.
    for _ in 0..2 {
        assert_eq!(reports(&[]), found);
    }
    // Wired, but there is another `Composite`.
    let wired = POST.replace("shadow: \"shadow\")", "shadow: \"shadow\", front: \"layer\")");
    place.write(&wired);
    assert_eq!(reports(&[]), [""; 0]);
    let other = r#"bare: Composite(background: "view", object: "trace.object"),
    second: WriteImage(image: "bare", path: "bare_{view}.png"),
    save:"#;
    place.write(&wired.replace("save:", other));
    assert!(reports(&[])[0].ends_with("wire `layer` to `front` of `bare`"));
    assert_eq!(reports(&["--only", "save"]), [""; 0]);
    // Frames.
    let frames = POST
        .replace("version: 1,", "version: 1, axes: (frame: Cameras(\"rig\")),")
        .replace("rig: \"rig\"", "rig: \"cam\"")
        .replace("    view: ", "    cam: PickCameras(rig: \"rig\", pick: [Axis(\"frame\")]),\n    view: ");
    place.write(&frames.replace("{view}", "{frame}"));
    assert_eq!(reports(&["--frames", "0-4"]), [""; 0]);
    let fifth = reports(&["--frames", "5-5"]);
    assert!(fifth.len() == 1 && fifth[0].contains("in the view `shot_5` at `frame=5`"), "{fifth:?}");
    for _ in 0..3 {
        let all = reports(&[]);
        assert!(all.len() == 1 && all[0].contains("in the view `shot_6` at `frame=6`"), "{all:?}");
        assert!(all[0].contains("the largest share of 2 pictures"), "{all:?}");
    }
}
