//! Tests of plans: the steps of a run and their reasons, reported without a run.

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

/// The plan as text, one line per node.
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
fn a_plan_reports_what_is_known_what_changed_and_what_depends_on_it() {
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
fn a_plan_finds_out_what_takes_no_time_and_where_an_edit_stops() {
    let lab = Lab::on_disk();
    let nodes = "n: Number(value: 2.2), s: Scale(value: \"n\"), r: Round(value: \"s\"), \
        l: Slow(value: \"r\", millis: 1), t: Scale(value: \"l\"), w: WriteNumber(number: \"t\", path: \"w.txt\")";
    lab.run(nodes);
    let equal = plan(&lab, &nodes.replace("2.2", "2.1"), &[]);
    assert_eq!(equal[0], "n value: 2.2 -> 2.1");
    assert!(equal[1].starts_with("s value[2].content: ") && equal[2].starts_with("r value[2].content: "));
    assert_eq!(equal[3..], ["l known", "t known", "w known"], "4.2 is rounded as 4.4 is");
    let other = plan(&lab, &nodes.replace("2.2", "3.1"), &[]);
    assert!(other[3].starts_with("l value[2].content: "), "{other:?}");
    assert_eq!(other[4..], ["t after l", "w after t"]);
    assert_eq!(lab.run(nodes).ran(), "", "a plan leaves no trace");
}

#[test]
fn a_forecast_follows_kind_and_work_and_not_names() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(), s: Slow(value: \"a\", millis: 20)";
    lab.run(nodes);
    let forecast = |nodes: &str| {
        let graph = lab.parse(&graph_text(nodes)).unwrap();
        lab.engine().plan(&graph, &[]).last().unwrap().clone()
    };
    assert_eq!(forecast(nodes).forecast, None, "nothing would run");
    let seconds = forecast("b: Number(), other: Slow(value: \"b\", millis: 40)").forecast.unwrap();
    let graph = lab.parse(&graph_text(nodes)).unwrap();
    let took = lab.engine().past(&graph, 1, &forecast(nodes)).spent.unwrap();
    assert!(took.seconds >= 0.02 && took.work == 20.0 && took.memory > 0, "{took:?}");
    assert!((seconds / took.seconds - 2.0).abs() < 1e-9, "twice the work: {seconds}");
    assert_eq!(forecast("b: Number(), d: Split(value: \"b\")").forecast, None, "that kind never ran");
}

#[test]
fn a_forecast_leaves_out_the_parts_that_are_kept() {
    let lab = Lab::on_disk();
    lab.run("a: Number(), s: Series(value: \"a\", samples: 100)");
    let forecast = |nodes: &str| {
        let graph = lab.parse(&graph_text(nodes)).unwrap();
        lab.engine().plan(&graph, &[]).last().unwrap().forecast.unwrap()
    };
    let all = forecast("a: Number(), new: Series(value: \"a\", samples: 400)");
    let rest = forecast("a: Number(), s: Series(value: \"a\", samples: 400)");
    assert!(all > 0.0 && (rest / all - 0.75).abs() < 1e-9, "{rest} of {all}");
    let other = forecast("a: Number(value: 2.0), s: Series(value: \"a\", samples: 400)");
    assert_eq!(other, all, "nothing is kept of another value");
}

#[test]
fn what_changed_is_remembered_after_the_run() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(value: 30.0), s: Slow(value: \"a\", millis: 1)";
    lab.run(nodes);
    let edited = nodes.replace("30.0", "35.0");
    lab.run(&edited);
    lab.run(&edited);
    let graph = lab.parse(&graph_text(&edited)).unwrap();
    let planned = lab.engine().plan(&graph, &[]);
    assert_eq!(planned[0].fate, Fate::Known);
    let past = |node: usize| lab.engine().past(&graph, node, &planned[node]).changes;
    assert!(
        matches!(&past(0)[..], [c] if c.path == "value" && c.old.as_deref() == Some("30.0")),
        "{:?}",
        past(0)
    );
    assert_eq!(past(1).len(), 1);
}

#[test]
fn a_trace_reports_what_ran_when_and_where() {
    let lab = Lab::on_disk();
    let graph = lab.parse(&graph_text("a: Number(), s: Series(value: \"a\")")).unwrap();
    let options = engine::RunOptions { out: lab.path("out"), trace: true, ..Default::default() };
    let mut spans = Vec::new();
    lab.engine().run(&graph, &options, |event| {
        if let engine::Event::Span { id, what, thread, start, seconds } = event {
            assert!(thread < 2 && start >= 0.0 && seconds >= 0.0);
            spans.push(format!("{id} {what}"));
        }
    });
    for wanted in ["a code", "a store", "s code", "s store"] {
        assert!(spans.iter().any(|span| span == wanted), "{wanted} in {spans:?}");
    }
    assert!(spans.iter().any(|span| span.starts_with("s chunk")), "parts: {spans:?}");
}

#[test]
fn keys_are_what_they_have_always_been() {
    // A change here makes every result of every user run again: raise the format in `key` and document it.
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
