//! Tests of watching: a graph runs again when its files change. Every step waits for the event that ends it,
//! without a fixed delay.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use engine::{Event, Graph, Handle, Load, Refusal, Source, SourceRoot, State, Watch, WatchOptions};

use crate::lab::{Lab, graph_text};

/// A watch on another thread.
struct Session {
    lab: Lab,
    handle: Handle,
    events: Receiver<Event>,
    thread: Option<std::thread::JoinHandle<Vec<PathBuf>>>,
}

/// A time much longer than any step.
const LONG: Duration = Duration::from_secs(120);

impl Session {
    fn begin(lab: Lab, poll: bool) -> Self {
        let options = WatchOptions { out: lab.path("out"), poll, ..WatchOptions::default() };
        let watch = Watch::new(options);
        let (handle, (sender, events)) = (watch.handle(), channel());
        let engine = lab.engine().keeping();
        let (path, folder, registry) = (lab.path("graph.ron"), lab.path(""), crate::arithmetic::registry());
        let load = move |_: bool| {
            let graph = match std::fs::read_to_string(&path) {
                Err(error) => Err(Refusal::other(error.to_string())),
                Ok(text) => Graph::parse(Source::new("graph.ron", text), &registry, SourceRoot::new(&folder))
                    .map(|graph| (Arc::new(graph), Vec::new()))
                    .map_err(|mistakes| Refusal::mistakes(&mistakes, false)),
            };
            Load { graph, texts: vec![path.clone()] }
        };
        let run = move || watch.run(&engine, load, |event| drop(sender.send(event)));
        Self { lab, handle, events, thread: Some(std::thread::spawn(run)) }
    }

    /// A session with a graph of these nodes, and the file `five.txt` that they may read.
    fn of(nodes: &str) -> Self {
        let lab = Lab::on_disk();
        lab.write("five.txt", "5");
        lab.write("graph.ron", &graph_text(nodes));
        Self::begin(lab, false)
    }

    fn save(&self, nodes: &str) {
        self.lab.write("graph.ron", &graph_text(nodes));
    }

    /// Returns all events up to and including the first for which `found` is true.
    fn until(&self, found: impl Fn(&Event) -> bool) -> Vec<Event> {
        let mut events = Vec::new();
        loop {
            match self.events.recv_timeout(LONG) {
                Ok(event) => events.push(event),
                Err(RecvTimeoutError::Timeout) => panic!("timed out after {events:#?}"),
                Err(RecvTimeoutError::Disconnected) => panic!("it ended after {events:#?}"),
            }
            if events.last().is_some_and(&found) {
                return events;
            }
        }
    }

    /// Returns all events until the watch is idle, including the event that reports this.
    fn rest(&self) -> Vec<Event> {
        self.until(|event| matches!(event, Event::Idle { .. }))
    }

    fn quit(&mut self) -> Vec<PathBuf> {
        self.handle.quit();
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        self.handle.quit();
    }
}

fn ran(events: &[Event]) -> Vec<&str> {
    let mut ids: Vec<&str> = events
        .iter()
        .filter_map(|event| match event {
            Event::Node { id, state: State::Ran, .. } => Some(id.as_str()),
            _ => None,
        })
        .collect();
    ids.sort_unstable();
    ids
}

fn stale(events: &[Event]) -> usize {
    events.iter().filter(|event| matches!(event, Event::Stale { .. })).count()
}

fn mistakes(events: &[Event]) -> Vec<String> {
    let text = |event: &Event| match event {
        Event::Mistakes { text, .. } => Some(text.clone()),
        _ => None,
    };
    events.iter().filter_map(text).collect()
}

const SUM: &str = r#"five: LoadNumber(path: "five.txt"), one: Number(value: 1.0),
    sum: Add(terms: ["five", "one"]), save: WriteNumber(number: "sum", path: "sum.txt"),"#;

#[test]
fn an_edit_reruns_what_it_touches_and_a_comment_nothing() {
    let mut watch = Session::of(SUM);
    let first = watch.rest();
    assert_eq!(ran(&first), ["five", "one", "save", "sum"]);
    let planned = |event: &Event| matches!(event, Event::Plan(plan) if plan.open == 4 && plan.wanted == 4);
    assert!(first.iter().any(planned), "{first:?}");
    assert!(matches!(first.last(), Some(Event::Idle { files: 2 })), "the graph and what it reads");
    assert_eq!(watch.lab.out("sum.txt"), "6.0\n");
    // A comment is an edit without effect, so the next event is of the edit after it.
    watch.save(&format!("// nothing\n{SUM}"));
    std::thread::sleep(Duration::from_millis(100));
    watch.save(&SUM.replace("1.0", "2.0"));
    let second = watch.rest();
    assert_eq!(ran(&second), ["one", "save", "sum"]);
    assert_eq!(watch.lab.out("sum.txt"), "7.0\n");
    // A file that a node reads.
    watch.lab.write("five.txt", "50");
    assert_eq!(ran(&watch.rest()), ["five", "save", "sum"]);
    assert_eq!(watch.lab.out("sum.txt"), "52.0\n");
    assert!(watch.quit().is_empty(), "every file shows what the graph says");
}

#[test]
fn a_wrong_graph_is_reported_and_the_picture_stays_until_it_is_right_again() {
    let mut watch = Session::of(SUM);
    watch.rest();
    watch.save(&SUM.replace("Add(", "Ad("));
    let wrong = watch.rest();
    assert!(mistakes(&wrong)[0].contains("no kind of node is named `Ad`"), "{wrong:?}");
    assert!(
        wrong.iter().any(|event| matches!(event, Event::Mistakes { list, .. } if list[0].line == 3)),
        "with its place, for programs"
    );
    assert_eq!((stale(&wrong), ran(&wrong).len()), (1, 0));
    assert_eq!(watch.lab.out("sum.txt"), "6.0\n", "the last good one stays");
    watch.save(SUM);
    let right = watch.rest();
    assert_eq!((ran(&right).len(), mistakes(&right).len()), (0, 0), "{right:?}");
    assert!(right.iter().any(|event| matches!(event, Event::File { preview: false, .. })), "no longer stale");
    // Half of a graph, as left by an editor that truncates first.
    watch.lab.write("graph.ron", "");
    assert!(!mistakes(&watch.rest()).is_empty());
    // Without a graph, with the graph back.
    std::fs::remove_file(watch.lab.path("graph.ron")).unwrap();
    let gone = watch.rest();
    assert!(!mistakes(&gone).is_empty());
    assert_eq!(stale(&gone), 0, "it was reported before");
    assert_eq!(watch.quit(), [watch.lab.path("out/sum.txt")], "stale files are listed at the end");
}

#[test]
fn a_file_that_is_missing_is_waited_for() {
    let lab = Lab::on_disk();
    lab.write("graph.ron", &graph_text(SUM));
    let watch = Session::begin(lab, false);
    assert!(mistakes(&watch.rest())[0].contains("`five.txt` does not exist"));
    watch.lab.write("five.txt", "5");
    assert_eq!(ran(&watch.rest()), ["five", "one", "save", "sum"]);
    std::fs::remove_file(watch.lab.path("five.txt")).unwrap();
    let gone = watch.rest();
    assert_eq!((mistakes(&gone).len(), stale(&gone)), (1, 1));
    watch.lab.write("five.txt", "5");
    let back = watch.rest();
    assert_eq!((ran(&back).len(), mistakes(&back).len()), (0, 0), "its content is known");
    // A file with wrong content fails its node, and its repair is a change like any other.
    watch.lab.write("five.txt", "five");
    let failed = watch.rest();
    assert_eq!((mistakes(&failed).len(), stale(&failed)), (1, 1), "{failed:?}");
    watch.lab.write("five.txt", "6");
    assert_eq!(ran(&watch.rest()), ["five", "save", "sum"]);
    assert_eq!(watch.lab.out("sum.txt"), "7.0\n");
}

#[test]
fn a_newer_edit_stops_the_run_and_keeps_what_it_finished() {
    let slow = r#"one: Number, slow: Slow(value: "one", millis: 60000), quick: Add(terms: ["one"], bias: 1.0),
        a: WriteNumber(number: "quick", path: "a.txt"), b: WriteNumber(number: "slow", path: "b.txt"),"#;
    let watch = Session::of(slow);
    let starts = |event: &Event| matches!(event, Event::Start { id, .. } if id == "slow");
    let before = watch.until(|event| matches!(event, Event::File { id, .. } if id == "a"));
    if !before.iter().any(starts) {
        watch.until(starts);
    }
    watch.save(&slow.replace("60000", "1"));
    let events = watch.rest();
    let stopped = events.iter().any(|event| matches!(event, Event::Done(totals) if totals.stopped));
    assert!(stopped, "{events:#?}");
    let anew = events.iter().position(|event| matches!(event, Event::Plan(_))).unwrap();
    assert_eq!(ran(&events[anew..]), ["b", "slow"]);
    assert_eq!(stale(&events), 0, "nothing was wrong");
}

#[test]
fn rough_passes_come_first_and_the_last_one_pays_only_the_rest() {
    let series = r#"one: Number, series: Series(value: "one", samples: 100),
        save: WriteNumber(number: "series", path: "s.txt"), note: WriteNumber(number: "one", path: "n.txt"),"#;
    let watch = Session::of(series);
    let events = watch.rest();
    let passes: Vec<(u64, u64)> = events
        .iter()
        .filter_map(|event| match event {
            Event::Pass { level, of: 100, coarse, .. } => Some((*level, *coarse)),
            _ => None,
        })
        .collect();
    assert_eq!(passes, [(1, 4), (1, 1), (4, 1), (16, 1), (64, 1)]);
    let shown: Vec<(&str, bool)> = events
        .iter()
        .filter_map(|event| match event {
            Event::File { id, preview, .. } => Some((id.as_str(), *preview)),
            _ => None,
        })
        .collect();
    let of = |wanted: &str| shown.iter().filter(|(id, _)| *id == wanted).map(|(_, p)| *p).collect::<Vec<_>>();
    assert_eq!(of("save"), [true, true, true, true, true, false]);
    assert_eq!(of("note"), [false; 6], "it does not depend on what is rough");
    // The same bytes as in one pass, and the plan ignores the rough ones.
    let last = watch.lab.out("s.txt");
    let at_once = Lab::on_disk();
    at_once.run(series);
    assert_eq!(last, at_once.out("s.txt"));
    let graph = watch.lab.parse(&graph_text(series)).unwrap();
    let engine = watch.lab.engine();
    assert!(engine.plan(&graph, &[]).iter().all(|node| node.fate == engine::Fate::Known));
    let parts = |state: State| {
        let of = |event: &&Event| matches!(event, Event::Part { state: s, .. } if *s == state);
        events.iter().filter(of).count()
    };
    assert!(parts(State::Ran) > 0 && parts(State::Cached) > 0, "later passes build on earlier ones");
}

#[test]
fn a_preview_caps_what_kinds_say_and_the_picture_does_not() {
    let lab = Lab::in_memory();
    let nodes = r#"one: Number, m: Series(value: "one", samples: 40), r: Ramp(value: "m", count: 5), s: Sum(numbers: "r", times: 3),
        other: Ramp(value: "one", count: 5), apart: Sum(numbers: "other", times: 3)"#;
    let graph = lab.parse(&graph_text(nodes)).unwrap();
    let of = |graph: &Graph| {
        ["m", "m", "s", "apart"]
            .into_iter()
            .zip(["samples", "coarse", "times", "times"])
            .map(|(node, name)| graph.number(graph.find(node).unwrap(), name).unwrap())
            .collect::<Vec<_>>()
    };
    let [m, s] = ["m", "s"].map(|name| graph.find(name).unwrap());
    let (rough, changed) = graph.rough("samples", 4, 1).unwrap();
    assert_eq!((changed, of(&rough)), (vec![m, s], vec![4, 1, 1, 3]));
    assert_eq!(of(&graph), [40, 1, 3, 3], "the graph itself stays");
    let (coarse, changed) = graph.rough("samples", 40, 2).unwrap();
    assert_eq!((changed, of(&coarse)), (vec![m, s], vec![40, 2, 1, 3]));
    assert!(graph.rough("samples", 40, 1).is_none(), "where nothing is refined, nothing is rough");
}

#[test]
fn looking_finds_what_listening_would() {
    let lab = Lab::on_disk();
    lab.write("five.txt", "5");
    lab.write("graph.ron", &graph_text(SUM));
    let watch = Session::begin(lab, true);
    let first = watch.rest();
    assert!(matches!(&first[0], Event::Warning { id: "watch-polls", .. }), "{first:?}");
    watch.save(&SUM.replace("1.0", "2.5"));
    assert_eq!(ran(&watch.rest()), ["one", "save", "sum"]);
}

/// The clock jumps, several saves fall within one tick of it, and files are half-written. The final output still
/// equals the output of an ordinary run on the final files.
#[test]
fn clocks_that_jump_and_half_files_end_as_a_plain_run() {
    let watch = Session::of(SUM);
    watch.rest();
    let file = watch.lab.path("five.txt");
    let at = |seconds| std::time::UNIX_EPOCH + Duration::from_secs(seconds);
    for round in 0..20 {
        let (past, future) = (at(round), at(4_000_000_000 + round));
        for (text, clock) in [("6", past), ("7", future), ("-", past), ("", past), ("8", past), ("2", past)] {
            std::fs::write(&file, text).unwrap();
            std::fs::File::options().write(true).open(&file).unwrap().set_modified(clock).unwrap();
        }
        let whole = graph_text(&SUM.replace("1.0", &format!("{round}.5")));
        watch.lab.write("graph.ron", &whole[..whole.len() / 2]);
        watch.lab.write("graph.ron", &whole);
    }
    while watch.lab.out("sum.txt") != "21.5\n" {
        watch.rest();
    }
    let plain = Lab::in_memory();
    plain.write("five.txt", "2");
    plain.run(&SUM.replace("1.0", "19.5"));
    assert_eq!(plain.out("sum.txt"), "21.5\n");
}

#[test]
fn a_storm_of_saves_ends_as_the_last_one_says() {
    let watch = Session::of(SUM);
    watch.rest();
    for step in 0..200 {
        watch.save(&SUM.replace("1.0", &format!("{step}.5")));
        watch.handle.hint(Vec::new());
    }
    let mut runs = 0;
    loop {
        runs += watch.rest().iter().filter(|event| matches!(event, Event::Done(_))).count();
        if watch.lab.out("sum.txt") == "204.5\n" {
            break;
        }
    }
    assert!(runs <= 200, "no more than there were edits");
}

#[test]
fn values_stay_in_memory_between_runs() {
    // Only the digest of a loaded number is kept in the store, so without memory it would be made again.
    let watch = Session::of(SUM);
    watch.rest();
    watch.save(&SUM.replace("1.0", "3.0"));
    let events = watch.rest();
    assert_eq!(ran(&events), ["one", "save", "sum"]);
    assert!(!events.iter().any(|event| matches!(event, Event::Remake { .. })), "{events:?}");
}

#[test]
fn saved_once_more_it_is_tried_once_more() {
    let nodes = r#"one: Number, save: WriteNumber(number: "one", path: "s.txt"),"#;
    let watch = Session::of(nodes);
    watch.rest();
    let shown = watch.lab.out("s.txt");
    watch.save(nodes);
    watch.until(|event| matches!(event, Event::Same));
    // Removed files come back.
    std::fs::remove_file(watch.lab.path("out/s.txt")).unwrap();
    watch.save(nodes);
    watch.rest();
    assert_eq!(watch.lab.out("s.txt"), shown);
    // And failed nodes, once nothing blocks them.
    std::fs::remove_dir_all(watch.lab.path("out")).unwrap();
    watch.lab.write("out", "in the way");
    watch.save(nodes);
    assert_eq!(mistakes(&watch.rest()).len(), 1);
    std::fs::remove_file(watch.lab.path("out")).unwrap();
    watch.save(nodes);
    watch.rest();
    assert_eq!(watch.lab.out("s.txt"), shown);
}

// This test fails if `is_file_gone` always returns false.
#[test]
fn a_deleted_file_comes_back_without_a_save() {
    let watch = Session::of(SUM);
    watch.rest();
    std::fs::remove_file(watch.lab.path("out/sum.txt")).unwrap();
    let events = watch.rest();
    assert_eq!(watch.lab.out("sum.txt"), "6.0\n");
    assert!(ran(&events).iter().all(|id| *id == "save"), "nothing above it runs: {events:?}");
}
