//! Tests of `init` with the user's files: the graph can be checked and run, whatever the names of the files are.

use std::fmt::Write as _;

use crate::Place;
use crate::incremental::OBJECT;

/// An INRIA PLY file of a yard of 8 by 8 units that has walls on two sides and contains a box. The up axis is -y,
/// rotated by `tilt` about z.
fn yard(tilt: f64) -> Vec<u8> {
    let fields = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let mut rows: Vec<[f32; 14]> = Vec::new();
    let unit = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 10_007) as f64 / 10_006.0 - 0.5;
    // Middle, half sides along x, y (down) and z, and the axis that is thin.
    let mut sheet = |count: usize, middle: [f64; 3], half: [f64; 3], thin: usize, shade: f32| {
        for i in 0..count {
            let [x, y, z] = [0, 1, 2].map(|k| middle[k] + 2.0 * half[k] * unit(i, k + 1));
            let (s, c) = scene::math::num::sin_cos(tilt);
            let mean = [x * c - y * s, x * s + y * c, z].map(|v| v as f32);
            let scale = [0, 1, 2].map(|k| if k == thin { -7.0 } else { -2.8 });
            let (half_s, half_c) = scene::math::num::sin_cos(0.5 * tilt);
            let quat = [half_c, 0.0, 0.0, half_s].map(|v| v as f32);
            let mut row = [0.0; 14];
            row[..3].copy_from_slice(&mean);
            row[3..7].copy_from_slice(&[shade, shade, shade, 2.5]);
            row[7..10].copy_from_slice(&scale);
            row[10..].copy_from_slice(&quat);
            rows.push(row);
        }
    };
    sheet(4000, [0.0; 3], [4.0, 0.0, 4.0], 1, -0.4);
    sheet(1600, [4.0, -1.2, 0.0], [0.0, 1.2, 4.0], 0, 0.5);
    sheet(1600, [0.0, -1.2, 4.0], [4.0, 1.2, 0.0], 2, 0.5);
    sheet(500, [2.0, -0.6, 2.0], [0.5, 0.0, 0.5], 1, 0.2);
    sheet(500, [1.5, -0.3, 2.0], [0.0, 0.3, 0.5], 0, 0.2);
    let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", rows.len());
    fields.split(' ').for_each(|name| writeln!(text, "property float {name}").unwrap());
    text.push_str("end_header\n");
    let mut bytes = text.into_bytes();
    rows.iter().flatten().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
    bytes
}

fn said(place: &Place, arguments: &[&str]) -> String {
    let output = place.call(arguments);
    let text = String::from_utf8([&output.stdout[..], &output.stderr[..]].concat()).unwrap();
    assert_eq!(output.status.code(), Some(0), "{text}");
    text
}

#[test]
fn files_of_the_user_become_a_graph_that_can_be_checked() {
    for (tilt, up, matrix) in [(0.0, "up: \"-y\"", false), (0.35, "up: \"+z\"", true)] {
        let place = Place::new("");
        std::fs::create_dir(place.path("my captures")).unwrap();
        std::fs::write(place.path("my captures/a \"yard\" \\ {1}.ply"), yard(tilt)).unwrap();
        std::fs::write(place.path("sheet.gltf"), OBJECT).unwrap();
        let splats = "my captures/a \"yard\" \\ {1}.ply";
        let text = said(&place, &["init", "new one/deep", "--splats", splats, "--object", "sheet.gltf"]);
        assert!(text.contains(", sure (0.9") && text.contains("NOT KNOWN"), "{text}");
        let graph = std::fs::read_to_string(place.path("new one/deep/graph.ron")).unwrap();
        assert!(graph.contains(up) && graph.contains("matrix: (") == matrix, "{graph}");
        assert!(graph.contains(r#"path: "../../my captures/a \"yard\" \\ {1}.ply""#), "{graph}");
        said(&place, &["check", "new one/deep/graph.ron"]);
        // Each assumption names the line to edit.
        for line in text.lines().filter(|line| line.ends_with(']')) {
            let number: usize = line.rsplit(':').next().unwrap().trim_end_matches(']').parse().unwrap();
            assert!((1..=graph.lines().count()).contains(&number), "{line}");
        }
        let text = said(&place, &["run", "new one/deep/graph.ron", "--only", "view"]);
        assert!(!text.contains("warning"), "{text}");
    }
}

#[test]
fn files_that_cannot_be_used_leave_no_graph() {
    let place = Place::new("");
    std::fs::write(place.path("a.ply"), yard(0.0)).unwrap();
    std::fs::write(place.path("sheet.gltf"), OBJECT).unwrap();
    for arguments in [
        ["--splats", "none.ply", "--object", "sheet.gltf"],
        ["--splats", "sheet.gltf", "--object", "sheet.gltf"],
        ["--splats", "a.ply", "--object", "a.ply"],
    ] {
        let output = place.call(&[&["init", "new"][..], &arguments].concat());
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(!place.path("new/graph.ron").exists());
    }
    let output = place.call(&["init", "new", "--splats", "a.ply"]);
    assert_eq!(output.status.code(), Some(2), "an object is missing");
    let output = place.call(&["init", "new", "--splats", "sheet.gltf", "--object", "a.ply"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("are they exchanged?"));
    // A camera beyond the yard that looks away from it.
    let camera = r#"[{"id": 0, "img_name": "a", "width": 64, "height": 48, "position": [0.0, -1.0, 50.0],
        "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 60.0, "fy": 60.0}]"#;
    std::fs::write(place.path("cameras.json"), camera).unwrap();
    let files = ["--splats", "a.ply", "--object", "sheet.gltf", "--cameras", "cameras.json"];
    let output = place.call(&[&["init", "new"][..], &files].concat());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(1) && text.contains("see only 0.00 % of the splats"), "{text}");
}

/// The file of an object whose largest side is 50 m.
#[test]
fn a_very_large_object_is_taken_as_centimetres() {
    let place = Place::new("");
    std::fs::write(place.path("a.ply"), yard(0.0)).unwrap();
    let large = OBJECT.replace(r#"{"mesh":0}"#, r#"{"mesh":0,"scale":[100,100,100]}"#);
    std::fs::write(place.path("sheet.gltf"), large).unwrap();
    let text = said(&place, &["init", "new", "--splats", "a.ply", "--object", "sheet.gltf"]);
    assert!(text.contains("50 m in its file, TAKEN AS CENTIMETRES: 0.50 m"), "{text}");
    let graph = std::fs::read_to_string(place.path("new/graph.ron")).unwrap();
    assert!(graph.contains("scale: 0.01),"), "{graph}");
}

/// Turning the object changes neither the mesh of the place nor the light.
#[test]
fn only_a_moved_object_needs_another_mesh() {
    let place = Place::new("");
    std::fs::write(place.path("a.ply"), yard(0.0)).unwrap();
    std::fs::write(place.path("sheet.gltf"), OBJECT).unwrap();
    said(&place, &["init", "new", "--splats", "a.ply", "--object", "sheet.gltf"]);
    let run = |set: &str| {
        let fixed = ["run", "new/graph.ron", "--preset", "draft", "--only", "fused", "--only", "proxy"];
        said(&place, &[&fixed[..], &["--verbose", "--set", set]].concat())
    };
    let first = run("pose.yaw_deg=5.0");
    assert!(first.contains("ran proxy") && first.contains("ran fused"), "{first}");
    let turned = run("pose.yaw_deg=90.0");
    assert!(!turned.contains("ran proxy") && !turned.contains("ran fused"), "{turned}");
    let larger = run("pose.scale=0.7");
    assert!(!larger.contains("ran proxy") && !larger.contains("ran fused"), "{larger}");
    let moved = run("pose.translation=(0.5, 0.0, 0.5)");
    assert!(moved.contains("ran proxy") && moved.contains("ran fused"), "{moved}");
}

#[test]
fn inspect_draws_a_plan_and_views_with_their_cameras() {
    let place = Place::new("");
    std::fs::write(place.path("a.ply"), yard(0.35)).unwrap();
    let text = said(&place, &["inspect", "a.ply", "--picture", "look.png"]);
    assert!(text.contains("view 1  Camera(eye: (") && text.contains("matrix: ("), "{text}");
    assert!(std::fs::read(place.path("look.png")).unwrap().starts_with(b"\x89PNG"));
}
