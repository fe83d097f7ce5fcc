//! Tests of changes that make a node run again, and of changes that do not.

use std::time::Duration;

use engine::KindEntry;

use crate::lab::{Lab, graph_text};

const GRAPH: &str = r#"
    a: LoadNumber(path: "a.txt"),
    b: Number(value: 2.5),
    sum: Add(terms: ["a", "b"]),
    whole: Round(value: "sum"),
    double: Scale(value: "whole"),
    save: WriteNumber(number: "double", path: "double.txt"),
    aside: Scale(value: "b", by: 10.0),
    other: WriteNumber(number: "aside", path: "aside.txt"),
"#;

fn labs() -> [Lab; 2] {
    [Lab::on_disk(), Lab::in_memory()].map(|lab| {
        lab.write("a.txt", "4\n");
        lab
    })
}

/// A lab in which the graph has run once.
fn warm() -> Lab {
    let lab = Lab::on_disk();
    lab.write("a.txt", "4\n");
    lab.run(GRAPH);
    lab
}

/// All spellings of a number give the same key, and -0 gives the same key as 0. NaN is reported as a mistake at its
/// position in the text.
#[test]
fn equal_values_have_equal_keys_however_they_are_written() {
    let lab = Lab::in_memory();
    let nodes = |value: &str| format!("a: Number(value: {value}), b: Scale(value: \"a\", by: {value})");
    for (first, others) in [("0.1", ["0.10", "1e-1", "10e-2"]), ("0.0", ["-0.0", "0", "-0e7"])] {
        assert_eq!(lab.run(&nodes(first)).ran(), "a b");
        for other in others {
            assert_eq!(lab.run(&nodes(other)).ran(), "", "{other}");
        }
    }
    assert_eq!(lab.run(&nodes("0.10000000000000002")).ran(), "a b");
    for none in ["NaN", "-NaN", "inf", "-inf"] {
        let reported = lab.mistakes(&graph_text(&nodes(none)));
        assert!(reported.contains("graph.ron:2:") && reported.contains("value"), "{none}: {reported}");
    }
}

#[test]
fn everything_runs_once_and_then_nothing() {
    for lab in labs() {
        let cold = lab.run(GRAPH);
        assert_eq!(cold.ran(), "a aside b double other save sum whole");
        assert_eq!(cold.files(), "aside.txt* double.txt*");
        assert_eq!((lab.out("double.txt"), lab.out("aside.txt")), ("14.0\n".into(), "25.0\n".into()));
        assert_eq!(cold.outcome.totals.counts["terms"], 2);
        let warm = lab.run(GRAPH);
        assert_eq!((warm.ran(), warm.remade()), (String::new(), String::new()));
        assert_eq!(warm.cached(), cold.ran());
        assert_eq!(warm.files(), "aside.txt double.txt");
        assert_eq!(warm.keys(), cold.keys());
        assert!(warm.outcome.totals.counts.is_empty(), "counts hold only what ran");
        assert_eq!((cold.exit_code(), warm.exit_code()), (0, 0));
    }
}

#[test]
fn an_edit_reruns_its_cone_and_nothing_else() {
    let lab = warm();
    let log = lab.run(&GRAPH.replace("by: 10.0", "by: 11.0"));
    assert_eq!((log.ran().as_str(), log.remade().as_str()), ("aside other", ""));
    assert_eq!(log.files(), "aside.txt* double.txt");
    assert_eq!(lab.out("aside.txt"), "27.5\n");
}

#[test]
fn equal_bytes_stop_the_rerun() {
    let lab = warm();
    // 4 + 2.5 and 4 + 2.6 both round to 7; the file is loaded because `sum` reads it.
    let log = lab.run(&GRAPH.replace("value: 2.5", "value: 2.6"));
    assert_eq!(log.ran(), "aside b other sum whole");
    assert_eq!(log.remade(), "a");
    assert_eq!(log.cached(), "a double save");
}

#[test]
fn names_layout_and_touch_do_not_matter() {
    let lab = warm();
    let edits = [
        GRAPH.replace("whole", "entire"),
        GRAPH.lines().rev().collect::<Vec<_>>().join("\n"),
        GRAPH.replace("b: Number", "/* why */ b: // here\n\tNumber").replace('\n', "\r\n"),
        GRAPH.replace("2.5", "25e-1"),
        GRAPH.replace("\"sum\"", "\"sum.number\"").replace("number: \"double\"", "number: [\"double\"]"),
    ];
    for edit in edits {
        let log = lab.run(&edit);
        assert_eq!((log.ran().as_str(), log.remade().as_str()), ("", ""), "{edit}");
    }
    std::thread::sleep(Duration::from_millis(5));
    lab.write("a.txt", "4\n");
    assert_eq!(lab.run(GRAPH).ran(), "");
    lab.write("a.txt", "5\n");
    assert_eq!(lab.run(GRAPH).ran(), "a double save sum whole");
    assert_eq!(lab.out("double.txt"), "16.0\n");
}

#[test]
fn a_default_written_out_is_the_default() {
    let lab = warm();
    for edit in [
        GRAPH.replace("Add(terms", "Add(bias: 0.0, terms"),
        GRAPH.replace("Add(terms", "Add(bias: -0.0, terms"),
        GRAPH.replace("Add(terms", "Add(bias: -0, terms"),
        GRAPH.replace("Round(value", "Round(towards: Nearest, value"),
        GRAPH.replace("\"whole\")", "\"whole\", by: 2)"),
    ] {
        assert_eq!(lab.run(&edit).ran(), "", "{edit}");
    }
}

#[test]
fn a_setting_is_an_edit() {
    let lab = warm();
    let text = graph_text(GRAPH);
    let set = |setting: &str| {
        let source = engine::Source::new("graph.ron", text.as_str());
        engine::apply(&source, &[setting.parse().unwrap()]).text
    };
    assert_eq!(lab.run_text(&set("aside.by=-3")).ran(), "aside other");
    assert_eq!(lab.out("aside.txt"), "-7.5\n");
    assert_eq!(lab.run_text(&set("double.by=2.0")).ran(), "");
    assert_eq!(lab.run_text(&set("whole.towards=Down")).ran(), "double save whole");
}

#[test]
fn the_scene_enters_only_where_it_is_read() {
    let lab = Lab::on_disk();
    let nodes = "s: Seeded(), u: UpAxis(), c: Number(), ws: WriteNumber(number: \"s\", path: \"s\"),\
        wu: WriteNumber(number: \"u\", path: \"u\"), wc: WriteNumber(number: \"c\", path: \"c\")";
    let text = graph_text(nodes);
    lab.run_text(&text);
    assert_eq!(lab.run_text(&text.replace("seed: 7", "seed: 8")).ran(), "s ws");
    assert_eq!(lab.run_text(&text.replace("+z", "-y")).ran(), "u wu");
    assert_eq!(lab.run_text(&text.replace("seed: 7", "metres_per_unit: 2.0, seed: 7")).ran(), "");
}

#[test]
fn a_new_version_of_a_kind_reruns_it() {
    let mut lab = warm();
    let mut entry = KindEntry::of::<crate::arithmetic::Round>();
    entry.version += 1;
    lab.registry = crate::arithmetic::registry_with(entry);
    let log = lab.run(GRAPH);
    assert_eq!(log.ran(), "whole", "its result is the same, so nothing below runs");
}

#[test]
fn what_was_only_digested_is_remade_only_for_a_reader() {
    let lab = warm();
    assert_eq!(lab.run(&GRAPH.replace("by: 10.0", "by: 12.0")).remade(), "");
    let log = lab.run(&GRAPH.replace("Add(terms", "Add(bias: 1.0, terms"));
    assert_eq!((log.remade().as_str(), log.ran().as_str()), ("a", "double save sum whole"));
    assert_eq!(lab.out("double.txt"), "16.0\n");
}

#[test]
fn keys_do_not_depend_on_threads_or_folder() {
    let mut keys = Vec::new();
    for jobs in [1, 2, 5] {
        let mut lab = Lab::on_disk();
        lab.jobs = jobs;
        lab.write("a.txt", "4\n");
        let log = lab.run(GRAPH);
        keys.push((log.keys(), lab.out("double.txt"), lab.out("aside.txt")));
    }
    assert!(keys.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn a_recipe_reports_how_and_not_where() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "4");
    let nodes = "x: LoadNumber(path: \"a.txt\"), two: Scale(value: \"x\", by: 2.0), \
        three: Scale(value: \"two\", by: 3.0), save: WriteRecipe(number: [\"three\", \"x\"], path: \"deep/r.txt\")";
    lab.run(nodes);
    let recipe = lab.out("deep/r.txt");
    assert_eq!(
        recipe,
        format!(
            "// lightharmony recipe 2: load-number 1 portable, scale 1 portable, write-recipe 1 portable\n\
            Graph(version:1,scene:(up:\"+z\",metres_per_unit:1.0,seed:7),nodes:(\n\
            n0:LoadNumber(path:\"a.txt\"),\nn1:Scale(by:2.0,value:\"n0.number\"),\n\
            n2:Scale(by:3.0,value:\"n1.number\"),\n\
            n3:WriteRecipe(path:\"out.txt\",number:[\"n2.number\",\"n0.number\"]),\n))\n\
            // n0 reads a.txt {}\n",
            engine::Digest::of(b"4")
        )
    );
    assert!(lab.parse(&recipe).is_ok(), "a recipe is a graph file");
    let renamed = lab.run(&nodes.replace("two", "zwei").replace("deep/r.txt", "s.txt"));
    assert_eq!((renamed.ran().as_str(), renamed.files().as_str()), ("", "s.txt*"));
}
