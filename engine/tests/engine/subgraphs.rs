//! Tests of subgraphs: the nodes of a file are inserted once per use, each time with other values.

use engine::{Source, SourceRoot};

use crate::lab::{Lab, graph_text};

/// A subgraph that adds its inputs, scales the sum and writes it.
const TWICE: &str = r#"Graph(
    version: 1,
    parameters: (value: Required, by: 2.0, path: "unnamed.txt"),
    nodes: (
        sum:  Add(terms: [Param("value"), "one"], bias: 0.0),
        one:  LoadNumber(path: "one.txt"),
        out:  Scale(value: "sum", by: Param("by")),
        save: WriteNumber(number: "out", path: Param("path")),
    ),
)"#;

impl Lab {
    fn used(&self, source: Source) -> String {
        source.including(&SourceRoot::new(self.path(""))).0.text.to_string()
    }

    fn with_parts(parts: &[(&str, &str)]) -> Self {
        let lab = Self::on_disk();
        std::fs::create_dir_all(lab.path("parts")).unwrap();
        lab.write("parts/one.txt", "1");
        lab.write("parts/twice.ron", TWICE);
        parts.iter().for_each(|(name, text)| lab.write(&format!("parts/{name}"), text));
        lab
    }

    fn set(&self, text: &str, settings: &[&str]) -> String {
        let settings: Vec<_> = settings.iter().map(|setting| setting.parse().unwrap()).collect();
        self.used(engine::apply(&Source::new("graph.ron", text), &settings))
    }
}

fn two_uses() -> String {
    graph_text(
        r#"n: Number(value: 3.0),
        a: Subgraph(graph: "parts/twice.ron", value: "n", path: "a.txt"),
        b: Subgraph(graph: "parts/twice.ron", value: "a.out", by: 10.0, path: "b.txt"),
        t: Round(value: "b.sum.number"),"#,
    )
}

#[test]
fn each_use_has_nodes_of_its_own_with_what_it_is_given() {
    let lab = Lab::with_parts(&[]);
    let text = lab.set(&two_uses(), &[]);
    let ran = lab.run_text(&text).ran();
    assert_eq!(ran.replace("b.one", "a.one").split(' ').count(), 8, "the file is read once: {ran}");
    for each in ["a.out", "a.save", "a.sum", "b.out", "b.save", "b.sum"] {
        assert!(ran.contains(each), "{each} in {ran}");
    }
    assert_eq!((lab.out("a.txt"), lab.out("b.txt")), ("8.0\n".to_owned(), "90.0\n".to_owned()));
    let flat = r#"n: Number(value: 3.0), one: LoadNumber(path: "parts/one.txt"),
        s: Add(terms: ["n", "one"]), o: Scale(value: "s", by: 2.0), w: WriteNumber(number: "o", path: "c.txt")"#;
    assert_eq!(lab.run(flat).ran(), "", "the same, written out, is the same");
}

#[test]
fn settings_reach_what_is_given_and_what_is_inside() {
    let lab = Lab::with_parts(&[]);
    let run = |settings: &[&str]| {
        lab.run_text(&lab.set(&two_uses(), settings));
        (lab.out("a.txt"), lab.out("b.txt"))
    };
    assert_eq!(run(&["a.by=4"]).0, "16.0\n");
    assert_eq!(run(&["a.out.by=5"]).0, "20.0\n");
    assert_eq!(run(&["b.sum.bias=1", "a.by=1"]).1, "60.0\n");
    assert_eq!(run(&["n.value=0"]).1, "30.0\n");
    lab.write("parts/minus.ron", &TWICE.replace("bias: 0.0", "bias: -1.0"));
    assert_eq!(run(&["a.graph=parts/minus.ron"]).0, "6.0\n", "another file, too");
    // The same with an overlay.
    let overlay = "Overlay(nodes: (a: (by: 3.0), a.sum: (bias: 2.0)))";
    let text = lab.used(Source::new("graph.ron", two_uses()).overlaid("mine.ron", overlay));
    lab.run_text(&text);
    assert_eq!(lab.out("a.txt"), "18.0\n");
}

#[test]
fn a_file_of_parameters_runs_by_itself_once_it_is_given_what_it_needs() {
    let lab = Lab::with_parts(&[]);
    let alone = TWICE.replace("nodes: (", "scene: (up: \"+z\"), nodes: (\n        n: Number(value: 1.0),");
    let alone = alone.replace("one.txt", "parts/one.txt");
    let needs = lab.mistakes(&lab.set(&alone, &[]));
    assert!(
        needs.contains("the graph needs a value for the parameter `value`")
            && needs.contains("--set parameters.value=.."),
        "{needs}"
    );
    lab.run_text(&lab.set(&alone, &["parameters.value=n", "parameters.by=7"]));
    assert_eq!(lab.out("unnamed.txt"), "14.0\n");
    let wrong = lab.mistakes(&lab.set(&alone, &["parameters.value=n", "parameters.bye=7"]));
    assert!(wrong.contains("no parameter `bye`") && wrong.contains("did you mean `by`?"), "{wrong}");
}

#[test]
fn what_is_given_may_be_lists_parts_of_values_axes_and_values_of_those_around() {
    let outer = r#"Graph(version: 1, parameters: (all: Required, bias: 1.0), nodes: (
        own: Number(value: 100.0),
        in:  Subgraph(graph: "inner.ron", terms: Param("all"), bias: Param("bias")),
        sum: Add(terms: ["own", Param("all"), "in.sum"]),
    ))"#;
    let inner = r#"Graph(version: 1, parameters: (terms: [], bias: 0.0), nodes: (
        sum: Add(terms: Param("terms"), bias: Param("bias")),
    ))"#;
    let lab = Lab::with_parts(&[("outer.ron", outer), ("inner.ron", inner)]);
    let text = graph_text(
        r#"own: Number(value: 5.0), o: Subgraph(graph: "parts/outer.ron", all: ["own", "own.number"], bias: Axis("n")),
        s: WriteNumber(number: "o.sum", path: "s{n}.txt"),"#,
    )
    .replace("nodes:", "axes: (n: Range(0, 2)), nodes:");
    let log = lab.run_text(&lab.set(&text, &[]));
    assert_eq!(log.ran(), "o.in.sum/n=0 o.in.sum/n=1 o.own o.sum/n=0 o.sum/n=1 own s/n=0 s/n=1");
    assert_eq!((lab.out("s0.txt"), lab.out("s1.txt")), ("120.0\n".to_owned(), "121.0\n".to_owned()));
    let deep = lab.parse(&lab.set(&text, &["o.in.sum.bias=9", "s.path=s.txt"])).unwrap();
    assert_eq!(deep.nodes.len(), 5, "nothing runs along the axis any more");
}

#[test]
fn a_file_brings_its_axes() {
    let file = r#"Graph(version: 1, axes: (n: Range(0, 3)), nodes: (v: Number(value: Axis("n")),))"#;
    let lab = Lab::with_parts(&[("file.ron", file)]);
    let text = graph_text("a: Subgraph(graph: \"parts/file.ron\"), b: Subgraph(graph: \"parts/file.ron\")");
    assert_eq!(lab.parse(&lab.set(&text, &[])).unwrap().nodes.len(), 6);
    assert_eq!(lab.parse(&lab.set(&text, &["axes.n=Range(0, 5)"])).unwrap().nodes.len(), 10);
}

#[test]
fn paths_begin_where_they_are_written() {
    let file =
        r#"Graph(version: 1, parameters: (own: "one.txt"), nodes: (n: LoadNumber(path: Param("own")),))"#;
    let lab = Lab::with_parts(&[("file.ron", file)]);
    lab.write("here.txt", "5");
    let nodes = r#"a: Subgraph(graph: "parts/file.ron"), b: Subgraph(graph: "parts/file.ron", own: "here.txt"),
        s: Add(terms: ["a.n", "b.n"]), w: WriteNumber(number: "s", path: "s.txt"),"#;
    lab.run_text(&lab.set(&graph_text(nodes), &[]));
    assert_eq!(lab.out("s.txt"), "6.0\n");
    assert_eq!(lab.run_text(&lab.set(&graph_text(nodes), &["a.n.path=here.txt"])).failed(), "");
    assert_eq!(lab.out("s.txt"), "10.0\n", "the path of a setting is relative to the graph");
}

#[test]
fn mistakes_are_reported_where_they_are_and_where_they_come_from() {
    let lab = Lab::with_parts(&[
        (
            "slip.ron",
            "Graph(version: 1, nodes: (\n    n: Number(value: 1e9),\n    m: Scale(value: \"nn\"),\n))",
        ),
        ("self.ron", "Graph(version: 1, nodes: (x: Subgraph(graph: \"self.ron\"),))"),
    ]);
    let wrong = |nodes: &str, settings: &[&str]| lab.mistakes(&lab.set(&graph_text(nodes), settings));
    for (nodes, settings, parts) in [
        (
            r#"n: Number, a: Subgraph(graph: "parts/twice.ron", value: "n", by: "x")"#,
            &[][..],
            &["graph.ron:2:66", "`by` takes a number", "parts/twice.ron:7", "read here"][..],
        ),
        (
            r#"n: Number, a: Subgraph(graph: "parts/twice.ron", value: "n", bye: 3.0)"#,
            &[],
            &["has no parameter `bye`", "did you mean `by`?", "its parameters are value, by, path"],
        ),
        (
            r#"a: Subgraph(graph: "parts/twice.ron")"#,
            &[],
            &["`parts/twice.ron` needs `value`", "graph.ron:2:4", "parts/twice.ron:3", "required here"],
        ),
        (
            r#"a: Subgraph(graph: "parts/twice.ron", value: "nn", path: "x.txt"), n: Number"#,
            &[],
            &["no node is named `nn`", "did you mean `n`?", "graph.ron:2:46", "read here"],
        ),
        (
            r#"n: Number, a: Subgraph(graph: "parts/twice.ron", value: "n"), b: Scale(value: "a")"#,
            &[],
            &["`a` is a subgraph", "write \"a.save\"", "its nodes are sum, one, out, save"],
        ),
        (
            r#"n: Number, a: Subgraph(graph: "parts/twice.ron", value: "n"), b: Scale(value: "a.oat")"#,
            &[],
            &["no node is named `a.oat`", "did you mean `a.out`?"],
        ),
        (
            r#"n: Number, a: Subgraph(graph: "parts/twice.ron", value: "n"), b: Scale(value: "a.out.x")"#,
            &[],
            &["`a.out` has no output `x`"],
        ),
        (
            r#"a: Subgraph(graph: "parts/slip.ron"), b: Subgraph(graph: "parts/slip.ron")"#,
            &[],
            &["parts/slip.ron:2:22", "out of range", "in `a`", "parts/slip.ron:3:21", "did you mean `n`?"],
        ),
        (r#"a: Subgraph(graph: "parts/self.ron")"#, &[], &["parts/self.ron:1:46", "uses itself"]),
        (
            r#"a: Subgraph(graph: "parts/gone.ron"), b: Scale(value: "a.n")"#,
            &[],
            &["`parts/gone.ron` cannot be read"],
        ),
        (
            r#"a: Subgraph(graph: 3), b: Subgraph()"#,
            &[],
            &["takes the path of a graph file, not 3", "`Subgraph` needs `graph`"],
        ),
        (
            r#"n: Number(value: Param("x"))"#,
            &[],
            &["the graph has no parameter `x`", "parameters are declared next to"],
        ),
        (r#"n: Number(value: Param(x))"#, &[], &["is not a valid use of a parameter"]),
        (
            r#"n: Number, b: Scale(value: "n")"#,
            &["b.by.x=3"],
            &["no node is named `b.by`", "set the whole parameter: `b.by=..`"],
        ),
        (
            r#"n: Number, a: Subgraph(graph: "parts/twice.ron", value: "n")"#,
            &["a.oat.by=3", "a.bye=3", "a.out.by=x"],
            &[
                "--set:1:1\n",
                "a.oat.by=3",
                "no node is named `a.oat`",
                "--set:1:3\n",
                "no parameter `bye`",
                "--set:1:10\n",
                "takes a number",
            ],
        ),
    ] {
        let text = wrong(nodes, settings);
        for part in parts {
            assert!(text.contains(part), "{part} is missing in\n{text}");
        }
    }
    let twice = wrong(r#"a: Subgraph(graph: "parts/slip.ron"), b: Subgraph(graph: "parts/slip.ron")"#, &[]);
    assert_eq!(
        twice.matches("error: ").count(),
        2,
        "a mistake in the file is reported once, not for each use\n{twice}"
    );
}

#[test]
fn bombs_and_circles_end_soon() {
    let ten: String = (0..10)
        .map(|n| format!("x{n}: Subgraph(graph: \"NEXT\", a: [Param(\"a\"), Param(\"a\")]), "))
        .collect();
    let level = |next: usize| {
        let nodes = ten.replace("NEXT", &format!("l{next}.ron"));
        format!("Graph(version: 1, parameters: (a: []), nodes: ({nodes}))")
    };
    let levels: Vec<(String, String)> = (0..12).map(|n| (format!("l{n}.ron"), level(n + 1))).collect();
    let parts: Vec<(&str, &str)> = levels.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
    let lab = Lab::with_parts(&parts);
    let bomb = lab.mistakes(&lab.set(&graph_text("a: Subgraph(graph: \"parts/l0.ron\")"), &[]));
    assert!(bomb.contains("expand to more than 1000000 nodes"), "{bomb}");
    // One in another a hundred times.
    let deep = |next: usize| format!("Graph(version: 1, nodes: (x: Subgraph(graph: \"d{next}.ron\"),))");
    for n in 0..100 {
        lab.write(&format!("parts/d{n}.ron"), &deep(n + 1));
    }
    let deep = lab.mistakes(&lab.set(&graph_text("a: Subgraph(graph: \"parts/d0.ron\")"), &[]));
    assert!(deep.contains("more than 32 levels deep"), "{deep}");
    // Values that double thirty times, as text and as wires.
    let values = |text: &str| {
        let double = |n: usize| format!("p{}: {}", n + 1, text.replace('#', &format!("Param(\"p{n}\")")));
        let all: Vec<String> = (0..30).map(double).collect();
        format!("parameters: (p0: \"n\", {}), nodes:", all.join(", "))
    };
    for (text, field, what) in [
        ("[#, #]", "s: Add(terms: Param(\"p30\"))", "too many wires"),
        ("[#, #]", "s: Number(value: Param(\"p30\"))", "circle"),
    ] {
        let graph = graph_text(&format!("n: Number, {field}")).replace("nodes:", &values(text));
        let mistakes = lab.mistakes(&graph);
        assert!(mistakes.contains(what) || mistakes.contains("too long"), "{mistakes}");
    }
    let circle = graph_text("s: Scale(value: Param(\"a\"), by: Param(\"b\"))")
        .replace("nodes:", "parameters: (a: Param(\"a\"), b: Param(\"b\")), nodes:");
    let mistakes = lab.mistakes(&circle);
    assert!(mistakes.contains("in a cycle"), "{mistakes}");
}
