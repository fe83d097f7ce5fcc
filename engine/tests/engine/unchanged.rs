//! Tests of runs without changes: a run that finds everything unchanged reports the same as an ordinary run, and
//! after any change an ordinary run takes place.

use std::fs;
use std::path::Path;

use engine::{Digest, Event, KindEntry, Outcome, Registry, Source, SourceRoot, run_unchanged};

use crate::arithmetic::{LoadNumber, Scale, registry_with};
use crate::lab::{Lab, Log, graph_text};

fn text() -> String {
    graph_text(
        "in: LoadNumber(path: \"a.txt\"), says: Remark(value: \"in\", degraded: true), twice: Scale(value: \"in\", by: 2.0), \
         save: WriteNumber(number: \"says\", path: \"save.txt\"), also: WriteNumber(number: \"twice\", path: \"deep/also.txt\"),",
    )
}

/// Makes the store treat these files as old enough for their remembered digests to be valid.
fn settle(lab: &Lab, names: &[&str]) {
    let engine = lab.engine();
    for path in names.iter().map(|name| lab.path(name)) {
        let mut stamp = cache::FileStamp::of(&path).unwrap();
        stamp.taken_ns += 10_000_000_000;
        engine.store().memo_put(&path, &stamp, &Digest::of(&fs::read(&path).unwrap()));
    }
    engine.store().flush().unwrap();
}

/// A lab with a graph that has run twice. In the second run, no node had to run.
fn ready() -> (Lab, Log) {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    assert_eq!(lab.run_text(&text()).outcome.totals.ran, 5);
    settle(&lab, &["a.txt", "out/save.txt", "out/deep/also.txt"]);
    let log = lab.run_text(&text());
    assert_eq!(log.outcome.totals.cached, 5);
    (lab, log)
}

fn again(lab: &Lab, text: &str, registry: &Registry, out: &str) -> Option<(Vec<Event>, Outcome)> {
    let (source, root) = (Source::new("graph.ron", text), SourceRoot::new(lab.folder.path()));
    let mut events = Vec::new();
    let outcome =
        run_unchanged(&lab.cache(), &source, registry, &root, &lab.path(out), |event| events.push(event));
    outcome.map(|outcome| (events, outcome))
}

fn is_unchanged(lab: &Lab) -> bool {
    again(lab, &text(), &lab.registry, "out").is_some()
}

/// The events, sorted and without times.
fn reported(events: &[Event]) -> Vec<String> {
    let line = |event: &Event| match event {
        Event::Done(totals) => {
            format!("{:?}", engine::Totals { seconds: 0.0, cpu_seconds: 0.0, ..totals.clone() })
        }
        event => format!("{event:?}"),
    };
    let mut lines: Vec<String> = events.iter().map(line).collect();
    lines.sort();
    lines
}

#[test]
fn tells_what_an_ordinary_run_reports() {
    let (lab, log) = ready();
    let (events, outcome) = again(&lab, &text(), &lab.registry, "out").unwrap();
    assert_eq!(reported(&events), reported(&log.events));
    assert_eq!((outcome.totals.exit_code(), log.exit_code()), (3, 3), "degraded, each time");
    // Nodes above come first, and a file directly before its node.
    let place = |wanted: &str| {
        let is = |event: &Event| matches!(event, Event::Node { id, .. } if id == wanted);
        events.iter().position(is).unwrap()
    };
    assert!(place("in") < place("says") && place("says") < place("save"));
    assert!(matches!(&events[place("save") - 1], Event::File { id, written: false, .. } if id == "save"));
    assert!(is_unchanged(&lab), "asking takes nothing away");
}

#[test]
fn whatever_changed_makes_it_an_ordinary_run() {
    let rewrite = |name: &'static str, text: &'static str| move |lab: &Lab| lab.write(name, text);
    let remove = |name: &'static str| move |lab: &Lab| fs::remove_file(lab.path(name)).unwrap();
    type Change = Box<dyn Fn(&Lab)>;
    let changes: [(&str, Change); 7] = [
        ("a source", Box::new(rewrite("a.txt", "4.25"))),
        ("a source that is gone", Box::new(remove("a.txt"))),
        ("a file that is gone", Box::new(remove("out/deep/also.txt"))),
        ("a file that says something else", Box::new(rewrite("out/save.txt", "something of another length"))),
        (
            "a file of equal content, but another one",
            Box::new(|lab: &Lab| {
                fs::copy(lab.path("out/save.txt"), lab.path("copy")).unwrap();
                fs::rename(lab.path("copy"), lab.path("out/save.txt")).unwrap();
            }),
        ),
        (
            "a collection",
            Box::new(|lab: &Lab| {
                let limits = cache::Limits { max_size: Some(0), ..cache::Limits::default() };
                lab.engine().store().collect(&limits, &engine::blobs_of, std::time::Duration::ZERO).unwrap();
            }),
        ),
        (
            "a text that says the same",
            Box::new(|lab: &Lab| {
                assert!(again(lab, &text().replace("twice:", "twice :"), &lab.registry, "out").is_none());
                lab.run_text(&text().replace("twice:", "twice :"));
            }),
        ),
    ];
    for (what, change) in changes {
        let (lab, _) = ready();
        assert!(is_unchanged(&lab));
        change(&lab);
        assert!(!is_unchanged(&lab), "{what}");
    }
    let (lab, _) = ready();
    assert!(again(&lab, &text(), &lab.registry, "other").is_none(), "another folder");
    let mut newer = KindEntry::of::<Scale>();
    newer.version += 1;
    assert!(again(&lab, &text(), &registry_with(newer), "out").is_none(), "a kind of another version");
    let mut weights = KindEntry::of::<LoadNumber>();
    weights.data = b"trained again";
    assert!(again(&lab, &text(), &registry_with(weights), "out").is_none(), "other data in a kind");
    let source = Source::new("graph.ron", text());
    let root = SourceRoot::confined(lab.folder.path(), &[]).unwrap();
    let out = lab.path("out");
    assert!(
        run_unchanged(&lab.cache(), &source, &lab.registry, &root, &out, |_| {}).is_none(),
        "an untrusted graph"
    );
    assert!(is_unchanged(&lab));
}

#[test]
fn what_may_change_unseen_is_not_kept() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    for names in [&[][..], &["a.txt"], &["out/save.txt"]] {
        lab.run_text(&text());
        settle(&lab, names);
        assert!(!is_unchanged(&lab), "files are too young");
    }
    settle(&lab, &["out/deep/also.txt"]);
    lab.run_only(&text(), &["also"]);
    assert!(!is_unchanged(&lab), "only a part was asked for");
    lab.run_text(&text());
    assert!(is_unchanged(&lab));
}

#[test]
fn damage_makes_it_an_ordinary_run() {
    let (lab, _) = ready();
    let last = lab.cache().join("v1/last");
    let is_ours = |path: &Path| {
        let good = fs::read(path).unwrap();
        fs::write(path, b"").unwrap();
        let ours = !is_unchanged(&lab);
        fs::write(path, &good).unwrap();
        ours
    };
    let files: Vec<_> = fs::read_dir(last).unwrap().map(|entry| entry.unwrap().path()).collect();
    let [path] = &files.into_iter().filter(|path| is_ours(path)).collect::<Vec<_>>()[..] else {
        panic!("one file")
    };
    let good = fs::read(path).unwrap();
    for at in 0..good.len() {
        let mut bad = good.clone();
        bad[at] ^= 0x10;
        fs::write(path, &bad).unwrap();
        assert!(!is_unchanged(&lab), "byte {at}");
        fs::write(path, &good[..at]).unwrap();
        assert!(!is_unchanged(&lab), "cut at {at}");
    }
    assert_eq!(lab.run_text(&text()).outcome.totals.cached, 5);
    assert!(is_unchanged(&lab), "written again");
}
