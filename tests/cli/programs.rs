//! Tests of nodes that run programs: when they run, and where they never run.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Output;

use crate::Place;

const GRAPH: &str = r#"Graph(version: 1, scene: (up: "+z"), nodes: (
    made: RunProgram(program: "./tool.sh", arguments: ["{out}/mesh.ply"], mesh_file: Some("mesh.ply")),
    save: WriteMesh(mesh: "made.mesh", path: "mesh.ply"),
))
"#;

/// A program that writes a triangle whose height is the number of the process, so that no two results are equal.
const TOOL: &str = "#!/bin/sh
echo run >> \"$(dirname \"$0\")/runs\"
printf 'ply\\nformat ascii 1.0\\nelement vertex 3\\nproperty float x\\nproperty float y\\nproperty float z\\n\
element face 1\\nproperty list uchar int vertex_indices\\nend_header\\n0 0 0\\n1 0 0\\n0 1 %s\\n3 0 1 2\\n' $$ > \"$1\"
";

fn tool(place: &Place, text: &str) {
    std::fs::write(place.path("tool.sh"), text).unwrap();
    std::fs::set_permissions(place.path("tool.sh"), PermissionsExt::from_mode(0o755)).unwrap();
}

fn place() -> Place {
    let place = Place::new(GRAPH);
    tool(&place, TOOL);
    place
}

fn runs(place: &Place) -> usize {
    std::fs::read_to_string(place.path("runs")).unwrap_or_default().lines().count()
}

fn good(output: Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The error message of a call with this exit code.
fn bad(output: Output, code: i32) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{text}");
    text
}

/// The program runs once, and again if its file changes or its result is lost. This test fails if the program is not
/// one of the sources of the node.
#[test]
fn a_program_runs_again_only_if_it_changes_or_its_result_is_lost() {
    let place = place();
    good(place.call(&["run", "graph.ron"]));
    good(place.call(&["run", "graph.ron"]));
    good(place.call(&["run", "graph.ron", "--set", "save.path=other.ply"]));
    assert_eq!(runs(&place), 1);
    tool(&place, &format!("{TOOL}# a new version\n"));
    good(place.call(&["run", "graph.ron"]));
    assert_eq!(runs(&place), 2);
    // Small values are in one file. Without it the records know only digests, which the program would not give again.
    for entry in std::fs::read_dir(place.path("cache/v1")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if name.starts_with("blobs.") {
            std::fs::remove_file(place.path("cache/v1").join(name)).unwrap();
        }
    }
    good(place.call(&["run", "graph.ron", "--set", "save.path=third.ply"]));
    assert_eq!(runs(&place), 3);
}

/// A bundle contains the result of a program, but no program. The result is used and reported as not verified, and
/// nothing runs the program. This test fails if `verify` chooses nodes that run programs.
#[test]
fn a_graph_from_others_runs_no_program() {
    let here = place();
    good(here.call(&["run", "graph.ron"]));
    good(here.call(&["pack", "graph.ron", "a.lhb", "--results", "all"]));
    let there = Place::new("");
    tool(&there, TOOL);
    std::fs::copy(here.path("a.lhb"), there.path("a.lhb")).unwrap();
    let listed = good(there.call(&["unpack", "a.lhb", "--list"]));
    assert!(!listed.contains("tool"), "{listed}");
    let verified = good(there.call(&["verify", "a.lhb", "--all"]));
    assert!(
        verified.contains("external  made: made by a program") && verified.contains("equal     save"),
        "{verified}"
    );
    assert!(verified.contains("nodes recomputed: 1, with bit-identical results: 1"), "{verified}");
    let error = bad(there.call(&["run", "a.lhb"]), 2);
    assert!(error.contains("`RunProgram` runs a program, which a graph from others may not do"), "{error}");
    good(there.call(&["unpack", "a.lhb"]));
    tool(&there, TOOL);
    std::fs::copy(there.path("tool.sh"), there.path("a/tool.sh")).unwrap();
    bad(there.call(&["run", "a/graph.ron"]), 2);
    assert!(!there.path("a/runs").exists() && runs(&there) == 0);
    std::fs::remove_file(there.path("a/.lightharmony-bundle")).unwrap();
    good(there.call(&["run", "a/graph.ron"]));
    assert!(there.path("a/runs").exists(), "the user trusts the folder now");

    // Without values, only the nodes that need the program fail.
    good(here.call(&["pack", "graph.ron", "b.lhb", "--results", "none"]));
    let output = here.call(&["verify", "b.lhb", "--all"]);
    let (text, error) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{text}{error}");
    assert!(text.contains("failed    save") && error.contains("pack --results all"), "{text}{error}");
}

#[test]
fn a_program_never_runs_on_another_machine() {
    let place = place();
    let error = bad(place.call(&["action", "write", "graph.ron", "made", "action"]), 2);
    assert!(error.contains("not computed elsewhere") && !place.path("action").exists(), "{error}");
    let error = bad(place.call(&["export", "openjd", "graph.ron", "--out", "job"]), 2);
    assert!(error.contains("made run programs") && !place.path("job").exists(), "{error}");
    assert_eq!(runs(&place), 0);
}

/// Failures name the node, underline the field and show what the program wrote.
#[test]
fn failures_show_the_output_of_the_program() {
    let place = place();
    tool(&place, "#!/bin/sh\necho 'CUDA error: out of memory' >&2\nexit 2\n");
    let error = bad(place.call(&["run", "graph.ron"]), 1);
    assert!(error.contains("exit status: 2") && error.contains("CUDA error: out of memory"), "{error}");
    tool(&place, "#!/bin/sh\nexit 0\n");
    let error = bad(place.call(&["run", "graph.ron"]), 1);
    assert!(error.contains("did not write `mesh.ply`"), "{error}");
    std::fs::remove_file(place.path("tool.sh")).unwrap();
    let error = bad(place.call(&["check", "graph.ron"]), 2);
    assert!(error.contains("`./tool.sh` was not found"), "{error}");
    let other = "RunProgram(splats: \"made.splats\", program: \"sh\", arguments: [\"{splats}\"], mesh_file: Some(\"m.ply\"))";
    let graph = GRAPH.replace("WriteMesh(mesh: \"made.mesh\", path: \"mesh.ply\")", other);
    std::fs::write(place.path("graph.ron"), graph).unwrap();
    let error = bad(place.call(&["check", "graph.ron"]), 2);
    assert!(error.contains("no output `splats`"), "{error}");
}

/// `init` writes the graph for photographs without poses, with their paths. Without photographs, `check` names the
/// folder and the responsible line.
#[test]
fn init_writes_the_graph_for_photographs() {
    let place = Place::new("");
    std::fs::create_dir_all(place.path("my photos")).unwrap();
    std::fs::write(place.path("lamp.glb"), "").unwrap();
    let shown = good(place.call(&["init", "new", "--photos", "my photos", "--object", "lamp.glb"]));
    assert!(shown.contains("run new/graph.ron --only report"), "{shown}");
    let text = std::fs::read_to_string(place.path("new/graph.ron")).unwrap();
    assert!(text.contains("RunColmap(path: \"../my photos\", largest"), "{text}");
    assert!(text.contains("LoadObject(path: \"../lamp.glb\")") && !text.contains("chair.glb"), "{text}");
    let tool = ["--set", "poses.program=Some(\"./colmap\")"];
    let error = bad(place.call(&[&["check", "new/graph.ron"], &tool[..]].concat()), 2);
    assert!(error.contains("`./colmap` was not found"), "{error}");
    let error = bad(place.call(&["init", "other", "--object", "lamp.glb"]), 2);
    assert!(error.contains("--photos FOLDER"), "{error}");
    bad(place.call(&["init", "other", "--photos", "gone", "--object", "lamp.glb"]), 2);
}

/// The poses of renders of the demo scene, by a real COLMAP: the program that the environment variable
/// `LIGHTHARMONY_COLMAP` names, since this takes minutes.
#[test]
#[allow(clippy::print_stderr, reason = "a skipped test is reported")]
fn a_real_colmap_finds_poses() {
    let Some(program) = std::env::var_os("LIGHTHARMONY_COLMAP") else {
        eprintln!("left out: set LIGHTHARMONY_COLMAP to `colmap`, or to a Python with `pycolmap`");
        return;
    };
    let place = Place::new(
        r#"Graph(version: 1, scene: (up: "+z", seed: 7), nodes: (
            demo:  DemoScene(capture: 30, capture_width_px: 480, splats: 260000),
            shots: SplatRender(splats: "demo.splats", rig: "demo.capture"),
            save:  WriteImage(image: "shots.colour", path: "../photos/{view}.png"),
        ))"#,
    );
    good(place.call(&["run", "graph.ron", "--out", "out/deep"]));
    let poses = format!(
        r#"Graph(version: 1, scene: (up: "+z", seed: 7), nodes: (
            poses:  RunColmap(path: "out/photos", largest_side_px: 240, program: Some({:?})),
            report: WriteReport(report: "poses.report", path: "report.md"),
        ))"#,
        Path::new(&program).display().to_string()
    );
    std::fs::write(place.path("poses.ron"), poses).unwrap();
    good(place.call(&["run", "poses.ron"]));
    let report = std::fs::read_to_string(place.path("out/report.md")).unwrap();
    let row = |name: &str| {
        let line = report.lines().find(|line| line.contains(name)).unwrap_or_else(|| panic!("{report}"));
        line.trim_matches('|').rsplit('|').next().unwrap().trim().parse::<f64>().unwrap()
    };
    assert!(row("photographs with a pose") >= 27.0 && row("mean reprojection error") < 1.5, "{report}");
}
