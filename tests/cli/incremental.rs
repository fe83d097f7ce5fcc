//! Tests that only the right nodes run again after an edit, according to the events of real runs.

use crate::{INSERT, Place, RunLog};

fn edited(from: &str, to: &str) -> String {
    assert!(INSERT.contains(from), "{from}");
    INSERT.replace(from, to)
}

fn ran(place: &Place, graph: &str) -> RunLog {
    place.write(graph);
    place.run(&[]).good()
}

#[test]
fn edits_rerun_what_they_touch_and_nothing_else() {
    let place = Place::new(INSERT);
    let cold = place.run(&[]).good();
    assert_eq!(cold.nodes("ran").len(), 16);
    let notes = cold.notes();

    let again = place.run(&[]).good();
    assert_eq!(again.nodes("ran"), [""; 0]);
    assert_eq!(again.nodes("cached").len(), 16);
    assert_eq!(again.notes(), notes, "notes are part of the result");

    // Renaming, reordering, comments, layout: nothing.
    let renamed = INSERT.replace("\"shadow\"", "\"schatten\"").replace("shadow: S", "schatten: S");
    let mut lines: Vec<&str> = renamed.lines().collect();
    let (a, b) =
        (lines.iter().position(|l| l.contains("view:")), lines.iter().position(|l| l.contains("pose:")));
    lines.swap(a.unwrap(), b.unwrap());
    let shuffled = lines.join("\n// a comment\n") + "\n";
    assert_eq!(ran(&place, &shuffled).nodes("ran"), [""; 0]);

    // Writing out a default is not an edit.
    let spelt = edited("size_px: 32)", "size_px: 32, guard_deg: 3.0)");
    assert_eq!(ran(&place, &spelt).nodes("ran"), [""; 0]);

    // Touching the graph file: nothing.
    place.write(INSERT);
    assert_eq!(place.run(&[]).good().nodes("ran"), [""; 0]);

    // gamma: the ratio, the composite, and their sinks.
    let gamma = ran(&place, &edited("gamma: 0.8", "gamma: 0.7"));
    assert_eq!(gamma.nodes("ran"), ["final", "layers", "save", "shadow"]);

    // Camera: the view, the trace and the nodes below, not the light.
    let camera = ran(&place, &edited("fov_y_deg: 40.0", "fov_y_deg: 41.0"));
    assert_eq!(camera.nodes("ran"), ["camera", "final", "layers", "save", "shadow", "trace", "view"]);

    // Yaw: the rig of the probe is made again, comes out equal and stops there; R0 is kept.
    let yaw = ran(&place, &edited("yaw_deg: 30.0", "yaw_deg: 35.0"));
    assert_eq!(yaw.nodes("ran"), ["final", "layers", "placed", "pose", "probe", "save", "shadow", "trace"]);
    assert!(!yaw.parts("trace", "cached").is_empty(), "R0 comes from the cache");
    assert!(yaw.parts("trace", "ran").iter().all(|part| *part != "r0"));

    // Translation: the probe and all nodes below it, not the background.
    let moved = ran(&place, &edited("translation: (0.0, 0.0, 0.0)", "translation: (0.1, 0.0, 0.0)"));
    assert_eq!(
        moved.nodes("ran"),
        [
            "dark", "env", "faces", "final", "layers", "light", "pano", "placed", "pose", "probe", "save",
            "shadow", "trace"
        ]
    );

    // Back to the first graph: everything is still known.
    assert_eq!(ran(&place, INSERT).nodes("ran"), [""; 0]);
}

/// A triangle with a side of half a metre, as glTF.
pub(crate) const OBJECT: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],
"bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36,
"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAAAAPwAAAAAAAAAAAAAAAAAAAD8AAAAA"}]}"#;

/// A floor with a step 3 cm high, for an object that stands on the floor.
const FLOOR: &str = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n\
    element face 4\nproperty list uchar int vertex_indices\nend_header\n-3 -3 0\n3 -3 0\n3 3 0\n-3 3 0\n\
    -0.1 -0.1 0.03\n0.1 -0.1 0.03\n0.1 0.1 0.03\n-0.1 0.1 0.03\n3 0 1 2\n3 0 2 3\n3 4 5 6\n3 4 6 7\n";

/// `metres_per_unit` is changed, and the object is scaled so that it keeps its size in the picture. All inputs of
/// the trace then have the same bytes, but `contact_metres` is a different distance in world units. The parts of
/// the trace that depend on this distance run again.
#[test]
fn what_another_metre_changes_is_traced_again() {
    let graph = |metres_per_unit: f64| {
        format!(
            r#"Graph(version: 1, scene: (up: "+z", seed: 3, metres_per_unit: {metres_per_unit:?}), nodes: (
            floor:  LoadMesh(path: "floor.ply"),
            sky:    LoadEnvironment(path: "sky.hdr"),
            sheet:  LoadObject(path: "sheet.gltf"),
            pose:   Pose(translation: (0.0, 0.0, 0.0), scale: {metres_per_unit:?}),
            placed: Place(object: "sheet", pose: "pose"),
            camera: Camera(eye: (0.5, -1.5, 0.7), target: (0.0, 0.0, 0.2), width_px: 48, height_px: 32),
            trace:  PathTrace(receiver: "floor", objects: ["placed"], rig: "camera", env: "sky", samples: 4, contact_metres: 0.02),
            layers: WriteExr(layers: ["trace.with", "trace.object", "trace.nearest"], path: "layers.exr"),
        ))"#
        )
    };
    let place = |metres_per_unit| {
        let place = Place::new(&graph(metres_per_unit));
        std::fs::write(place.path("floor.ply"), FLOOR).unwrap();
        std::fs::write(place.path("sheet.gltf"), OBJECT).unwrap();
        let mut sky = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n".to_vec();
        sky.extend([[128, 128, 128, 129]; 16].as_flattened());
        sky.extend([[64, 64, 64, 129]; 16].as_flattened());
        std::fs::write(place.path("sky.hdr"), sky).unwrap();
        place
    };
    let kept = place(1.0);
    kept.run(&[]).good();
    let before = kept.outputs();
    let scaled = ran(&kept, &graph(0.5));
    assert_eq!(scaled.parts("trace", "cached"), ["r0"]);
    let fresh = place(0.5);
    fresh.run(&[]).good();
    assert_eq!(kept.outputs(), fresh.outputs());
    assert_ne!(kept.outputs(), before, "the step is within 4 cm, not within 2");
}

/// `--exhaustive` is part of the keys of kinds that have checks to skip work, so the nodes of these kinds run
/// again. Since their outputs are equal byte for byte, the nodes downstream of them do not run.
#[test]
fn exhaustive_runs_do_all_work_and_change_nothing() {
    let place = Place::new(INSERT);
    place.run(&[]).good();
    let again = place.run(&["--exhaustive"]).good();
    for node in ["view", "dark", "trace"] {
        assert!(again.nodes("ran").contains(&node), "{node}: {:?}", again.nodes("ran"));
    }
    for node in ["placed", "pano", "env", "shadow"] {
        assert!(again.nodes("cached").contains(&node), "{node}: {:?}", again.nodes("cached"));
    }
    assert_eq!(place.run(&["--exhaustive"]).good().nodes("ran"), [""; 0]);
}

#[test]
fn more_samples_trace_only_the_missing_ones() {
    let place = Place::new(INSERT);
    place.run(&["--set", "trace.samples=4"]).good();
    let more = place.run(&["--set", "trace.samples=80"]).good();
    assert!(more.parts("trace", "cached").contains(&"r0"), "the first samples are kept");
    let many = place.outputs();
    let fresh = Place::new(INSERT);
    fresh.run(&["--set", "trace.samples=80"]).good();
    assert!(fresh.outputs() == many, "4 then 80 samples give the bytes of 80 at once");
}

#[test]
fn plan_and_explain_name_the_cause_with_its_values() {
    let place = Place::new(INSERT);
    place.run(&[]).good();
    place.write(&edited("yaw_deg: 30.0", "yaw_deg: 35.0"));
    let plan = String::from_utf8(place.call(&["plan", "graph.ron"]).stdout).unwrap();
    assert!(plan.contains("`pose.yaw_deg` 30.0 -> 35.0"), "{plan}");
    assert!(plan.lines().last().unwrap().starts_with("8 of 16 nodes may run, about "), "{plan}");
    let explained = String::from_utf8(place.call(&["explain", "graph.ron", "final"]).stdout).unwrap();
    assert!(explained.starts_with("because\n    `pose.yaw_deg` 30.0 -> 35.0\n\n"), "{explained}");
}

#[test]
fn written_files_are_kept_when_equal_and_written_when_not() {
    let place = Place::new(INSERT);
    place.run(&[]).good();
    let first = place.outputs();
    std::fs::remove_file(place.path("out/final.png")).unwrap();
    std::fs::write(place.path("out/light.json"), "someone else's").unwrap();
    let again = place.run(&[]).good();
    assert_eq!(again.nodes("ran"), [""; 0], "files are written without running nodes");
    let mut written: Vec<&str> = again
        .events
        .iter()
        .filter(|event| event["event"] == "file" && event["written"] == true)
        .filter_map(|event| event["id"].as_str())
        .collect();
    written.sort_unstable();
    assert_eq!(written, ["light", "save"]);
    assert!(place.outputs() == first);
}

/// A picture of 2 by 2 pixels with alpha.
const SMALL_PNG: [u8; 78] = [
    137, 80, 78, 71, 13, 10, 26, 10, 0, 0, 0, 13, 73, 72, 68, 82, 0, 0, 0, 2, 0, 0, 0, 2, 8, 6, 0, 0, 0, 114,
    182, 13, 36, 0, 0, 0, 21, 73, 68, 65, 84, 120, 156, 99, 96, 136, 58, 209, 192, 37, 34, 247, 159, 65, 3,
    202, 0, 0, 49, 161, 5, 227, 156, 127, 5, 100, 0, 0, 0, 0, 73, 69, 78, 68, 174, 66, 96, 130,
];

/// An edit of the last node of a chain takes time in proportion to the number of nodes, with all checks after the run. This
/// test fails if the search for what is behind a composite walks up the chain for each composite.
#[test]
fn an_edit_of_a_large_graph_takes_time_in_proportion_to_its_nodes() {
    let graph = |count: usize, last: usize| {
        let node = |number: usize| {
            let below = number.checked_sub(1).map_or("in".to_owned(), |below| format!("n{below}"));
            let lift = if number + 1 == count { last } else { number };
            format!(
                "n{number}: Composite(background: \"{below}\", object: \"in\", backdrop: ({lift}e-5, 0.5, 0.2)),\n"
            )
        };
        let nodes: String = (0..count).map(node).collect();
        format!(
            "Graph(version: 1, scene: (up: \"+z\"), nodes: (in: LoadImage(path: \"in.png\"),\n{nodes}\
             save: WriteExr(image: \"n{}\", path: \"out.exr\"),))",
            count - 1
        )
    };
    let least = |count: usize| {
        let place = Place::new(&graph(count, 70_000));
        std::fs::write(place.path("in.png"), SMALL_PNG).unwrap();
        place.run(&[]).good();
        let edits = (1..5).map(|edit| {
            place.write(&graph(count, 70_000 + edit));
            let start = std::time::Instant::now();
            assert_eq!(place.run(&[]).good().nodes("ran").len(), 2);
            start.elapsed()
        });
        edits.min().unwrap_or_default()
    };
    let (few, many) = (least(300), least(3_000));
    assert!(many < 20 * few.max(std::time::Duration::from_millis(20)), "{few:?} and {many:?}");
}
