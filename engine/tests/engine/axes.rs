//! Tests of axes: how often each node runs, and the mistakes that are reported.

use engine::{Source, SourceRoot};

use crate::lab::{Lab, Log};

fn graph(axes: &str, nodes: &str) -> String {
    format!("Graph(version: 1, scene: (up: \"+z\", seed: 7), axes: ({axes}), nodes: (\n{nodes}\n))\n")
}

fn run(lab: &Lab, axes: &str, nodes: &str) -> Log {
    lab.run_text(&graph(axes, nodes))
}

#[test]
fn a_node_runs_once_for_each_value_that_it_or_its_inputs_read() {
    let lab = Lab::on_disk();
    let log = run(
        &lab,
        "by: List([2.0, 3.0]), frame: Range(0, 3)",
        r#"one: Number(value: 10.0), scaled: Scale(value: "one", by: Axis("by")),
        moved: Add(terms: ["scaled"], bias: Axis("frame")), still: Add(terms: ["one"], bias: 7.0),
        both: Add(terms: ["moved", "still"]),
        save: WriteNumber(number: "both", path: "{by}/frame_{frame}.txt"),"#,
    );
    assert_eq!(
        log.ran().split(' ').filter(|id| !id.contains("frame=")).collect::<Vec<_>>(),
        ["one", "scaled/by=2.0", "scaled/by=3.0", "still"],
    );
    assert_eq!(log.outcome.totals.ran, 4 + 3 * 6);
    assert_eq!(lab.out("2/frame_0.txt"), "37.0\n");
    assert_eq!(lab.out("3/frame_2.txt"), "49.0\n");
    // One more value of one axis runs only the new instances.
    let more = run(
        &lab,
        "by: List([2.0, 3.0]), frame: Range(0, 4)",
        r#"one: Number(value: 10.0), scaled: Scale(value: "one", by: Axis("by")),
        moved: Add(terms: ["scaled"], bias: Axis("frame")), still: Add(terms: ["one"], bias: 7.0),
        both: Add(terms: ["moved", "still"]),
        save: WriteNumber(number: "both", path: "{by}/frame_{frame}.txt"),"#,
    );
    assert_eq!(more.outcome.totals.ran, 2 * 3);
}

#[test]
fn a_gather_is_all_instances_in_order() {
    let lab = Lab::on_disk();
    let nodes = |over: &str| {
        format!(
            r#"ten: Number(value: 10.0), moved: Add(terms: "ten", bias: Axis("yaw")),
            scaled: Scale(value: "moved", by: Axis("by")), all: Gather(input: "scaled.number", over: {over}),
            save: WriteNumber(number: ["ten", "all"], path: "all.txt"),"#
        )
    };
    let axes = "yaw: List([1.0, 2.0]), by: Range(1, 4)";
    run(&lab, axes, &nodes("[\"yaw\", \"by\"]"));
    assert_eq!(lab.out("all.txt"), "10.0\n11.0\n22.0\n33.0\n12.0\n24.0\n36.0\n");
    run(&lab, axes, &nodes("[\"by\", \"yaw\"]"));
    assert_eq!(lab.out("all.txt"), "10.0\n11.0\n12.0\n22.0\n24.0\n33.0\n36.0\n");
    // Along one axis: one file for each value of the other.
    run(&lab, axes, &nodes("\"by\"").replace("all.txt", "all_{yaw}.txt"));
    assert_eq!(lab.out("all_2.txt"), "10.0\n12.0\n24.0\n36.0\n");
}

#[test]
fn values_stand_anywhere_in_a_field_and_tracks_lie_between_keys() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "1");
    lab.write("b.txt", "2");
    run(
        &lab,
        "file: List([\"a.txt\", \"b.txt\"]), frame: Range(0, 11)",
        r#"read: LoadNumber(path: Axis("file")),
        sum: Add(terms: ["read"], bias: Track("frame", [(0, 0.0), (10, 5.0)])),
        all: Gather(input: "sum", over: "frame"),
        save: WriteNumber(number: "all", path: "{file}.txt"),"#,
    );
    assert!(lab.out("b.txt.txt").starts_with("2.0\n2.5\n3.0\n"), "{}", lab.out("b.txt.txt"));
    assert!(lab.out("a.txt.txt").ends_with("\n6.0\n"));
}

/// A placeholder in the path of a file to read is the value of the axis, padded as in the paths of sinks. Missing files
/// are reported one by one, and the rest is counted. This test fails if `Check::field` does not add the axes of
/// placeholders.
#[test]
fn a_sequence_of_files_is_read_along_an_axis() {
    let lab = Lab::on_disk();
    std::fs::create_dir(lab.path("in")).unwrap();
    (8..12).for_each(|frame| lab.write(&format!("in/{frame:04}.txt"), &format!("{frame}")));
    lab.write("in/a_2.txt", "100");
    let nodes = r#"read: LoadNumber(path: "in/{frame:4}.txt"), by: LoadNumber(path: "in/a_{by}.txt"),
        sum: Add(terms: ["read", "by"]), all: Gather(input: "sum", over: "frame"),
        save: WriteNumber(number: "all", path: "{by}.txt"),"#;
    let log = run(&lab, "frame: Range(8, 12), by: List([2.0])", nodes);
    assert_eq!(log.outcome.totals.ran, 4 + 1 + 4 + 1);
    assert_eq!(lab.out("2.txt"), "108.0\n109.0\n110.0\n111.0\n");
    // The same number of digits as in the path of a sink.
    let short = nodes.replace("{frame:4}", "00{frame}");
    assert_eq!(run(&lab, "frame: Range(8, 12), by: List([2])", &short).outcome.totals.ran, 0);
    let mistakes = |axes: &str, nodes: &str| -> Vec<String> {
        let found = lab.parse(&graph(axes, nodes)).err();
        found.map_or_else(Vec::new, |all| all.list.iter().map(|one| one.message.clone()).collect())
    };
    let few = mistakes("frame: Range(8, 15), by: List([2])", nodes);
    assert_eq!(few, ["12", "13", "14"].map(|frame| format!("`in/00{frame}.txt` does not exist")));
    let many = mistakes("frame: Range(8, 40), by: List([2])", nodes);
    assert_eq!(many.len(), 9, "{many:?}");
    assert!(many.contains(&"files of 20 other values of its axes do not exist".to_owned()), "{many:?}");
    // A name that is not that of an axis is a part of the path.
    let other = mistakes("frame: Range(8, 9), by: List([2])", &nodes.replace("{frame:4}", "{shot}"));
    assert_eq!(other, ["`in/{shot}.txt` does not exist"]);
}

#[test]
fn renaming_an_axis_reruns_nothing() {
    let lab = Lab::on_disk();
    let nodes = r#"ten: Number(value: 10.0), moved: Add(terms: "ten", bias: Axis("yaw")),
        all: Gather(input: "moved", over: "yaw"), save: WriteNumber(number: "all", path: "all.txt"),"#;
    assert_eq!(run(&lab, "yaw: Range(0, 3)", nodes).outcome.totals.ran, 5);
    let renamed = nodes.replace("yaw", "turn").replace("moved", "turned");
    assert_eq!(run(&lab, "turn: List([0, 1.0, 2])", &renamed).outcome.totals.ran, 0);
}

#[test]
fn an_instance_is_found_by_its_own_name_and_by_that_of_all() {
    let lab = Lab::in_memory();
    let text = graph("yaw: Range(0, 3)", r#"moved: Add(terms: [], bias: Axis("yaw")), other: Number,"#);
    let graph = lab.parse(&text).unwrap();
    assert_eq!(graph.find_all("moved").len(), 3);
    assert_eq!(graph.find_all("moved/yaw=1"), [1]);
    assert_eq!((graph.find_all("mov").len(), graph.find_all("other").len()), (0, 1));
    let two = r#"a: Add(terms: [], bias: Axis("yaw")), b: Add(terms: "a", bias: Axis("size")),"#;
    let graph = lab.parse(&self::graph("yaw: Range(0, 3), size: List([1.0, 5.0])", two)).unwrap();
    // Any of the values, in the order of the axes.
    let found = |name: &str| graph.find_all(name).len();
    assert_eq!((found("b"), found("b/yaw=1"), found("b/size=5.0"), found("b/yaw=1/size=5.0")), (6, 2, 3, 1));
    assert_eq!(
        (found("a/size=1.0"), found("b/yaw=11"), found("b/size=5.0/yaw=1"), found("b/")),
        (0, 0, 0, 0)
    );
    assert_eq!(lab.run_only(&text, &["moved/yaw=2"]).ran(), "moved/yaw=2");
}

#[test]
fn mistakes_of_axes_have_their_place() {
    let lab = Lab::in_memory();
    std::fs::create_dir(lab.path("a")).unwrap();
    lab.write("a/b", "1");
    lab.write("a_b", "2");
    let wrong = |axes: &str, nodes: &str| lab.mistakes(&graph(axes, nodes));
    let yaw = "yaw: List([1.0, 200.0])";
    for (axes, nodes, wanted) in [
        (yaw, r#"a: Number(value: Axis("yow")),"#, &["no axis `yow`", "did you mean `yaw`?"][..]),
        ("", r#"a: Number(value: Axis("yaw")),"#, &["no axis `yaw`", "axes are declared next to `nodes`"]),
        ("yaw: Lst([1])", "a: Number,", &["`yaw` is not an axis", "an axis is written"]),
        ("yaw: Range(0, 1e12)", "a: Number,", &["has more than 100000 values"]),
        ("view: Range(0, 2)", "a: Number,", &["cannot be named `view`"]),
        (yaw, r#"a: Number, b: Scale(value: "a", by: Axis("yaw")),"#, &["`by` is out of range: 200.0"]),
        (yaw, r#"a: Number, b: Scale(value: Axis("yaw")),"#, &["an input cannot contain `Axis` or `Track`"]),
        (
            yaw,
            r#"a: Number(value: Axis("yaw")), s: WriteNumber(number: "a", path: "a.txt"),"#,
            &["`a.txt` names one file", "put `{yaw}` into the path"],
        ),
        (
            yaw,
            r#"a: Number, s: WriteNumber(number: "a", path: "{yaw}.txt"),"#,
            &["`s` does not vary along `yaw`", "leave `{yaw}` out"],
        ),
        (
            yaw,
            r#"a: Number, all: Gather(input: "a", over: "yaw"), s: Add(terms: "all"),"#,
            &["`a` does not vary along `yaw`", "nothing to gather"],
        ),
        (
            yaw,
            r#"a: Number(value: Axis("yaw")), all: Gather(input: "a", over: "yow"), s: Add(terms: "all"),"#,
            &["no axis `yow`", "did you mean `yaw`?"],
        ),
        (
            yaw,
            r#"a: Number(value: Axis("yaw")), all: Gather(input: "a", over: "yaw"), s: Scale(value: "all"),"#,
            &["takes one wire, but `all` gathers many"],
        ),
        (
            yaw,
            r#"a: Number(value: Axis("yaw")), g: Gather(input: "a", over: "yaw"),
            h: Gather(input: "g", over: "yaw"), s: Add(terms: "h"),"#,
            &["`g` is itself a `Gather`"],
        ),
        (
            yaw,
            r#"a: Number(value: Axis("yaw")), g: Gather(input: "a", over: []), s: Add(terms: "g"),"#,
            &["`over` names no axis", "connect the node directly, without a `Gather`"],
        ),
        (
            r#"file: List(["a/b", "a_b"])"#,
            r#"a: LoadNumber(path: Axis("file")), s: WriteNumber(number: "a", path: "{file}.txt"),"#,
            &["the values \"a/b\" and \"a_b\" of `file` give the same file name", "change one of the values"],
        ),
        (
            yaw,
            r#"a: Number(value: Axis("yaw")), s: Add(terms: Gather(input: "a", over: "yaw")),"#,
            &["is not a wire", "a node must be in `nodes` and have a name"],
        ),
        (yaw, r#"all: Gather(inputs: "a"),"#, &["no field `inputs`", "`Gather` needs `over`"]),
        (
            "a: Range(0, 50000), b: Range(0, 50000)",
            r#"a: Number(value: Axis("a")), b: Add(terms: "a", bias: Axis("b")),"#,
            &["more than 1000000 nodes"],
        ),
    ] {
        let text = wrong(axes, nodes);
        for part in wanted {
            assert!(text.contains(part), "{part} is missing in\n{text}");
        }
        assert!(text.contains("graph.ron:"), "{text}");
    }
}

/// The values of `Cameras` are the indices of the cameras of a node. The number of cameras is read from the current
/// files. A node that takes its cameras from another node has the same number of cameras.
#[test]
fn the_cameras_of_a_node_are_an_axis() {
    let lab = Lab::on_disk();
    for (name, digit) in [("a.txt", "3"), ("b.txt", "4")] {
        lab.write(name, digit);
    }
    let with = |more: &str| {
        let nodes = format!(
            r#"rig: LoadDigits(path: "a.txt", more: [{more}]), same: Scale(value: "rig"),
            one: Add(terms: ["same"], bias: Axis("frame")), save: WriteNumber(number: "one", path: "{{frame}}.txt"),"#
        );
        run(&lab, "frame: Cameras(\"same\")", &nodes)
    };
    assert_eq!(with("").ran(), "one/frame=0 rig same save/frame=0");
    let two = with("\"b.txt\"");
    assert_eq!(two.outcome.totals.ran, 2 + 2 * 2);
    assert_eq!((lab.out("0.txt"), lab.out("1.txt")), ("68.0\n".to_owned(), "69.0\n".to_owned()));
    // A range of cameras.
    let text = graph(
        "frame: Cameras(\"rig\")",
        r#"rig: LoadDigits(path: "a.txt", more: ["b.txt", "a.txt", "b.txt"]),
        one: Add(terms: ["rig"], bias: Axis("frame")),"#,
    );
    let found = lab.parse(&text).unwrap();
    let names: Vec<&str> =
        found.find_all("one/frame=1..2").iter().map(|&node| found.nodes[node].id.as_str()).collect();
    assert_eq!(names, ["one/frame=1", "one/frame=2"]);
}

#[test]
fn a_number_of_cameras_that_is_not_known_is_a_mistake() {
    let lab = Lab::in_memory();
    lab.write("a.txt", "3");
    lab.write("c.txt", "no digit");
    for (axes, nodes, wanted) in [
        // The error of the node. An earlier version only reported that the number is not known before it runs.
        (
            "f: Cameras(\"rig\")",
            r#"rig: LoadDigits(path: "c.txt"),"#,
            &["the cameras of `rig` cannot be counted: `c.txt` holds no digit", "write a digit"][..],
        ),
        ("f: Cameras(\"rg\")", "rig: Number,", &["no node is named `rg`", "did you mean `rig`?"]),
        (
            "f: Cameras(\"rig\")",
            "rig: Number,",
            &["of `rig` is not known before the node runs", "Range(0, 300)"],
        ),
        (
            "f: Cameras(\"rig\")",
            r#"rig: LoadDigits(path: "a.txt", more: [Axis("f")]),"#,
            &["of `rig` varies along an axis", "PickCameras(rig: \"rig\", pick: [Axis(\"frame\")])"],
        ),
        ("f: Cameras(\"rig\")", r#"rig: Scale(value: "rig"),"#, &["a cycle"]),
        ("f: Cameras(\"rig\")", r#"rig: LoadDigits(path: "b.txt"),"#, &["`b.txt` does not exist"]),
        (
            "f: Cameras(\"rig\")",
            r#"rig: LoadDigit(path: "a.txt"),"#,
            &["no kind of node is named `LoadDigit`"],
        ),
        ("f: Cameras(rig)", "rig: Number,", &["`f` is not an axis", "or `Cameras(\"rig\")`"]),
        (
            "f: Cameras(\"all\")",
            r#"rig: Number, all: Gather(input: "rig", over: "f"),"#,
            &["of `all` varies along an axis"],
        ),
    ] {
        let text = lab.mistakes(&graph(axes, nodes));
        for part in wanted {
            assert!(text.contains(part), "{part} is missing in\n{text}");
        }
    }
}

/// If a subgraph declares an axis `Cameras("rig")`, `rig` refers to a node of the subgraph.
#[test]
fn a_subgraph_may_count_its_own_cameras() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    lab.write("part.ron", &graph(
        "frame: Cameras(\"rig\")",
        r#"rig: LoadDigits(path: "a.txt", more: ["a.txt"]), one: Add(terms: ["rig"], bias: Axis("frame")),"#,
    ));
    let text = r#"Graph(version: 1, scene: (up: "+z"), nodes: (
        part: Subgraph(graph: "part.ron"), save: WriteNumber(number: "part.one", path: "{frame}.txt"),
    ))"#;
    let joined = Source::new("graph.ron", text).including(&SourceRoot::new(lab.path(""))).0.text.to_string();
    assert_eq!(lab.run_text(&joined).outcome.totals.ran, 1 + 2 * 2);
}

#[test]
fn a_long_axis_is_one_node_a_value() {
    let lab = Lab::in_memory();
    let text = graph(
        "n: Range(0, 20000)",
        r#"a: Number(value: Axis("n")), s: WriteNumber(number: "a", path: "{n}.txt"),
        g: Gather(input: "a", over: "n"), sum: Add(terms: "g"),"#,
    );
    let graph = lab.parse(&text).unwrap();
    assert_eq!(graph.nodes.len(), 40_001);
    assert_eq!(graph.nodes[20_007].sink_path.as_deref(), Some("00007.txt"));
}

#[test]
fn an_instance_that_is_wrong_is_reported_once_however_its_neighbours_are_wired() {
    let lab = Lab::in_memory();
    for by in ["Axis(\"n\")", "Track(\"n\", [(0, 1.0), (50, 101.0)])"] {
        let nodes = format!(
            r#"a: Number, b: Scale(value: "a", by: {by}), g: Gather(input: "b", over: "n"),
            s: WriteNumber(number: "g", path: "a.txt"), t: WriteNumber(number: "b", path: "{{n}}.txt"),"#
        );
        let text = lab.mistakes(&graph("n: Range(0, 200)", &nodes));
        assert!(text.contains("`by` is out of range: 10"), "{text}");
        assert_eq!(text.matches("error: ").count(), 1, "{text}");
    }
}
