//! Objects that are added to a graph, and pictures of other graphs.

use serde_json::{Value, json};

use crate::lab::{GRAPH, Lab, digest_of};
use crate::place::{SCENE, scene};

fn add(lab: &Lab, object: &str, place: [f64; 3]) -> (u16, Value) {
    let body = json!({"digest": digest_of(&lab.text()), "object": object, "place": place});
    let response = lab.post("/add", &body.to_string());
    (response.status, response.json())
}

/// This test fails if the wire into `PathTrace` is left out.
#[test]
fn an_object_is_added_by_one_edit() {
    let lab = scene();
    lab.idle();
    assert_eq!(lab.get("/objects").json(), json!(["box.gltf"]));
    let (status, answer) = add(&lab, "box.gltf", [2.0, -1.0, 0.0]);
    assert_eq!((status, &answer["pose"]), (200, &json!("box_pose")), "{answer}");
    assert!((answer["metres"].as_f64().unwrap() - 0.6).abs() < 1e-6, "{answer}");
    // The middle of the foot is 0.05 m in front of the origin of the file, and a unit is half a metre.
    let nodes = "placed: Place(object: \"object\", pose: \"stands.pose\"),
        box: LoadObject(path: \"box.gltf\"),
        box_pose: Pose(translation: (2.0, -0.9, 0.0)),
        box_placed: Place(object: \"box\", pose: \"box_pose\"),";
    let expected = SCENE
        .replace("placed: Place(object: \"object\", pose: \"stands.pose\"),", nodes)
        .replace("objects: [\"placed\"]", "objects: [\"placed\", \"box_placed\"]");
    assert_eq!(lab.text(), expected);
    lab.until("both objects are there", |lab| {
        lab.get("/place").json()["objects"].as_array().is_some_and(|objects| objects.len() == 2)
    });
    // Another one gets another name, and undo gives the bytes of before.
    let (status, answer) = add(&lab, "box.gltf", [0.0, 0.0, 0.0]);
    assert_eq!((status, &answer["pose"]), (200, &json!("box2_pose")), "{answer}");
    for before in [expected.as_str(), SCENE] {
        let undo = json!({"digest": digest_of(&lab.text())}).to_string();
        assert_eq!(lab.post("/undo", &undo).status, 200);
        assert_eq!(lab.text(), before);
    }
}

#[test]
fn an_object_that_cannot_be_added_is_refused_with_the_reason() {
    let lab = scene();
    lab.idle();
    let glb = std::fs::read(lab.folder.path().join("box.gltf")).unwrap();
    std::fs::write(lab.folder.path().join("cut.gltf"), &glb[..glb.len() / 2]).unwrap();
    std::fs::write(lab.folder.path().join("cut.glb"), b"glTF\x02\0\0\0\xff\0\0\0").unwrap();
    for (object, why) in [
        ("cut.gltf", "cut.gltf"),
        ("cut.glb", "cut.glb"),
        ("../box.gltf", "not among"),
        ("floor.obj", "not among"),
    ] {
        let (status, answer) = add(&lab, object, [0.0, 0.0, 0.0]);
        assert_eq!(status, 422, "{object}: {answer}");
        assert!(answer["why"].as_str().unwrap().contains(why), "{object}: {answer}");
    }
    let text = lab.text();
    let stale = json!({"digest": digest_of("other"), "object": "box.gltf", "place": [0.0, 0.0, 0.0]});
    assert_eq!(lab.post("/add", &stale.to_string()).status, 409);
    assert_eq!(lab.text(), text);
    // Without a trace, nothing would show it.
    let bare = Lab::new(GRAPH);
    bare.idle();
    std::fs::write(bare.folder.path().join("box.gltf"), "{}").unwrap();
    assert_eq!(add(&bare, "box.gltf", [0.0; 3]).0, 422);
    assert_eq!(bare.text(), GRAPH);
}

/// A truncated object in `LoadObject`: the node fails with the reason, the page shows the rest, and nothing is written.
#[test]
fn a_truncated_object_in_the_graph_is_named() {
    let lab = scene();
    lab.idle();
    let path = lab.folder.path().join("box.gltf");
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let state = |lab: &Lab| lab.events().until("state");
    lab.until("the node fails", |lab| state(lab)["nodes"]["object"]["status"] == "failed");
    let error = state(&lab)["nodes"]["object"]["error"].to_string();
    assert!(error.contains("box.gltf"), "{error}");
    let place = lab.get("/place").json();
    assert_eq!(place["splats"].as_array().unwrap().len(), 1, "the place is still shown: {place}");
    assert_eq!(lab.text(), SCENE);
    std::fs::write(&path, whole).unwrap();
    lab.until("it is read again", |lab| state(lab)["nodes"]["object"]["error"].is_null());
}

/// This test fails if a picture is given that was not offered, or if none is.
#[test]
fn pictures_of_other_graphs_are_offered_from_the_cache() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let write = |name: &str, text: &str| std::fs::write(lab.folder.path().join(name), text).unwrap();
    std::fs::create_dir(lab.folder.path().join("more")).unwrap();
    std::fs::copy(lab.folder.path().join("demo.ply"), lab.folder.path().join("more/demo.ply")).unwrap();
    // The same picture in another graph, one that was never run, one with a mistake, and no graph.
    write("more/same.ron", &GRAPH.replace("// A small graph.", "// Another graph."));
    write("never.ron", &GRAPH.replace("fov_y_deg: 40.0", "fov_y_deg: 41.0"));
    write("wrong.ron", "Graph(version: 1, nodes: (a: Nothing()))");
    write("notes.txt", "Graph(version: 1, nodes: ())");
    let list = lab.get("/graphs").json();
    assert_eq!(list.as_array().unwrap().len(), 1, "{list}");
    assert_eq!(
        (&list[0]["name"], &list[0]["pictures"][0][0]),
        (&json!("more/same.ron"), &json!("view.colour"))
    );
    let digest = list[0]["pictures"][0][1].as_str().unwrap().to_owned();
    assert_eq!(lab.get(&format!("/value/{digest}")).json()["pictures"][0]["width"], 32);
    // A value of another graph that was not offered is not given: the one of the graph after an edit, once it is gone.
    assert_eq!(lab.get(&format!("/value/{}", digest_of("x"))).status, 404);
}
