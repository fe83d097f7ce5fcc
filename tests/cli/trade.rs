//! Knobs, presets, and what is built on them.

use serde_json::Value;

use crate::{INSERT, Place};

#[test]
fn knobs_tell_what_they_reach_and_presets_set_them() {
    let place = Place::new(INSERT);
    let told = place.call(&["knobs", "graph.ron", "--json"]);
    let told: Value = serde_json::from_slice(&told.stdout).unwrap();
    let knob = |node: &str, parameter: &str| {
        let mut all = told["knobs"].as_array().unwrap().iter();
        all.find(|knob| knob["node"] == node && knob["parameter"] == parameter).unwrap().clone()
    };
    let samples = knob("trace", "samples");
    assert_eq!((&samples["value"], &samples["knob"]["kind"]), (&"4".into(), &"samples".into()));
    assert_eq!(samples["reaches"], serde_json::json!(["layers", "save"]));
    assert_eq!(knob("probe", "size_px")["reaches"], serde_json::json!(["layers", "light", "save"]));
    assert_eq!(knob("view", "alpha_cut")["reaches"], serde_json::json!(["layers", "save"]));

    let text = place.call(&["knobs", "graph.ron", "--preset", "preview"]).stdout;
    let text = String::from_utf8(text).unwrap();
    let line = text.lines().find(|line| line.starts_with("trace.samples ")).unwrap();
    assert_eq!(line.split_whitespace().nth(2), Some("16"), "{text}");
}

#[test]
fn a_preset_of_the_graph_wins_over_the_one_of_that_name() {
    let place = Place::new(&INSERT.replace("nodes: (", "presets: (draft: (trace: (samples: 7))), nodes: ("));
    let value = |preset: &str, knob: &str| {
        let text = String::from_utf8(place.call(&["knobs", "graph.ron", "--preset", preset]).stdout).unwrap();
        let line = text.lines().find(|line| line.starts_with(knob)).unwrap().to_owned();
        line.split_whitespace().nth(2).unwrap().to_owned()
    };
    assert_eq!(
        (value("draft", "trace.samples").as_str(), value("draft", "probe.size_px").as_str()),
        ("7", "32")
    );
    assert_eq!(value("preview", "probe.size_px"), "256");
    let wrong = place.call(&["plan", "graph.ron", "--preset", "drafd"]);
    let message = String::from_utf8_lossy(&wrong.stderr).into_owned();
    assert!(message.contains("did you mean `draft`?") && message.contains("reference"), "{message}");
}
