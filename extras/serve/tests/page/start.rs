//! The start from a bare capture: the starter gets the graph as its text is now.

use std::sync::{Arc, Mutex};

use engine::Graph;
use serde_json::{Value, json};
use serve::{Bare, Proposal, Stand, Starter};

use crate::lab::{Lab, digest_of};

const BARE: &str = r#"Graph(
    version: 1,
    scene: (up: "-y", metres_per_unit: 1.0), // a guess
    nodes: (
        scene:  LoadSplats(path: "demo.ply"),
        camera: Camera(eye: (2.0, -2.5, 1.2), target: (0.0, 0.0, 0.2), width_px: 32, height_px: 18),
        view:   SplatRender(splats: "scene", rig: "camera"),
        save:   WriteImage(image: "view.colour", path: "view.png"),
    ),
)
"#;

/// A starter that notes the up axis and the scale of each graph that it gets.
#[derive(Clone, Default)]
struct Noted(Arc<Mutex<Vec<(&'static str, f64)>>>);

impl Noted {
    fn note(&self, now: &Graph) -> String {
        let seen = (now.scene.up.name(), now.scene.metres_per_unit);
        self.0.lock().unwrap().push(seen);
        format!("up: \"{}\", metres_per_unit: {:?}", seen.0, seen.1)
    }
}

impl Starter for Noted {
    fn bare(&self, now: &Graph) -> Bare {
        let value = format!("{} m per unit", now.scene.metres_per_unit);
        Bare { proposals: vec![Proposal { what: "scale".to_owned(), value }], up: Some("-y") }
    }

    fn objects(&self) -> Vec<String> {
        vec!["good.glb".to_owned(), "cut.glb".to_owned()]
    }

    fn graph(&self, now: &Graph, object: &str, _: &Stand) -> Result<String, String> {
        if object == "cut.glb" {
            return Err("`cut.glb`: the file is truncated".to_owned());
        }
        let scene = self.note(now);
        let pose = "pose: Pose(translation: (0.0, 0.0, 0.5)),";
        Ok(BARE
            .replace("up: \"-y\", metres_per_unit: 1.0", &scene)
            .replace("camera: ", &format!("{pose} camera: ")))
    }

    fn turned(&self, now: &Graph, up: &str) -> Result<String, String> {
        self.note(now);
        Ok(BARE.replace("\"-y\"", "\"+z\"").replace("// a guess", &format!("// {up}")))
    }
}

fn lab() -> (Lab, Noted) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("graph.ron"), BARE).unwrap();
    let noted = Noted::default();
    let lab = Lab::started(Arc::new(folder), None, Some(Box::new(noted.clone()))).unwrap();
    lab.idle();
    (lab, noted)
}

fn start(lab: &Lab, object: &str) -> (u16, Value) {
    let stand = json!({"place": [0.0, 0.0, 0.0], "eye": [1.0, 1.0, 1.0], "target": [0.0, 0.0, 0.0], "fov_y_deg": 40.0});
    let body = json!({"digest": digest_of(&lab.text()), "object": object, "stand": stand});
    let response = lab.post("/start", &body.to_string());
    (response.status, response.json())
}

/// This test fails if `/start` passes on the graph that was read first.
#[test]
fn a_scale_and_an_up_axis_that_were_set_reach_the_first_graph() {
    let (lab, noted) = lab();
    let begin = lab.get("/place").json()["start"].clone();
    assert_eq!((&begin["up"], begin["axes"].as_array().unwrap().len()), (&json!("-y"), 6));
    assert_eq!(begin["proposals"][0]["value"], "1 m per unit");
    // As by *Measure*, and at once the click on the floor.
    assert_eq!(lab.set("scene", "metres_per_unit", &[], Some("0.025")).status, 200);
    // As in an editor.
    std::fs::write(lab.path(), lab.text().replace("up: \"-y\"", "up: \"+y\"")).unwrap();
    let (status, answer) = start(&lab, "good.glb");
    assert_eq!(status, 200, "{answer}");
    assert_eq!(*noted.0.lock().unwrap(), [("+y", 0.025)]);
    assert!(lab.text().contains("scene: (up: \"+y\", metres_per_unit: 0.025)"), "{}", lab.text());
    lab.until("the page follows", |lab| lab.digest() == digest_of(&lab.text()));
}

#[test]
fn a_capture_is_turned_and_turned_back() {
    let (lab, noted) = lab();
    let turn = |up: &str| {
        let body = json!({"digest": digest_of(&lab.text()), "up": up});
        lab.post("/up", &body.to_string())
    };
    for wrong in ["", "up", "+w", "../x"] {
        let refused = turn(wrong);
        assert_eq!((refused.status, lab.text().as_str()), (422, BARE), "{wrong}");
    }
    assert_eq!(turn("-x").status, 200);
    assert!(lab.text().contains("up: \"+z\"") && lab.text().contains("// -x"), "{}", lab.text());
    assert_eq!(noted.0.lock().unwrap().len(), 1);
    let undo = json!({"digest": digest_of(&lab.text())}).to_string();
    assert_eq!(lab.post("/undo", &undo).status, 200);
    assert_eq!(lab.text(), BARE);
    let stale = json!({"digest": digest_of("other"), "up": "+x"}).to_string();
    assert_eq!(lab.post("/up", &stale).status, 409);
    // Not a page that was started from a capture.
    let other = Lab::new(BARE);
    other.idle();
    let refused = other.post("/up", &json!({"digest": digest_of(BARE), "up": "+x"}).to_string());
    assert_eq!(refused.status, 422);
    assert!(refused.json()["why"].as_str().unwrap().contains("not started from a bare capture"));
}

#[test]
fn a_damaged_object_is_named_and_nothing_is_written() {
    let (lab, _) = lab();
    let (status, answer) = start(&lab, "cut.glb");
    assert_eq!(status, 422);
    assert!(answer["why"].as_str().unwrap().contains("truncated"), "{answer}");
    let (status, answer) = start(&lab, "../secret.glb");
    assert_eq!(status, 422);
    assert!(answer["why"].as_str().unwrap().contains("not among the files"), "{answer}");
    assert_eq!(lab.text(), BARE);
}
