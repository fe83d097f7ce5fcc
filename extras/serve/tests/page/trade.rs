//! Knobs, presets and skipped work.

use serde_json::json;

use crate::lab::{GRAPH, Lab, digest_of};

#[test]
fn presets_are_listed_tried_and_written() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let trade = lab.get("/trade").json();
    let names: Vec<&str> =
        trade["presets"].as_array().unwrap().iter().map(|one| one["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["draft", "preview", "final", "reference"]);
    let knobs = trade["knobs"].as_array().unwrap();
    let degree =
        knobs.iter().find(|one| one["parameter"] == "sh_degree").unwrap_or_else(|| panic!("{trade}"));
    assert_eq!(degree["node"], "view");
    assert_eq!(degree["levels"].as_array().unwrap().len(), 4);
    let skips = trade["left_out"].as_array().unwrap();
    let harmonics =
        skips.iter().find(|one| one["what"].as_str().unwrap().contains("spherical harmonics")).unwrap();
    assert_eq!(
        (&harmonics["left_out"], &harmonics["nodes"]),
        (&true.into(), &json!(["view"])),
        "{harmonics}"
    );

    let before = lab.text();
    let ask = |preset: &str, write: bool| {
        let body = json!({"digest": digest_of(&lab.text()), "preset": preset, "write": write});
        lab.post("/preset", &body.to_string())
    };
    // The second trial replaces the first.
    for (level, preset) in [(0, "draft"), (1, "preview"), (0, "draft")] {
        assert_eq!(ask(preset, false).status, 200);
        lab.until("the values are tried", |lab| {
            let trade = lab.get("/trade").json();
            trade["knobs"].as_array().unwrap().iter().all(|one| one["levels"][level] == one["value"])
        });
    }
    assert_eq!(lab.text(), before, "a trial does not change the text");
    // Values that are tried are written as well.
    assert_eq!(ask("draft", true).status, 200);
    let written = lab.text();
    assert_ne!(written, before);
    assert!(written.contains("SplatRender(splats: \"demo.splats\", rig: \"camera\", "), "{written}");
    lab.until("the graph follows", |lab| lab.digest() == digest_of(&written));
    let trade = lab.get("/trade").json();
    for knob in trade["knobs"].as_array().unwrap() {
        assert_eq!(knob["value"], knob["levels"][0], "{knob}");
    }
    assert_eq!(ask("draft", true).status, 409, "there is nothing to change");
    assert_eq!(lab.post("/undo", &json!({"digest": digest_of(&written)}).to_string()).status, 200);
    assert_eq!(lab.text(), before);
    assert_eq!(ask("best", true).status, 422);
    let stale = json!({"digest": digest_of("x"), "preset": "draft", "write": true});
    assert_eq!(lab.post("/preset", &stale.to_string()).status, 409);
    assert_eq!(lab.text(), before);
}

#[test]
fn the_state_lists_the_refinements_of_the_last_run() {
    let lab = Lab::new(GRAPH);
    let state = lab.idle();
    let refinements = state["refinements"].as_array().unwrap();
    let last = refinements.last().unwrap();
    assert!(last["pass"].is_null() && last["seconds"].as_f64().unwrap() > 0.0, "{last}");
    let digest = &last["values"]["view.colour"][1];
    assert_eq!(
        *digest,
        state["nodes"]["view"]["outputs"]
            .as_array()
            .unwrap()
            .iter()
            .find(|one| one["port"] == "colour")
            .unwrap()["digest"]
    );
}
