//! Tests of whole graphs that read files in the form in which other tools write them.

use std::fmt::Write as _;

use crate::{INSERT, Place};

/// An ASCII INRIA PLY file with a few round splats around the origin.
fn ball() -> String {
    let fields = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let mut text = "ply\nformat ascii 1.0\nelement vertex 20\n".to_owned();
    fields.split(' ').for_each(|name| writeln!(text, "property float {name}").unwrap());
    text.push_str("end_header\n");
    for i in 0..20 {
        let v = f64::from(i) / 10.0 - 0.95;
        writeln!(text, "{v} {} {} 0.5 0.5 0.5 2 -2 -2 -2 1 0 0 0", -v, v * v).unwrap();
    }
    text
}

/// A camera file in the form that nerfstudio writes on Windows, with `count` cameras next to each other.
fn ring(count: usize, size: [u32; 2]) -> String {
    let frames: Vec<String> = (0..count)
        .map(|i| {
            format!(
                r#"{{"file_path": "images\\shot_{i}.jpg", "transform_matrix":
                [[1,0,0,{}],[0,0,-1,-4],[0,1,0,0],[0,0,0,1]]}}"#,
                i as f64 / 8.0
            )
        })
        .collect();
    let [w, h] = size;
    format!("\u{feff}{{\"w\": {w}, \"h\": {h}, \"camera_angle_x\": 0.8, \"frames\": [{}]}}", frames.join(","))
}

/// A graph that renders the cameras of a file one after the other.
const VIEWS: &str = r#"Graph(version: 1, axes: (frame: Cameras("rig")), scene: (up: "+z", seed: 1), nodes: (
    scene: LoadSplats(path: "ball.ply"),
    rig:   LoadCameras(path: "ring.json"),
    cam:   PickCameras(rig: "rig", pick: [Axis("frame")]),
    view:  SplatRender(splats: "scene", rig: "cam"),
    save:  WriteImage(image: "view.colour", path: "{frame}_{view}.png"),
))"#;

fn pictures(place: &Place) -> Vec<String> {
    place.outputs().into_keys().collect()
}

/// An axis over the cameras of a file renders one camera after the other; a range selects some of them. If one
/// camera is edited, only this camera is rendered again. An axis of numbers can also pick cameras.
#[test]
fn the_cameras_of_a_file_are_an_axis() {
    let place = Place::new(VIEWS);
    std::fs::write(place.path("ball.ply"), ball()).unwrap();
    std::fs::write(place.path("ring.json"), ring(12, [40, 30])).unwrap();
    place.run(&["--frames", "1-2"]).good();
    assert_eq!(pictures(&place), ["01_shot_1.png", "02_shot_2.png"]);
    place.run(&["--only", "save/frame=2..4"]).good();
    assert_eq!(pictures(&place).len(), 4);
    place.run(&[]).good();
    let bytes = |i: usize| std::fs::read(place.path(&format!("out/{i:02}_shot_{i}.png"))).unwrap();
    assert_eq!(pictures(&place).len(), 12);
    assert!((0..11).all(|i| bytes(i) != bytes(i + 1)));
    // One camera moves, and one is added.
    let moved = ring(13, [40, 30]).replace("[[1,0,0,0.375]", "[[1,0,0,0.4]");
    std::fs::write(place.path("ring.json"), moved).unwrap();
    let log = place.run(&[]).good();
    let ran = log.nodes("ran").into_iter().filter(|id| id.starts_with("view/")).collect::<Vec<_>>();
    assert_eq!(ran, ["view/frame=12", "view/frame=3"]);
    assert_eq!(pictures(&place).len(), 13);
    let numbers = VIEWS.replace("Cameras(\"rig\")", "Range(5, 7)");
    place.write(&numbers.replace("PickCameras(rig: \"rig\", ", "LoadCameras(path: \"ring.json\", "));
    place.run(&[]).good();
}

/// With an axis over the cameras, a graph of 300 views needs the memory for one view, not for 300.
#[test]
fn three_hundred_views_do_not_ask_for_the_memory_of_all() {
    let place = Place::new(VIEWS);
    std::fs::write(place.path("ball.ply"), ball()).unwrap();
    std::fs::write(place.path("ring.json"), ring(300, [1920, 1080])).unwrap();
    place.run(&["--frames", "299-299", "--memory", "4G"]).good();
    assert_eq!(pictures(&place), ["299_shot_299.png"]);
    assert_eq!(place.call(&["plan", "graph.ron", "--memory", "4G"]).status.code(), Some(0));
    // Without an axis, all views are one value.
    let whole = VIEWS.replace("rig: \"cam\"", "rig: \"rig\"").replace("{frame}_", "");
    place.write(&whole.replace("axes: (frame: Cameras(\"rig\")), ", "").replace("[Axis(\"frame\")]", "[0]"));
    let failed = place.run(&["--memory", "4G"]);
    let errors: Vec<&str> = failed.events.iter().filter_map(|event| event["error"].as_str()).collect();
    assert!(errors.concat().contains("but the budget is 4"), "{errors:?}");
}

/// A mesh in metres that is read in centimetres is reported; a mesh that agrees with the splats is not.
#[test]
fn a_mesh_of_another_frame_is_reported() {
    let reports = |place: &Place| -> Vec<String> {
        let log = place.run(&[]).good();
        let is_one =
            |event: &&serde_json::Value| event["event"] == "warning" && event["id"] == "mesh-elsewhere";
        log.events.iter().filter(is_one).map(|event| event["text"].as_str().unwrap().to_owned()).collect()
    };
    let write = r#"
        write:  WriteMesh(mesh: "demo.proxy", path: "proxy.ply"),
        view:"#;
    // So few splats as in `INSERT` show little but the ground, which fits a ground of any size.
    let insert = INSERT.replace("splats: 4000", "splats: 20000");
    let place = Place::new(&insert.replace("\n        view:", write));
    assert_eq!(reports(&place), [""; 0]);
    let load = r#"
        small:  LoadMesh(path: "out/proxy.ply", matrix: Some((0.01, 0.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 1.0))),
        view:"#;
    let receiver = |text: String| text.replace("receiver: \"demo.proxy\"", "receiver: \"small\"");
    place.write(&receiver(insert.replace("\n        view:", load)));
    let found = reports(&place);
    assert!(
        found.len() == 1 && found[0].contains("with the mesh scaled by 100.0, the agreement is"),
        "{found:?}"
    );
    // Every run reports it: one that finds all results in the cache, and one that does not even parse the graph.
    for _ in 0..3 {
        assert_eq!(reports(&place), found);
    }
    // So does a run after `show` has computed all results.
    let other = |text: String| {
        receiver(text).replace("Some((0.01, 0.0", "Some((0.1, 0.0").replace(", 0.01, 0.0", ", 0.1, 0.0")
    };
    let smaller = other(insert.replace("\n        view:", load));
    place.write(&smaller);
    let shown = place.call(&["show", "graph.ron", "final", "-o", "shown.png"]);
    assert!(shown.status.success(), "{shown:?}");
    let after = reports(&place);
    assert!(after.len() == 1 && after[0].contains("with the mesh scaled by 10.0"), "{after:?}");
    // The loader has a matrix already, which the new one includes.
    assert!(found[0].ends_with("set `matrix: Some((1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0))` on `small`"), "{found:?}");
}
