//! Knobs, presets, and what is built on them.

use serde_json::Value;

use crate::{INSERT, Place, Told};

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

/// An error is laid over what takes samples until one is reached; a run that misses it is degraded.
#[test]
fn a_run_is_given_an_error() {
    let place = Place::new(INSERT);
    let notes = |told: &Told| -> Vec<String> {
        let trace = told.events.iter().find(|e| e["event"] == "node" && e["id"] == "trace").unwrap();
        trace["notes"].as_array().unwrap().iter().map(|n| n["id"].as_str().unwrap().to_owned()).collect()
    };
    let told = place.run(&["--max-error", "1.0", "--set", "trace.samples=16"]);
    assert_eq!(told.code, 0, "{}", told.errors);
    assert!(notes(&told).iter().any(|id| id == "sample-plan"));
    let short = place.run(&["--max-error", "1e-6"]);
    assert_eq!(short.code, 3, "{}", short.errors);
    assert!(notes(&short).iter().any(|id| id == "error-not-reached"));
    assert_eq!(place.run(&["--max-error", "7"]).code, 2);
    let without = Place::new(r#"Graph(version: 1, scene: (up: "+z"), nodes: (demo: DemoScene()))"#);
    let told = without.run(&["--max-error", "0.1"]);
    assert!(told.code == 2 && told.events[0]["message"].as_str().unwrap().contains("takes samples"));
}

/// A time becomes a number of samples before the run, by what runs of the kind took.
#[test]
fn a_run_is_given_a_time() {
    let place = Place::new(&INSERT.replace("samples: 4", "samples: 16"));
    let unknown = place.run(&["--time", "10s"]);
    assert!(unknown.code == 2 && unknown.events[0]["message"].as_str().unwrap().contains("not known"));
    assert_eq!(place.run(&[]).code, 0);
    for (time, yaw, samples) in [("9d", "50", "trace.samples=16"), ("0s", "70", "trace.samples=4")] {
        let told = place.run(&["--time", time, "--set", &format!("pose.yaw_deg={yaw}")]);
        let chosen = told.events.iter().find(|event| event["event"] == "chosen").unwrap();
        assert_eq!((told.code, &chosen["settings"]), (0, &serde_json::json!([samples])), "{}", told.errors);
    }
    assert_eq!(place.run(&["--time", "soon"]).code, 2);
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
