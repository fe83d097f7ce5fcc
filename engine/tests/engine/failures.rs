//! Tests of nodes that fail, warn, return a degraded result, or are cancelled.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use engine::{Event, State};

use crate::lab::{Lab, graph_text};

const GRAPH: &str = r#"
    a: Number(value: 20.0),
    bad: Refuse(value: "a", above: 10.0),
    below: Scale(value: "bad", by: 3.0),
    save: WriteNumber(number: ["below", "good"], path: "bad.txt"),
    good: Scale(value: "a"),
    fine: WriteNumber(number: "good", path: "good.txt"),
"#;

#[test]
fn a_failure_stops_only_what_depends_on_it() {
    let lab = Lab::on_disk();
    for ran in ["a fine good", ""] {
        let log = lab.run(GRAPH);
        assert_eq!((log.ran().as_str(), log.failed().as_str()), (ran, "bad"), "failures are not kept");
        assert_eq!(log.skipped(), "below save");
        assert_eq!((log.exit_code(), lab.out("good.txt").as_str()), (1, "40.0\n"));
        let text = log.failures();
        assert!(text.contains("error: `bad` failed: 20 is more than 10"), "{text}");
        assert!(text.contains("graph.ron:4:36") && text.contains("help: raise `above`"), "{text}");
    }
    assert!(!lab.path("out/bad.txt").exists());
    let log = lab.run(&GRAPH.replace("above: 10.0", "above: 20.0"));
    assert_eq!((log.ran().as_str(), log.exit_code()), ("bad below save", 0));
}

#[test]
fn a_panic_is_the_failure_of_one_node() {
    let lab = Lab::on_disk();
    let log = lab.run("a: Number(), p: Panic(value: \"a\"), q: Panic(value: \"a\", early: true), s: Scale(value: \"a\"), t: Scale(value: \"p\")");
    assert_eq!((log.failed().as_str(), log.skipped().as_str(), log.ran().as_str()), ("p q", "t", "a s"));
    let text = log.failures();
    assert!(text.contains("no 1 here") && text.contains("no estimate"), "{text}");
    assert!(text.contains("a bug in lightharmony"), "{text}");
}

#[test]
fn notes_come_again_on_a_hit() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(value: 3), r: Remark(value: \"a\"), s: Scale(value: \"r\")";
    let (cold, warm) = (lab.run(nodes), lab.run(nodes));
    let expected = ["Count numbers: 1 number seen", "Warning odd-number: 3 is odd"];
    assert_eq!((cold.notes("r"), warm.notes("r")), (expected.map(String::from).into(), cold.notes("r")));
    assert_eq!((cold.exit_code(), warm.exit_code(), warm.ran().as_str()), (0, 0, ""));
}

#[test]
fn less_than_asked_for_passes_to_everything_below_and_to_the_exit_code() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(), r: Remark(value: \"a\", degraded: true), s: Scale(value: \"r\"), t: Add(terms: [\"s\", \"a\"]), u: Scale(value: \"a\")";
    for _ in 0..2 {
        let log = lab.run(nodes);
        let mut degraded: Vec<&str> = log
            .events
            .iter()
            .filter_map(|event| match event {
                Event::Node { id, degraded: true, .. } => Some(id.as_str()),
                _ => None,
            })
            .collect();
        degraded.sort_unstable();
        assert_eq!(degraded, ["r", "s", "t"]);
        assert_eq!((log.exit_code(), log.outcome.totals.degraded), (3, 3));
    }
    // `r` gives the same number either way, so nothing below it runs, yet it is not degraded any more.
    let log = lab.run(&nodes.replace("degraded: true", "degraded: false"));
    assert_eq!((log.ran().as_str(), log.exit_code()), ("r", 0));
}

#[test]
fn a_stopped_run_keeps_what_finished() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(), quick: Scale(value: \"a\"), slow: Slow(value: \"a\", millis: 120000), after: Scale(value: \"slow\", by: 7.0)";
    let start = Instant::now();
    let log = lab.run_until(&graph_text(nodes), &[], |event, cancel| {
        if matches!(event, Event::Node { id, state: State::Ran, .. } if id == "quick") {
            cancel.store(true, Ordering::Relaxed);
        }
    });
    assert!(start.elapsed() < Duration::from_secs(60), "it does not wait for the two minutes of `slow`");
    assert_eq!((log.ran().as_str(), log.skipped().as_str()), ("a quick", "after slow"));
    assert_eq!((log.exit_code(), log.outcome.totals.stopped), (130, true));
    let log = lab.run(&nodes.replace("120000", "20"));
    assert_eq!((log.cached().as_str(), log.ran().as_str()), ("a quick", "after slow"));
}

#[test]
fn a_node_that_ends_after_the_stop_without_noticing_is_kept() {
    let lab = Lab::on_disk();
    // `Heavy` never checks for a stop.
    let nodes = "a: Number(value: 5), h: Heavy(value: \"a\"), t: Scale(value: \"h\")";
    let log = lab.run_until(&graph_text(nodes), &[], |event, cancel| {
        if matches!(event, Event::Start { id, .. } if id == "h") {
            cancel.store(true, Ordering::Relaxed);
        }
    });
    assert_eq!((log.ran().as_str(), log.skipped().as_str(), log.exit_code()), ("a h", "t", 130));
    assert_eq!(lab.run(nodes).ran(), "t");
}

#[test]
fn a_run_stopped_before_it_starts_does_nothing() {
    let lab = Lab::on_disk();
    let engine = lab.engine();
    let graph = lab.parse(&graph_text("a: Number(), b: Scale(value: \"a\")")).unwrap();
    let options = engine::RunOptions::default();
    options.cancel.store(true, Ordering::Relaxed);
    let outcome = engine.run(&graph, &options, |_| {});
    assert_eq!((outcome.totals.skipped, outcome.totals.exit_code()), (2, 130));
}

#[test]
fn a_kind_that_gives_another_result_each_time_is_found_out() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(), d: Drift(value: \"a\"), s: Scale(value: \"d\")";
    assert_eq!(lab.run(nodes).ran(), "a d s");
    let log = lab.run(&nodes.replace("Scale(", "Scale(by: 3.0, "));
    assert_eq!((log.failed().as_str(), log.skipped().as_str(), log.exit_code()), ("d", "s", 1));
    assert!(log.failures().contains("gave a different result for the same inputs"), "{}", log.failures());
}

#[test]
fn a_file_that_changes_or_goes_is_an_error_at_its_path() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "1");
    let text = graph_text("a: LoadNumber(path: \"a.txt\"), s: Scale(value: \"a\")");
    let engine = lab.engine();
    let graph = lab.parse(&text).unwrap();
    std::fs::remove_file(lab.path("a.txt")).unwrap();
    let outcome = engine.run(&graph, &engine::RunOptions::default(), |_| {});
    let failures = outcome.failures.unwrap().render(false);
    assert!(failures.contains("graph.ron:2:21") && failures.contains("cannot read"), "{failures}");
    lab.write("a.txt", "many");
    let log = lab.run_text(&text);
    assert!(log.failures().contains("`many` is not a number"), "{}", log.failures());
}

#[test]
fn failures_are_reported_in_the_order_of_the_file() {
    let nodes: String = (0..40)
        .map(|n| format!("a{n}: Number(value: {n}), b{n}: Refuse(value: \"a{n}\", above: -1.0),\n"))
        .collect();
    let texts: Vec<String> = [1, 2, 4]
        .map(|jobs| {
            let mut lab = Lab::on_disk();
            lab.jobs = jobs;
            lab.run(&nodes).failures()
        })
        .into();
    assert!(texts.windows(2).all(|pair| pair[0] == pair[1]));
    assert_eq!(texts[0].matches("error:").count(), 40);
}
