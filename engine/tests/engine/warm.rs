//! Tests of repeated runs in one process: they visit only the nodes that a change affects, and give the same
//! results as a whole run.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use engine::{Engine, Event, Graph, Outcome, RunOptions, State, Store};

use crate::arithmetic::registry;
use crate::lab::{Lab, graph_text};

fn text() -> String {
    graph_text(
        "in: LoadNumber(path: \"a.txt\"), one: Number(value: 1.5), two: Number(value: 2.5),\n\
         sum: Add(terms: [\"one\", \"in\"], bias: 0.5), round: Round(value: \"sum\"), far: Scale(value: \"round\", by: 3.0),\n\
         says: Remark(value: \"two\", degraded: false), low: Scale(value: \"says\", by: 1.25),\n\
         no: Refuse(value: \"one\", above: 1.6), after: Scale(value: \"no\", by: 2.0), both: Add(terms: [\"far\", \"low\"], bias: 0.0),\n\
         w: WriteNumber(number: \"both\", path: \"w.txt\"), v: WriteNumber(number: \"low\", path: \"deep/v.txt\"),\n\
         x: WriteNumber(number: \"after\", path: \"x.txt\"),",
    )
}

/// The end state of each reported node.
type Ends = BTreeMap<String, String>;

fn run(engine: &Engine, graph: &Graph, out: &Path) -> (Ends, Outcome) {
    let options = RunOptions { out: out.to_owned(), ..RunOptions::default() };
    let mut ends = Ends::new();
    let outcome = engine.run(graph, &options, |event| {
        if let Event::Node { id, state, key, notes, degraded, error, .. } = event {
            let done = matches!(state, State::Ran | State::Cached);
            ends.insert(
                id,
                format!("{done} {state:?} {key:?} {notes:?} {degraded} {error:?}")
                    .replacen("Cached", "Ran", 1),
            );
        }
    });
    (ends, outcome)
}

/// The parts of an outcome that do not depend on the cache.
fn sums(outcome: &Outcome) -> (usize, [usize; 3], u8, String) {
    let totals = &outcome.totals;
    let failures = outcome.failures.as_ref().map(|failures| failures.render(false)).unwrap_or_default();
    let counts = [totals.failed, totals.skipped, totals.degraded];
    (totals.ran + totals.cached, counts, totals.exit_code(), failures)
}

fn names(ends: &Ends) -> String {
    ends.keys().map(String::as_str).collect::<Vec<_>>().join(" ")
}

#[test]
fn only_what_an_edit_reaches_is_reported_of() {
    let lab = Lab::in_memory();
    lab.write("a.txt", "3");
    let engine = Engine::new(Store::in_memory(), 2, 1 << 30).keeping();
    let out = lab.path("out");
    // Failed nodes are tried again each time.
    let text = text().replace("no: Refuse(value: \"one\", above: 1.6)", "no: Scale(value: \"one\", by: 1.0)");
    let graph = Arc::new(lab.parse(&text).unwrap());
    assert_eq!(run(&engine, &graph, &out).0.len(), 14);
    // Like an old file; a young one may have changed unseen, and its sink is checked.
    let settle = || {
        for path in [lab.path("a.txt"), out.join("w.txt"), out.join("deep/v.txt"), out.join("x.txt")] {
            let mut stamp = cache::FileStamp::of(&path).unwrap();
            stamp.taken_ns += 10_000_000_000;
            engine.store().memo_put(&path, &stamp, &engine::Digest::of(&std::fs::read(&path).unwrap()));
        }
    };
    settle();
    let (ends, outcome) = run(&engine, &graph, &out);
    assert_eq!((names(&ends).as_str(), outcome.totals.cached), ("", 14));
    let edited = |old: &str, new: &str| graph.reparse(text.replace(old, new), registry).unwrap();
    let (ends, outcome) = run(&engine, &edited("bias: 0.5", "bias: 0.625"), &out);
    assert_eq!(names(&ends), "both far round sum w", "what it stands above, although it came out equal");
    assert_eq!((outcome.totals.ran, outcome.totals.cached), (2, 12));
    let (ends, _) = run(&engine, &graph, &out);
    assert_eq!(names(&ends), "both far round sum w", "and back");
    std::fs::remove_file(out.join("x.txt")).unwrap();
    let (ends, _) = run(&engine, &graph, &out);
    assert_eq!(names(&ends), "x", "a file that is gone");
    assert!(out.join("x.txt").exists());
    settle();
    // Of another length: the clock of the file system may not have moved on.
    lab.write("a.txt", "4.25");
    let (ends, _) = run(&engine, &graph, &out);
    assert_eq!(names(&ends), "both far in round sum w", "a file that was read");
    settle();
    let other = lab.path("other");
    assert_eq!(names(&run(&engine, &graph, &other).0), "v w x", "another folder");
}

/// After each of many random edits, a run that keeps state gives the same results as a run with an empty cache.
#[test]
fn whatever_happens_it_is_what_a_whole_run_gives() {
    const EDITS: [(&str, [&str; 3]); 7] = [
        ("one: Number(value: ", ["1.5", "1.75", "-2.0"]),
        ("two: Number(value: ", ["2.5", "0.0", "4.5"]),
        ("bias: ", ["0.5", "0.625", "8.0"]),
        ("value: \"round\", by: ", ["3.0", "1.0", "0.5"]),
        ("degraded: ", ["false", "true", "false"]),
        ("value: \"says\", by: ", ["1.25", "2.5", "1.0"]),
        ("value: \"no\", by: ", ["2.0", "3.0", "4.0"]),
    ];
    let lab = Lab::in_memory();
    lab.write("a.txt", "3");
    let warm = Engine::new(Store::in_memory(), 2, 1 << 30).keeping();
    let (out, clean) = (lab.path("out"), lab.path("clean"));
    let mut graph = Arc::new(lab.parse(&text()).unwrap());
    let mut known = Ends::new();
    let mut state = 3_u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let mut untold = 0;
    for round in 0..250 {
        let text = graph.source.text.to_string();
        match random(10) {
            0 => lab.write("a.txt", ["3", "3.25", "many", "7"][random(4)]),
            1 => drop(std::fs::remove_file(out.join(["w.txt", "deep/v.txt", "x.txt"][random(3)]))),
            2 => lab.write("out/w.txt", "something else"),
            3 => graph = Arc::new(lab.parse(&text).unwrap()),
            _ => {
                let (field, values) = EDITS[random(EDITS.len())];
                let start = text.find(field).unwrap() + field.len();
                let end = start + text[start..].find([')', ',']).unwrap();
                let text = format!("{}{}{}", &text[..start], values[random(3)], &text[end..]);
                graph = graph.reparse(text, registry).unwrap();
            }
        }
        let (reported, outcome) = run(&warm, &graph, &out);
        untold += graph.nodes.len() - reported.len();
        known.extend(reported);
        let _ = std::fs::remove_dir_all(&clean);
        let (all, whole) = run(&Engine::new(Store::in_memory(), 2, 1 << 30), &graph, &clean);
        assert_eq!(known, all, "round {round}");
        assert_eq!(sums(&outcome), sums(&whole), "round {round}");
        for name in ["w.txt", "deep/v.txt", "x.txt"] {
            let read = |folder: &Path| std::fs::read_to_string(folder.join(name)).ok();
            if let Some(right) = read(&clean) {
                assert_eq!(read(&out), Some(right), "round {round}: {name}");
            }
        }
    }
    assert!(untold > 250, "much was left alone: {untold}");
}
