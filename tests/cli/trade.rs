//! Tests of knobs, presets, and the commands that use them.

use serde_json::Value;

use crate::{INSERT, Place, RunLog};

#[test]
fn knobs_tell_what_they_reach_and_presets_set_them() {
    let place = Place::new(INSERT);
    let reported = place.call(&["knobs", "graph.ron", "--json"]);
    let reported: Value = serde_json::from_slice(&reported.stdout).unwrap();
    let knob = |node: &str, parameter: &str| {
        let mut all = reported["knobs"].as_array().unwrap().iter();
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

/// `--max-error` sets `max_error` of the nodes that take samples. The result of a run that does not reach this
/// error is degraded.
#[test]
fn a_run_is_given_an_error() {
    let place = Place::new(INSERT);
    let notes = |reported: &RunLog| -> Vec<String> {
        let trace = reported.events.iter().find(|e| e["event"] == "node" && e["id"] == "trace").unwrap();
        trace["notes"].as_array().unwrap().iter().map(|n| n["id"].as_str().unwrap().to_owned()).collect()
    };
    let reported = place.run(&["--max-error", "1.0", "--set", "trace.samples=16"]);
    assert_eq!(reported.code, 0, "{}", reported.errors);
    assert!(notes(&reported).iter().any(|id| id == "sample-plan"));
    let short = place.run(&["--max-error", "1e-6"]);
    assert_eq!(short.code, 3, "{}", short.errors);
    assert!(notes(&short).iter().any(|id| id == "error-not-reached"));
    assert_eq!(place.run(&["--max-error", "7"]).code, 2);
    // A preset with few samples bounds a run without `--max-error`, and not one with it.
    place.write(&INSERT.replace("samples: 4", "samples: 16"));
    let chosen = |arguments: &[&str]| -> Vec<Value> {
        let reported = place.run(&[&["--max-error", "1.0"], arguments].concat());
        assert_eq!(reported.code, 0, "{}", reported.errors);
        reported
            .events
            .into_iter()
            .filter(|e| e["event"] == "chosen")
            .map(|e| e["settings"].clone())
            .collect()
    };
    assert_eq!(chosen(&["--preset", "draft"]), [serde_json::json!(["trace.samples=16"])]);
    assert!(chosen(&["--preset", "final"]).is_empty() && chosen(&["--set", "trace.samples=2"]).is_empty());
    let without = Place::new(r#"Graph(version: 1, scene: (up: "+z"), nodes: (demo: DemoScene()))"#);
    let reported = without.run(&["--max-error", "0.1"]);
    assert!(reported.code == 2 && reported.events[0]["message"].as_str().unwrap().contains("takes samples"));
}

/// `--time` sets the number of samples before the run, based on the measured times of earlier runs of the same
/// kinds.
#[test]
fn a_run_is_given_a_time() {
    let place = Place::new(&INSERT.replace("samples: 4", "samples: 16"));
    // Without earlier timings a few samples are taken first, and kept.
    let all = (["trace.samples=4", "trace.samples=16"], ["trace.samples=16"]);
    let few = (["trace.samples=4", "trace.samples=4"], ["trace.samples=4"]);
    for (time, (cold, warm)) in [("9d", all), ("1ms", few)] {
        let _ = std::fs::remove_dir_all(place.path("cache"));
        for (yaw, settings) in [("50", &cold[..]), ("70", &warm[..])] {
            let reported = place.run(&["--time", time, "--set", &format!("pose.yaw_deg={yaw}")]);
            let chosen = reported.events.iter().filter(|event| event["event"] == "chosen");
            let chosen: Vec<&str> = chosen.map(|event| event["settings"][0].as_str().unwrap()).collect();
            assert_eq!((reported.code, chosen), (0, settings.to_vec()), "{}", reported.errors);
            assert_eq!(reported.events.iter().filter(|event| event["event"] == "done").count(), 1);
            let missed = reported.events.iter().any(|event| event["id"] == "time-missed");
            assert_eq!(missed, time == "1ms", "a missed time is reported");
        }
    }
    let reported = place.outputs();
    let plain = place.run(&["--set", "trace.samples=4", "--set", "pose.yaw_deg=70"]);
    assert_eq!((plain.code, place.outputs()), (0, reported), "the same as where the number was given");
    assert_eq!([["--time", "soon"], ["--time", "0s"]].map(|time| place.run(&time).code), [2, 2]);
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

#[test]
fn knobs_show_what_the_graphs_own_presets_say_and_the_range() {
    let place = Place::new(&INSERT.replace("nodes: (", "presets: (draft: (trace: (samples: 7))), nodes: ("));
    let reported: Value =
        serde_json::from_slice(&place.call(&["knobs", "graph.ron", "--json"]).stdout).unwrap();
    let knob = |name: &str| {
        let mut all = reported["knobs"].as_array().unwrap().iter();
        all.find(|knob| knob["node"] == "trace" && knob["parameter"] == name).unwrap().clone()
    };
    let samples = knob("samples");
    assert_eq!(samples["presets"], serde_json::json!(["7", "16", "64", "1024"]));
    assert_eq!(samples["range"], serde_json::json!([1.0, 1_048_576.0]));
    let text = String::from_utf8(place.call(&["knobs", "graph.ron"]).stdout).unwrap();
    let line = text.lines().find(|line| line.starts_with("trace.samples ")).unwrap();
    assert!(line.contains("4  ") && line.contains("7  ") && line.contains("1 to 1048576"), "{line}");
    // Its own `draft` leaves the probe alone.
    let probe = text.lines().find(|line| line.starts_with("probe.size_px ")).unwrap();
    assert_eq!(probe.split_whitespace().nth(3), Some("32"), "{probe}");
}

/// A photograph may be the background, outputs that no knob affects are left out, and a search reports its outcome.
#[test]
fn a_photograph_is_a_background_and_what_no_knob_reaches_is_left_out() {
    let few = "presets: (draft: (trace: (samples: 1)), preview: (trace: (samples: 2)), final: (trace: (samples: 3)), \
               reference: (trace: (samples: 8))), nodes: (";
    let place = Place::new(&INSERT.replace("nodes: (", few));
    let error = |arguments: &[&str]| {
        let output = place.call(&[&["tune", "graph.ron"], arguments].concat());
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    for value in ["0", "-3", "nan", "inf"] {
        let (code, reported) = error(&[&format!("--max-work={value}")]);
        assert!(code == Some(2) && reported.contains("`--max-work` must be a number above 0"), "{reported}");
    }
    assert_eq!(error(&["--max-error", "flip=0.1", "--metric", "rmse"]).0, Some(2));
    assert_eq!(error(&["--max-work", "1e9", "--budget", "0"]).0, Some(2));
    assert!(error(&["--max-work", "1e9", "--metric", "foo"]).1.contains("not a measure of error"));
    assert!(error(&["--max-error", "flip"]).1.contains("write METRIC=VALUE"));

    let drawn = place.run(&["--only", "save"]);
    assert_eq!(drawn.code, 0, "{}", drawn.errors);
    let photographed = INSERT
        .replace("nodes: (", few)
        .replace("background: \"view\"", "background: \"photo\"")
        .replace("save: ", "photo: LoadImage(path: \"out/final.png\"), same: WriteImage(image: \"photo\", path: \"b.png\"), save: ");
    place.write(&photographed);
    let reported = place.call(&[
        "tune",
        "graph.ron",
        "--max-work",
        "1e12",
        "--metric",
        "touched.psnr",
        "--budget",
        "6",
        "--json",
    ]);
    let errors = String::from_utf8_lossy(&reported.stderr);
    assert!(reported.status.success() && errors.contains("no knob affects `photo`"), "{errors}");
    let reported: Value = serde_json::from_slice(&reported.stdout).unwrap();
    assert!(
        reported["finished"] == false && reported["ended"].as_str().unwrap().contains("budget"),
        "{reported}"
    );
    let best = reported["measured"].as_array().unwrap().iter().find(|point| point["best"] == true).unwrap();
    assert_eq!(best["error"], "inf", "the reference is within the work: {reported}");

    place.write(r#"Graph(version: 1, scene: (up: "+z"), nodes: (photo: LoadImage(path: "out/final.png"), save: WriteImage(image: "photo", path: "b.png")))"#);
    let (code, reported) = error(&["--max-work", "1e9"]);
    assert!(code == Some(2) && reported.contains("no knob changes `photo`"), "{reported}");
}

/// A preset that sets a field that varies along an axis changes the nodes of the graph. A comparison of its
/// pictures with the pictures of other presets then fails, and the error states this reason.
#[test]
fn a_preset_that_takes_an_axis_away_is_named() {
    let graph = r#"Graph(version: 1, scene: (up: "+z"), axes: (q: List([4, 16])),
        presets: (reference: (trace: (samples: 32))), nodes: (
        demo: DemoScene(splats: 4000, width_px: 36, height_px: 26, truth_width_px: 32),
        pose: Pose(translation: (0.0, 0.0, 0.0)),
        placed: Place(object: "demo.object", pose: "pose"),
        trace: PathTrace(receiver: "demo.proxy", objects: ["placed"], rig: "demo.rig", env: "demo.truth_env", samples: Axis("q")),
        view: SplatRender(splats: "demo.splats", rig: "demo.rig"),
        shadow: ShadowRatio(without: "trace.without", with: "trace.with"),
        final: Composite(background: "view", object: "trace.object", shadow: "shadow"),
    ))"#;
    let place = Place::new(graph);
    for verb in [&["report", "graph.ron"][..], &["tune", "graph.ron", "--max-error", "flip=0.1"]] {
        for only in [&[][..], &["--only", "final"], &["--only", "final/q=4"]] {
            let reported = place.call(&[verb, only].concat());
            let errors = String::from_utf8_lossy(&reported.stderr);
            assert!(reported.status.code() == Some(2), "{errors}");
            assert!(
                errors.contains("--preset reference") && errors.contains("varies along an axis"),
                "{errors}"
            );
        }
    }
    assert_eq!(place.call(&["knobs", "graph.ron", "--only", "final/q=4"]).status.code(), Some(0));
}
