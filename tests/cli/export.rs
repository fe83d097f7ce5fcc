//! Tests of `export openjd` and of `run --openjd`.

use serde_json::Value;

use crate::{INSERT, Place};

/// A graph with a picture per frame, a picture of all frames, and a report that does not vary.
fn turning() -> String {
    INSERT
        .replace("    nodes: (", "    axes: (frame: Range(3, 6)),\n    nodes: (")
        .replace("yaw_deg: 30.0", "yaw_deg: Track(\"frame\", [(3, 0.0), (5, 90.0)])")
        .replace("path: \"final.png\")", "path: \"shot/{frame}.png\")")
        .replace("layers: WriteExr(layers: [\"final\", \"trace.without\", \"trace.with\", \"shadow\"], path: \"layers.exr\"),",
            "frames: Gather(input: \"final\", over: \"frame\"),\n sheet: ContactSheet(images: \"frames\", columns: 3),\n \
             all: WriteImage(image: \"sheet\", path: \"sheet.png\"),")
        .replace("light:  WriteReport(report: \"env.report\", path: \"light.json\"),", "")
}

#[test]
fn a_graph_becomes_a_job_whose_tasks_run() {
    let place = Place::new(&turning());
    let output =
        place.call(&["export", "openjd", "graph.ron", "--out", "job", "--remote", "grpc://cache.farm:8980"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("step save (tasks: 3)"));
    let text = std::fs::read(place.path("job/template.json")).unwrap();
    let job: Value = serde_json::from_slice(&text).unwrap();
    assert_eq!(job["specificationVersion"], "jobtemplate-2023-09");
    let steps = job["steps"].as_array().unwrap();
    let names: Vec<&str> = steps.iter().filter_map(|step| step["name"].as_str()).collect();
    assert_eq!(names, ["shared results", "save", "all"]);
    assert_eq!(
        steps[1]["parameterSpace"]["taskParameterDefinitions"],
        serde_json::json!([{"name": "frame", "type": "INT", "range": "3-5"}])
    );
    let after = |step: usize| -> Vec<&str> {
        let all = steps[step]["dependencies"].as_array().into_iter().flatten();
        all.filter_map(|one| one["dependsOn"].as_str()).collect()
    };
    assert_eq!(
        [after(0), after(1), after(2)],
        [vec![], vec!["shared results"], vec!["shared results", "save"]]
    );
    let arguments: Vec<&str> = steps[1]["script"]["actions"]["onRun"]["args"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(Value::as_str)
        .collect();
    assert!(arguments.contains(&"save/frame={{Task.Param.frame}}") && arguments.contains(&"--remote-write"));
    // What a worker runs for the frame 4, without the server.
    let output = place.call(&["run", "job/scene.lhb", "--only", "save/frame=4", "--out", "out", "--openjd"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let progress: Vec<u8> =
        printed.lines().filter_map(|line| line.strip_prefix("openjd_progress: ")?.parse().ok()).collect();
    assert!(progress.is_sorted() && progress.last() == Some(&100), "{printed}");
    assert!(printed.contains("openjd_status: "), "{printed}");
    assert!(place.path("out/shot/4.png").is_file());
}

#[test]
fn a_part_of_the_combinations_is_refused() {
    let graph = turning()
        .replace("Range(3, 6)", "Range(3, 6), light: List([0.5, 1.0])")
        .replace("gamma: 0.8", "gamma: Axis(\"light\")");
    let graph = graph.replace("shot/{frame}.png", "shot/{frame}-{light}.png").replace(
        "all: WriteImage(image: \"sheet\", path: \"sheet.png\")",
        "all: WriteImage(image: \"sheet\", path: \"sheet-{light}.png\")",
    );
    let place = Place::new(&graph);
    let output = place.call(&[
        "export",
        "openjd",
        "graph.ron",
        "--out",
        "job",
        "--only",
        "save/frame=3,save/light=0.5",
    ]);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.contains("every combination of the values"), "{errors}");
}
