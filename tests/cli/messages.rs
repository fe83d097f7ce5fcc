//! Tests of error messages and exit codes.

use crate::{INSERT, Place};

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn every_mistake_of_a_graph_is_reported_at_once_with_its_place() {
    let graph = INSERT
        .replace("Stitch(views", "Stich(views")
        .replace("width_px: 64)", "widht_px: 64)")
        .replace("samples: 4", "samples: 0")
        .replace("gamma: 0.8", "gamma: NaN")
        .replace("\"demo.proxy\"", "\"demo.proxi\"")
        .replace("method: Region", "method: Regoin")
        .replace("path: \"layers.exr\"", "path: \"final.png\"");
    let place = Place::new(&graph);
    for verb in ["check", "run", "plan"] {
        let output = place.call(&[verb, "graph.ron"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(output.stdout.is_empty());
        let errors = text(&output.stderr);
        for part in [
            "no kind of node is named `Stich`",
            "did you mean `Stitch`?",
            "`samples` is out of range",
            "`gamma`: `NaN` is not a finite number",
            "`demo` has no output `proxi`",
            "did you mean `proxy`?",
            "did you mean `Region`?",
        ] {
            assert!(errors.contains(part), "{verb}: {part} is missing in\n{errors}");
        }
        assert!(errors.contains("graph.ron:"), "{errors}");
    }
    assert!(
        !place.path("cache").exists() && !place.path("out").exists(),
        "a wrong graph leaves nothing behind"
    );
}

#[test]
fn a_failing_node_is_named_and_the_others_finish() {
    let graph = INSERT.replace(
        "        save:",
        "        broken: LoadMesh(path: \"graph.ron\"),\n        cut: CropMesh(mesh: \"broken\"),\n        save:",
    );
    let place = Place::new(&graph.replace("receiver: \"demo.proxy\"", "receiver: \"cut\""));
    let reported = place.run(&[]);
    assert_eq!(reported.code, 1);
    assert_eq!(reported.nodes("failed"), ["broken"]);
    assert!(reported.nodes("ran").contains(&"light"), "what does not need it is finished");
    assert!(reported.nodes("skipped").contains(&"save"));
    let plain = place.call(&["run", "graph.ron"]);
    assert_eq!(plain.status.code(), Some(1));
    let errors = text(&plain.stderr);
    assert_eq!(errors.matches("`broken` failed").count(), 1, "reported once:\n{errors}");
    assert!(errors.contains("graph.ron:"), "{errors}");
    // The picture of an earlier run is not taken for one of this run.
    assert!(!errors.contains("earlier run"), "{errors}");
    let earlier = place.path("out/final.png");
    std::fs::create_dir_all(earlier.parent().unwrap()).unwrap();
    std::fs::write(&earlier, "earlier").unwrap();
    let plain = place.call(&["run", "graph.ron"]);
    let errors = text(&plain.stderr);
    assert_eq!(errors.matches("final.png is still from an earlier run").count(), 1, "{errors}");
}

#[test]
fn absurd_sizes_are_refused_before_they_are_allocated() {
    let place = Place::new(INSERT);
    let reported =
        place.run(&["--set", "camera.width_px=60000", "--set", "camera.height_px=60000", "--memory", "2G"]);
    assert_eq!(reported.code, 1);
    assert!(
        reported.events.iter().any(|e| e["error"].as_str().is_some_and(|t| t.contains("memory"))),
        "{}",
        reported.errors
    );
}

#[test]
fn usage_mistakes_exit_with_two() {
    let place = Place::new(INSERT);
    for arguments in [
        &["run", "nothing.ron"][..],
        &["run", "graph.ron", "--only", "nobody"],
        &["run", "graph.ron", "--set", "pose"],
        &["run", "graph.ron", "--memory", "lots"],
        &["nodes", "stich"],
        &["explain", "graph.ron", "nobody"],
        &["fly"],
    ] {
        let output = place.call(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output.stderr));
        assert!(!output.stderr.is_empty());
    }
    assert!(text(&place.call(&["nodes", "stich"]).stderr).contains("did you mean `stitch`?"));
}

#[test]
fn drawings_name_every_node() {
    let place = Place::new(INSERT);
    for format in ["dot", "svg", "mermaid"] {
        let drawing = text(&place.call(&["graph", "graph.ron", "--format", format]).stdout);
        for name in ["demo", "trace", "final", "path-trace"] {
            assert!(drawing.contains(name), "{format}: {name}");
        }
    }
}

#[test]
fn what_is_wired_wrong_is_reported_before_anything_runs() {
    let place = Place::new(
        r#"Graph(version: 1, scene: (up: "+z"), nodes: (
        demo:  DemoScene(), pose: Pose(), probe: CubeRig(at: "pose"), cameras: LoadCameras(path: "cameras.json"),
        faces: SplatRender(splats: "demo.splats", rig: "probe"),
        two:   SplatRender(splats: "demo.splats", rig: "cameras"),
        a:     WriteImage(image: "faces.colour", path: "faces.png"),
        b:     WriteImage(image: "two.colour", path: "out/two.png"),
        c:     WriteImage(image: "two.colour", path: "{view}.png"),
        d:     WriteExr(layers: ["two.colour", "faces.colour"], path: "{view}.exr"),
        e:     WriteExr(layers: ["two.colour", "two.alpha"], names: ["x"], path: "e/{view}.exr"),
        f:     WriteExr(path: "f/{view}.exr"),
        g:     Compare(image: "two.colour", reference: "two.colour", names: ["object"]),
        h:     RegionMasks(object: "two.colour", with: "two.colour"),
        ))"#,
    );
    let camera = r#"{"w": 8, "h": 8, "fx": 9, "fy": 9, "cx": 4, "cy": 4, "c2w_opencv": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"#;
    let cameras = format!(r#"{{"views": [{camera}, "name": "a"}}, {camera}, "name": "b"}}]}}"#);
    std::fs::write(place.path("cameras.json"), cameras).unwrap();
    let check = || -> Vec<serde_json::Value> {
        let output = place.call(&["check", "graph.ron", "--json"]);
        assert_eq!(output.status.code(), Some(2));
        let reported: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        reported["list"].as_array().unwrap().clone()
    };
    let reported = check();
    let found: Vec<(u64, &str)> =
        reported.iter().map(|one| (one["line"].as_u64().unwrap(), one["code"].as_str().unwrap())).collect();
    let (path, wiring) = ("output-path", "wiring");
    let expected = [(5, path), (6, path), (8, wiring), (9, wiring), (10, wiring), (11, wiring), (12, wiring)];
    assert_eq!(found, expected, "{reported:#?}");
    assert!(reported[0]["message"].as_str().unwrap().contains("there are 6 views"));
    assert_eq!(reported[1]["hints"][0], "put `{view}` into the path: \"out/two_{view}.png\"");
}

#[test]
fn every_setting_that_is_wrong_is_reported_at_once() {
    let place = Place::new(INSERT);
    let errors = |settings: &[&str]| {
        let sets = settings.iter().flat_map(|setting| ["--set", setting]);
        let output = place.call(&["run", "graph.ron"].into_iter().chain(sets).collect::<Vec<_>>());
        assert_eq!(output.status.code(), Some(2));
        text(&output.stderr)
    };
    let reported = errors(&["pose.yaw_deg=abc", "poose.x=1", "camera.eye=(1, 2)", "trace.samples=64"]);
    for part in [
        "`yaw_deg` takes a number, not text",
        "--> --set:1:14",
        "1 | pose.yaw_deg=\"abc\"",
        "did you mean `pose`?",
        "`eye` takes 3 numbers in ( ), not only 2",
    ] {
        assert!(reported.contains(part), "{part} is missing in\n{reported}");
    }
    assert_eq!(reported.matches("error: ").count(), 3, "{reported}");
    let reported = errors(&["bad", "pose.yaw_deg=1", "worse="]);
    assert!(
        reported.contains("`--set bad` is not a setting") && reported.contains("`--set worse=`"),
        "{reported}"
    );
}

#[test]
fn a_missing_file_is_reported_beside_what_else_is_wrong_with_its_node() {
    let place = Place::new(
        &INSERT.replace("nodes: (", "nodes: (e: LoadEnvironment(path: \"gone.hdr\", scale: -1e99),"),
    );
    let reported = text(&place.call(&["check", "graph.ron"]).stderr);
    assert!(
        reported.contains("`gone.hdr` does not exist") && reported.contains("`scale` is out of range"),
        "{reported}"
    );
}

// For a wrong value inside a choice, the value is reported and not the choice; the ends of a range are valid. This
// test fails if `begins` is always false, or if `within` compares an f32 range in f64.
#[test]
fn what_a_method_holds_wrongly_is_reported() {
    let errors = |method: &str| {
        let place = Place::new(&INSERT.replace("method: Region", &format!("method: {method}")));
        text(&place.call(&["check", "graph.ron"]).stderr)
    };
    let three = errors("Manual(emitters: [(0.0, 0.0, 10.0)])");
    assert!(three.contains("an emitter (azimuth, elevation, radius, stops)"), "{three}");
    assert!(!three.contains("not a word"), "{three}");
    assert!(!errors("Manual(emitters: [[0.0, 0.0, 10.0, 3.0]])").contains("not a word"));
    let fuse = INSERT.replace("brackets: \"dark\"", "brackets: \"dark\", threshold: 0.999");
    assert!(fuse != INSERT);
    let place = Place::new(&fuse);
    assert_eq!(place.call(&["check", "graph.ron"]).status.code(), Some(0));
}

#[cfg(not(feature = "learned"))]
// This test fails if `value_mistake` has no arm for identifiers, or if the minimum number of layers is 0.
#[test]
fn what_a_choice_holds_wrongly_is_reported() {
    for (wrong, reported) in [
        ("Within(2.0)", "fields in the brackets need names"),
        ("Within(2.0)", "expected Within(metres: number, bounces: false)"),
        ("Room(layers: 0)", "`layers` is 0; it must be 1 to 16"),
        ("Within(metres: -1.0)", "`metres` is -1; it must be at least 0"),
        ("Rom", "did you mean `Room`?"),
    ] {
        let graph = INSERT.replace("samples: 4", &format!("samples: 4, surroundings: {wrong}"));
        let errors = text(&Place::new(&graph).call(&["check", "graph.ron"]).stderr);
        assert!(errors.contains(reported), "{wrong}: {reported} is missing in\n{errors}");
    }
}

/// Parameter names of former versions are errors that print the new spelling, whether in the graph, in `--set` or
/// in an overlay.
#[test]
fn former_parameters_are_errors_with_the_new_spelling() {
    let graph = INSERT.replace("samples: 4", "samples: 4, env_block: FrontFace(max_layers: 2), bounce: Env");
    let place = Place::new(&graph);
    let errors = text(&place.call(&["check", "graph.ron"]).stderr);
    assert!(errors.contains("`PathTrace` no longer has `env_block`, `bounce`"), "{errors}");
    assert!(errors.contains("write `surroundings: Room(layers: 2)`"), "{errors}");
    assert!(errors.contains("version 19 or earlier of the kind `path-trace`"), "{errors}");
    assert_eq!(errors.matches("no longer has").count(), 1, "{errors}");
    let place = Place::new(INSERT);
    let errors = text(&place.call(&["check", "graph.ron", "--set", "trace.near_field=Off"]).stderr);
    assert!(errors.contains("write `surroundings: Distant`"), "{errors}");
    // A choice whose fields have defaults needs no brackets.
    let graph = INSERT.replace("samples: 4", "samples: 4, surroundings: Room");
    assert_eq!(Place::new(&graph).call(&["check", "graph.ron"]).status.code(), Some(0));
}

#[test]
fn what_is_not_built_in_is_reported() {
    let reported = Place::new("").call(&["train-exposure", "panoramas", "--out", "a.safetensors"]);
    assert_eq!(reported.status.code(), Some(2));
    assert!(text(&reported.stderr).contains("--features learned"), "{}", text(&reported.stderr));
    let help = Place::new("").call(&["train-exposure", "--help"]);
    assert_eq!(help.status.code(), Some(0));
    assert!(text(&help.stdout).contains("--features learned"), "{}", text(&help.stdout));
}

#[test]
fn programs_are_reported_mistakes_as_json() {
    let place = Place::new(&INSERT.replace("gamma: 0.8", "gama: 0.8"));
    for verb in ["check", "run"] {
        let output = place.call(&[verb, "graph.ron", "--json"]);
        assert_eq!((output.status.code(), text(&output.stderr)), (Some(2), String::new()));
        let reported: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(reported["event"], "mistakes");
        let reported = &reported["list"][0];
        assert_eq!(reported["code"], "unknown-field");
        assert_eq!((&reported["file"], &reported["line"]), (&"graph.ron".into(), &16.into()));
        assert_eq!(reported["hints"][0], "did you mean `gamma`?");
    }
    let output = place.call(&["run", "graph.ron", "--json", "--set", "shadow.gama="]);
    let reported: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(reported["event"], "error");
    place.write("Graph(version: 1, scene: (up: \"+z\"), nodes: ())");
    assert!(text(&place.call(&["run", "graph.ron"]).stderr).contains("the graph has no nodes"));
    place.write("Graph(version: 1, scene: (up: \"+z\"), nodes: (a: Pose()))");
    let reported = place.run(&["--jobs", "0"]).good();
    assert!(reported.events.iter().any(|event| event["id"] == "no-file"), "{:?}", reported.events);
    assert_eq!(reported.events.last().map(|event| &event["event"]), Some(&"done".into()));
    let reported = text(&place.call(&["run", "graph.ron", "--overlay", "gone.ron"]).stderr);
    assert!(reported.contains("cannot read the overlay `gone.ron`: No such file"), "{reported}");
    let reported = text(&place.call(&["run", "graph.ron", "--locked"]).stderr);
    assert!(reported.contains("there is no lock `graph.lock`; `lightharmony lock` writes it"), "{reported}");
    // The attempt, and the error of the system.
    let reported = text(&place.call(&["init", "graph.ron/below"]).stderr);
    assert!(reported.contains("cannot create graph.ron/below: Not a directory"), "{reported}");
}
