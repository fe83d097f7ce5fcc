//! Tests of graphs that consist of several files: includes, overlays, and the positions of mistakes.

use engine::{Graph, Source, SourceRoot};

use crate::arithmetic::registry;
use crate::lab::{Lab, graph_text};

impl Lab {
    /// The text of a graph with everything it includes.
    fn joined(&self, text: &str) -> String {
        Source::new("graph.ron", text).including(&SourceRoot::new(self.path(""))).0.text.to_string()
    }

    fn write_in(&self, folder: &str, name: &str, text: &str) {
        std::fs::create_dir_all(self.path(folder)).unwrap();
        self.write(&format!("{folder}/{name}"), text);
    }
}

fn with(include: &str, nodes: &str) -> String {
    graph_text(nodes).replace("version: 1,", &format!("version: 1, include: {include},"))
}

fn part(rest: &str, nodes: &str) -> String {
    format!("Graph(\n  version: 1, {rest}\n  nodes: (\n    {nodes}\n  ),\n)\n")
}

#[test]
fn nodes_of_included_files_are_nodes_of_the_graph() {
    let lab = Lab::on_disk();
    lab.write_in("lib", "five.txt", "5");
    lab.write_in(
        "lib",
        "more.ron",
        &part("include: \"../deep/last.ron\",", "ten: Scale(value: \"five\", by: 2.0),"),
    );
    lab.write_in(
        "deep",
        "last.ron",
        &part("include: [\"../lib/more.ron\"],", "five: LoadNumber(path: \"../lib/five.txt\"),"),
    );
    let text = with(
        "[\"lib/more.ron\"]",
        "sum: Add(terms: [\"five\", \"ten\"]), s: WriteNumber(number: \"sum\", path: \"s.txt\"),",
    );
    assert_eq!(lab.run_text(&lab.joined(&text)).ran(), "five s sum ten", "circular includes are harmless");
    assert_eq!(lab.out("s.txt"), "15.0\n");
    // The same in one file is the same: nothing runs.
    lab.write("five.txt", "5");
    let flat = r#"ten: Scale(value: "five", by: 2.0), five: LoadNumber(path: "lib/five.txt"),
        sum: Add(terms: ["five", "ten"]), s: WriteNumber(number: "sum", path: "s.txt"),"#;
    assert_eq!(lab.run(flat).outcome.totals.ran, 1, "only a path is spelt in another way");
}

#[test]
fn the_scene_and_the_axes_may_come_from_an_included_file() {
    let lab = Lab::in_memory();
    lab.write(
        "base.ron",
        &part("scene: (up: \"+y\", seed: 3), axes: (n: Range(0, 3)),", "a: Number(value: Axis(\"n\")),"),
    );
    let text = "Graph(version: 1, include: [\"base.ron\"], nodes: (b: Add(terms: \"a\"),))";
    let graph = lab.parse(&lab.joined(text)).unwrap();
    assert_eq!((graph.nodes.len(), graph.scene.seed), (6, 3));
    let own = text.replace("nodes:", "scene: (up: \"+z\", seed: 9), nodes:");
    assert_eq!(lab.parse(&lab.joined(&own)).unwrap().scene.seed, 9, "the graph's own scene wins");
}

#[test]
fn mistakes_are_reported_to_be_where_they_are() {
    let lab = Lab::in_memory();
    lab.write("part.ron", &part("", "five: Nmber,\n    one: Scale(value: \"none\"),\n    twin: Number,"));
    let mistakes = lab.mistakes(
        &lab.joined(&with("[\"part.ron\", \"gone.ron\"]", "twin: Number, n: Scale(value: \"onn\"),")),
    );
    for wanted in [
        "part.ron:4:11\n",
        "part.ron:5:23\n",
        "two nodes are named `twin`",
        "graph.ron:2:1\n",
        "part.ron:6:5\n",
        "`gone.ron` cannot be read",
        "graph.ron:1:41\n",
        "did you mean `one`?",
    ] {
        assert!(mistakes.contains(wanted), "{wanted} is missing in\n{mistakes}");
    }
    let places = lab.parse(&lab.joined(&with("\"part.ron\"", ""))).err().unwrap().mistakes();
    assert!(places.iter().all(|mistake| mistake.file == "part.ron" && mistake.line >= 4), "{places:?}");
    assert!(lab.mistakes(&lab.joined(&with("3", ""))).contains("`include` takes paths"));
}

const GRAPH: &str = r#"one: Number(value: 1.0), two: Scale(value: "one", by: 2.0), s: WriteNumber(number: "two", path: "s.txt"),"#;

#[test]
fn what_is_laid_over_takes_the_place_of_what_is_written() {
    let lab = Lab::on_disk();
    let text = graph_text(GRAPH).replace(
        "nodes:",
        "axes: (n: Range(0, 2)), presets: (big: (two: (by: 10.0)), huge: (two: (by: 50.0), one: (value: 2.0))), nodes:",
    );
    let source = || Source::new("graph.ron", text.as_str());
    let out = |source: Source| {
        lab.run_text(&source.text);
        lab.out("s.txt")
    };
    assert_eq!(out(source()), "2.0\n");
    assert_eq!(out(source().with_preset("big", &registry())), "10.0\n");
    assert_eq!(
        out(source().with_preset("huge", &registry()).with_preset("big", &registry())),
        "20.0\n",
        "the last one wins"
    );
    let overlay = "Overlay(scene: (seed: 5), nodes: (two: Scale(by: 3.0),),)";
    let over = source().with_preset("big", &registry()).overlaid("mine.ron", overlay);
    assert_eq!(lab.parse(&over.text).unwrap().scene.seed, 5);
    assert_eq!(out(over.clone()), "3.0\n");
    let set = engine::apply(&over, &["two.by=4".parse().unwrap(), "scene.seed=6".parse().unwrap()]);
    assert_eq!(lab.parse(&set.text).unwrap().scene.seed, 6);
    assert_eq!(out(set), "4.0\n");
    let axis = engine::apply(
        &source(),
        &["one.value=Axis(\"n\")".parse().unwrap(), "s.path=s{n}.txt".parse().unwrap()],
    );
    let axis = engine::apply(&axis, &["axes.n=Range(0, 5)".parse().unwrap()]);
    assert_eq!(lab.parse(&axis.text).unwrap().nodes.len(), 15);
}

#[test]
fn mistakes_of_overlays_lie_in_them() {
    let lab = Lab::in_memory();
    let text =
        graph_text(GRAPH).replace("nodes:", "presets: (big: (tow: (by: 1.0)), small: (two: 3)), nodes:");
    let source = || Source::new("graph.ron", text.as_str());
    let wrong = |source: Source| lab.mistakes(&source.text);
    for (source, wanted) in [
        (
            source().overlaid("mine.ron", "Overlay(nodes: (tow: (by: 3.0)))"),
            &["mine.ron:1:17\n", "did you mean `two`?"][..],
        ),
        (
            source().overlaid("mine.ron", "Overlay(nodes: (two: (bye: 3.0)))"),
            &["mine.ron:1:23\n", "did you mean `by`?"],
        ),
        (
            source().overlaid("mine.ron", "Overlay(nodes: (two: (by: 1e9)))"),
            &["mine.ron:1:27\n", "out of range"],
        ),
        (
            source().overlaid("mine.ron", "(two: (by: 1))"),
            &["mine.ron:1:1\n", "an overlay must begin with `Overlay(`"],
        ),
        (source().overlaid("mine.ron", "Overlay(nodes: ("), &["mine.ron:1:16\n", "no matching"]),
        (
            source().with_preset("bigg", &registry()),
            &["--preset:1:1\n", "no preset `bigg`", "did you mean `big`?"],
        ),
        (
            source().with_preset("big", &registry()),
            &["graph.ron:1:63\n", "no node is named `tow`", "did you mean `two`?"],
        ),
        (source().with_preset("small", &registry()), &["graph.ron:1:", "is not a node"]),
        (
            engine::apply(&source(), &["two.by=\"a\"".parse().unwrap()]),
            &["--set:1:8\n", "two.by=\"a\"", "takes a number"],
        ),
    ] {
        let text = wrong(source);
        for part in wanted {
            assert!(text.contains(part), "{part} is missing in\n{text}");
        }
    }
}

#[test]
fn what_an_included_file_states_is_read_though_it_does_not_count() {
    let lab = Lab::in_memory();
    lab.write("part.ron", "Graph(version: 7, scene: (upp: 3), nodes: (a: Number,))");
    for use_of in
        ["include: [\"part.ron\"], nodes: (b: Number,)", "nodes: (b: Subgraph(graph: \"part.ron\"),)"]
    {
        let text = format!("Graph(version: 1, scene: (up: \"+z\"), {use_of})");
        let mistakes = lab.mistakes(&lab.joined(&text));
        for wanted in ["version 7 of graph files is unknown", "`scene` has no field `upp`", "part.ron:1:16\n"]
        {
            assert!(mistakes.contains(wanted), "{wanted} is missing in\n{mistakes}");
        }
    }
}

#[test]
fn a_circle_of_includes_through_the_graph_itself_is_no_trouble() {
    let lab = Lab::in_memory();
    let file = |include: &str, nodes: &str| {
        format!("Graph(version: 1, include: [\"{include}\"], scene: (up: \"+z\"), nodes: ({nodes}))")
    };
    lab.write("a.ron", &file("./b.ron", "a: Scale(value: \"b\"),"));
    lab.write("b.ron", &file("a.ron", "b: Number,"));
    lab.write("self.ron", &file("self.ron", "c: Number,"));
    for (name, nodes) in [("a.ron", 2), ("b.ron", 2), ("self.ron", 1)] {
        let path = lab.path(name);
        let text = std::fs::read_to_string(&path).unwrap();
        let root = SourceRoot::new(path.parent().unwrap());
        let (source, _) = Source::new(path.display().to_string(), text).including(&root);
        let graph = Graph::parse(source.clone(), &registry(), root.clone()).unwrap();
        assert_eq!(graph.nodes.len(), nodes, "{name}");
        // The joined text is a graph by itself, as in a bundle, wherever it lies.
        let (again, _) = Source::packed("bundle.lhb", source.text.clone()).including(&root);
        assert_eq!(again.text, source.text);
    }
}

#[test]
fn a_setting_gives_a_scene_to_a_file_that_has_none() {
    let lab = Lab::in_memory();
    let source = Source::new("graph.ron", "Graph(version: 1, nodes: (a: Number,))");
    assert!(lab.mistakes(&source.text).contains("has no `scene`"));
    let set = |settings: &[&str]| {
        let settings: Vec<engine::Setting> = settings.iter().map(|text| text.parse().unwrap()).collect();
        engine::apply(&source, &settings).text.to_string()
    };
    assert_eq!(lab.parse(&set(&["scene.up=-y", "scene.seed=4"])).unwrap().scene.seed, 4);
    let mistakes = lab.mistakes(&set(&["scene.upp=-y"]));
    assert!(mistakes.contains("`scene` has no field `upp`"), "{mistakes}");
}

// A node may have the name of a block. An earlier version set a field of such a node only if the graph file sets it as
// well, and otherwise reported that the block has no such field.
#[test]
fn a_node_named_like_a_block_can_be_set() {
    let lab = Lab::in_memory();
    let text = "Graph(version: 1, scene: (up: \"+z\", seed: 1), axes: (n: Range(0, 2)), nodes: (scene: Number, \
        two: Scale(value: \"scene\", by: 1.0), s: WriteNumber(number: \"two\", path: \"s.txt\"), axes: Number,))";
    let source = || Source::new("graph.ron", text);
    let set = |settings: &[&str]| {
        let settings: Vec<engine::Setting> = settings.iter().map(|text| text.parse().unwrap()).collect();
        engine::apply(&source(), &settings)
    };
    let of = |source: Source| {
        let graph = lab.parse(&source.text).unwrap();
        lab.run_text(&source.text);
        (graph.scene.seed, lab.out("s.txt"))
    };
    assert_eq!(of(source()), (1, "1.0\n".to_owned()));
    // The node has `value`, and the block has `seed`.
    assert_eq!(of(set(&["scene.value=7", "scene.seed=3"])), (3, "7.0\n".to_owned()));
    assert_eq!(of(set(&["nodes.scene.value=8", "graph.scene.seed=4"])), (4, "8.0\n".to_owned()));
    assert_eq!(of(set(&["nodes.two.by=2"])), (1, "2.0\n".to_owned()));
    for overlay in [
        "Overlay(nodes: (scene: (value: 9.0)))",
        "Overlay(scene: (seed: 1), nodes: (scene: (value: 9.0)))",
        "Overlay(nodes: (nodes.scene: (value: 9.0), graph.scene: (seed: 1)))",
    ] {
        assert_eq!(of(source().overlaid("mine.ron", overlay)), (1, "9.0\n".to_owned()), "{overlay}");
    }
    let axis = set(&["axes.n=Range(0, 5)", "axes.value=Axis(\"n\")"]);
    assert_eq!(lab.parse(&axis.text).unwrap().find_all("axes").len(), 5);
    // What neither of them has is reported for the one that is meant.
    for (setting, says) in [
        ("scene.valeu=7", "`Number` has no field `valeu`"),
        ("nodes.scene.seed=7", "`Number` has no field `seed`"),
        ("graph.scene.value=7", "`scene` has no field `value`"),
        ("nodes.scen.value=7", "no node is named `scen`"),
    ] {
        let mistakes = lab.mistakes(&set(&[setting]).text);
        assert!(mistakes.contains(says), "{setting}: {mistakes}");
    }
    let mistakes = lab.mistakes(&source().overlaid("mine.ron", "Overlay(scene: (value: 9.0))").text);
    assert!(mistakes.contains("`scene` has no field `value`"), "{mistakes}");
}

// A field that the block and the node of the same name both have.
#[test]
fn a_field_of_a_block_and_a_node_of_one_name_is_ambiguous() {
    let lab = Lab::in_memory();
    for node in ["parameters: Number", "parameters: Number(value: 2.0)"] {
        let text = format!(
            "Graph(version: 1, scene: (up: \"+z\"), parameters: (value: 1.0), nodes: ({node}, b: Scale(value: \"parameters\", \
             by: Param(\"value\")), s: WriteNumber(number: \"b\", path: \"s.txt\")))"
        );
        let set = |setting: &str| {
            engine::apply(&Source::new("graph.ron", text.as_str()), &[setting.parse().unwrap()])
                .text
                .to_string()
        };
        let mistakes = lab.mistakes(&set("parameters.value=3"));
        assert!(
            mistakes.contains("the block `parameters` and the node `parameters` both have a field `value`")
                && mistakes.contains("write `nodes.parameters.value` for the field of the node")
                && mistakes.contains("or `graph.parameters.value` for the field of the block"),
            "{mistakes}"
        );
        lab.run_text(&set("graph.parameters.value=3"));
        let by_block = lab.out("s.txt");
        lab.run_text(&set("nodes.parameters.value=3"));
        let by_node = lab.out("s.txt");
        let own = if node.ends_with(')') { 2.0 } else { 1.0 };
        assert_eq!((by_block, by_node), (format!("{:?}\n", own * 3.0), "3.0\n".to_owned()));
    }
}

#[test]
fn presets_reach_what_is_included() {
    let lab = Lab::in_memory();
    lab.write("part.ron", &part("presets: (big: (a: (value: 9.0))),", "a: Number,"));
    let root = SourceRoot::new(lab.path("."));
    let text =
        "Graph(version: 1, include: [\"part.ron\"], scene: (up: \"+z\"), nodes: (b: Add(terms: \"a\"),))";
    let (source, _) = Source::new("graph.ron", text).including(&root);
    let source = source.with_preset("big", &registry());
    assert!(Graph::parse(source, &registry(), root).is_ok());
}

#[test]
fn presets_of_one_name_are_laid_together_the_graphs_own_last() {
    let lab = Lab::on_disk();
    let of_part = "presets: (big: (a: (value: 9.0), b: (value: 5.0))),";
    lab.write("part.ron", &part(of_part, "a: Number(value: 1.0), b: Number(value: 1.0),"));
    let text = with(
        "[\"part.ron\"]",
        "sum: Add(terms: [\"a\", \"b\"]), s: WriteNumber(number: \"sum\", path: \"s.txt\"),",
    )
    .replace("nodes:", "presets: (big: (a: (value: 2.0))), nodes:");
    let source = Source::packed("graph.ron", lab.joined(&text)).with_preset("big", &registry());
    lab.run_text(&source.text);
    assert_eq!(lab.out("s.txt"), "7.0\n");
}

#[test]
fn a_graph_can_be_had_without_its_presets() {
    let text = graph_text(GRAPH).replace("nodes:", "presets: (big: (two: (by: 10.0))), nodes:");
    let source = Source::new("graph.ron", text);
    let over = |source: Source| source.overlaid("mine.ron", "Overlay(nodes: (two: (by: 3.0)))");
    let laid = source.clone().with_preset("big", &registry()).with_preset("draft", &registry());
    assert_ne!(laid, source);
    assert_eq!(over(laid).without_presets(), over(source.clone()));
    assert_eq!(source.without_presets(), source);
}

#[cfg(unix)]
#[test]
fn files_without_an_end_and_pipes_are_refused_and_named() {
    let lab = Lab::on_disk();
    assert!(std::process::Command::new("mkfifo").arg(lab.path("pipe")).status().unwrap().success());
    // Sparse: a reader that took it whole would need 8 GiB.
    std::fs::File::create(lab.path("big.ron")).unwrap().set_len(8 << 30).unwrap();
    let cases = [
        ("pipe", "the path is a pipe"),
        ("/dev/zero", "the path is a device"),
        ("big.ron", "longer than 64 MiB"),
    ];
    for (name, why) in cases {
        let include = with(&format!("[\"{name}\"]"), "a: Number(),");
        let subgraph = graph_text(&format!("a: Subgraph(graph: \"{name}\"),"));
        for text in [include, subgraph] {
            let start = std::time::Instant::now();
            let source = Source::new("graph.ron", lab.joined(&text));
            let mistakes = Graph::parse(source, &registry(), SourceRoot::new(lab.path(""))).err().unwrap();
            let said = mistakes.render(false);
            assert!(said.contains(&format!("`{name}` cannot be read: ")) && said.contains(why), "{said}");
            assert!(start.elapsed().as_secs() < 5, "{name}: not read");
        }
    }
}
