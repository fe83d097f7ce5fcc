//! What a person reads when something is wrong, and the exit codes.

use crate::{INSERT, Place};

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn every_mistake_of_a_graph_is_told_at_once_with_its_place() {
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
    let told = place.run(&[]);
    assert_eq!(told.code, 1);
    assert_eq!(told.nodes("failed"), ["broken"]);
    assert!(told.nodes("ran").contains(&"light"), "what does not need it is finished");
    assert!(told.nodes("skipped").contains(&"save"));
    let plain = place.call(&["run", "graph.ron"]);
    assert_eq!(plain.status.code(), Some(1));
    let errors = text(&plain.stderr);
    assert_eq!(errors.matches("`broken` failed").count(), 1, "told once:\n{errors}");
    assert!(errors.contains("graph.ron:"), "{errors}");
}

#[test]
fn absurd_sizes_are_refused_before_they_are_allocated() {
    let place = Place::new(INSERT);
    let told =
        place.run(&["--set", "camera.width_px=60000", "--set", "camera.height_px=60000", "--memory", "2G"]);
    assert_eq!(told.code, 1);
    assert!(
        told.events.iter().any(|e| e["error"].as_str().is_some_and(|t| t.contains("memory"))),
        "{}",
        told.errors
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
