//! Tests of whole graphs with files as other tools write them.

use std::fmt::Write as _;

use crate::{INSERT, Place};

/// A few round splats around the origin, as INRIA PLY in ASCII.
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

/// An axis of numbers selects the cameras of a file one after the other, and each gives a picture.
#[test]
fn an_axis_with_a_range_takes_one_camera_after_the_other() {
    let place = Place::new(
        r#"Graph(version: 1, axes: (v: Range(0, 3)), scene: (up: "+z", seed: 1), nodes: (
            scene: LoadSplats(path: "ball.ply"),
            cam:   LoadCameras(path: "ring.json", pick: [Axis("v")], resolution: 0.5),
            view:  SplatRender(splats: "scene", rig: "cam"),
            save:  WriteImage(image: "view.colour", path: "{v}.png"),
        ))"#,
    );
    std::fs::write(place.path("ball.ply"), ball()).unwrap();
    let frames: Vec<String> = (0..3)
        .map(|i| {
            format!(
                r#"{{"file_path": "images\\{i}.jpg", "transform_matrix":
                [[1,0,0,{i}],[0,0,-1,-4],[0,1,0,0],[0,0,0,1]]}}"#
            )
        })
        .collect();
    let text = format!(r#"{{"w": 40, "h": 30, "camera_angle_x": 0.8, "frames": [{}]}}"#, frames.join(","));
    std::fs::write(place.path("ring.json"), format!("\u{feff}{text}")).unwrap();
    place.run(&[]).good();
    let pictures: Vec<Vec<u8>> =
        (0..3).map(|i| std::fs::read(place.path(&format!("out/{i}.png"))).unwrap()).collect();
    assert!(pictures[0] != pictures[1] && pictures[1] != pictures[2]);
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
        found.len() == 1 && found[0].contains("with the mesh scaled by 100.0 they agree to"),
        "{found:?}"
    );
    // The loader has a matrix already, which the new one includes.
    assert!(found[0].ends_with("set `matrix: Some((1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0))` on `small`"), "{found:?}");
}
