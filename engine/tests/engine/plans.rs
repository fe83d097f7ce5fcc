//! What a run would do and why, told without running anything.

use engine::{Fate, Why};

use crate::lab::{Lab, graph_text};

const GRAPH: &str = r#"
    a: LoadNumber(path: "a.txt"),
    b: Scale(value: "a", by: 3.0),
    c: Round(value: "b"),
    d: Scale(value: "c"),
    w: WriteNumber(number: "d", path: "w.txt"),
    x: Scale(value: "a", by: 9.0),
"#;

/// One word or line a node.
fn plan(lab: &Lab, nodes: &str, only: &[&str]) -> Vec<String> {
    let graph = lab.parse(&graph_text(nodes)).unwrap();
    let only: Vec<usize> = only.iter().map(|id| graph.find(id).unwrap()).collect();
    let planned = lab.engine().plan(&graph, &only);
    let line = |fate: &Fate| match fate {
        Fate::Unwanted => "unwanted".to_owned(),
        Fate::Known => "known".to_owned(),
        Fate::Lost => "lost".to_owned(),
        Fate::Runs(Why::New) => "new".to_owned(),
        Fate::Runs(Why::Changed(changes)) => {
            let line = |c: &engine::Change| {
                format!(
                    "{}: {} -> {}",
                    c.path,
                    c.old.as_deref().unwrap_or("-"),
                    c.new.as_deref().unwrap_or("-")
                )
            };
            changes.iter().map(line).collect::<Vec<_>>().join("; ")
        }
        Fate::Follows(id) => format!("after {id}"),
        Fate::Fails(why) => format!("fails: {why}"),
    };
    planned.iter().map(|node| format!("{} {}", node.id, line(&node.fate))).collect()
}

#[test]
fn a_plan_tells_what_is_known_what_changed_and_what_depends_on_it() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "2");
    let new = ["a new", "b after a", "c after b", "d after c", "w after d", "x unwanted"];
    assert_eq!(plan(&lab, GRAPH, &[]), new);
    lab.run(GRAPH);
    assert_eq!(plan(&lab, GRAPH, &[]), ["a known", "b known", "c known", "d known", "w known", "x unwanted"]);
    assert_eq!(plan(&lab, GRAPH, &["x"])[5], "x new");
    let edited = plan(&lab, &GRAPH.replace("by: 3.0", "by: 3.1"), &[]);
    assert_eq!(edited[..4], ["a known", "b by: 3.0 -> 3.1", "c after b", "d after c"]);
    let log = lab.run(&GRAPH.replace("by: 3.0", "by: 3.1"));
    assert_eq!(log.ran(), "b c", "what follows may turn out equal");
}

#[test]
fn a_plan_names_the_file_that_changed_or_is_gone() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "2");
    lab.run(GRAPH);
    lab.write("a.txt", "3");
    let plan_now = plan(&lab, GRAPH, &[]);
    assert!(
        plan_now[0].starts_with("a sources[0].\"a.txt\": ") && plan_now[0].contains(" -> "),
        "{plan_now:?}"
    );
    // A graph that was checked before its file went away.
    let graph = lab.parse(&graph_text(GRAPH)).unwrap();
    std::fs::remove_file(lab.path("a.txt")).unwrap();
    let planned = lab.engine().plan(&graph, &[]);
    assert!(matches!(&planned[0].fate, Fate::Fails(why) if why.contains("cannot read")));
    assert_eq!(planned[1].fate, Fate::Follows("a".to_owned()));
}

#[test]
fn a_forecast_is_how_long_it_took() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(), s: Slow(value: \"a\", millis: 60)";
    lab.run(nodes);
    let graph = lab.parse(&graph_text(&nodes.replace("Number()", "Number(value: 2)"))).unwrap();
    let planned = lab.engine().plan(&graph, &[]);
    assert!(planned[1].forecast.is_some_and(|seconds| (0.06..6.0).contains(&seconds)), "{planned:?}");
    assert_eq!(lab.run(nodes).ran(), "", "a plan leaves no trace");
}

#[test]
fn keys_are_what_they_have_always_been() {
    // A change here makes every result of every user run once more: raise the format in `key` and say so.
    let lab = Lab::on_disk();
    lab.write("a.txt", "2");
    let log = lab.run(GRAPH);
    let keys: Vec<String> = log.keys().into_iter().map(|(id, key)| format!("{id} {}", &key[..16])).collect();
    let known = [
        "a d909b6ffa1efda5e",
        "b bd18e25f34da36d8",
        "c 73e99cdfcf3687a7",
        "d 249b9f5e20950f4b",
        "w fe18150e7b349da0",
    ];
    assert_eq!(keys, known);
}
