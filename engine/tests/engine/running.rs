//! Tests of runs: parts, sinks, wanted nodes, memory, threads, stores and other processes.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use cache::{LeaseState, Options, Store};
use engine::{Engine, Event};

use crate::arithmetic::{HEAVY, MADE};
use crate::lab::{Lab, Log, graph_text};

#[test]
fn more_samples_compute_only_new_parts() {
    for lab in [Lab::on_disk(), Lab::in_memory()] {
        let nodes =
            "a: Number(), s: Series(value: \"a\", samples: 64), w: WriteNumber(number: \"s\", path: \"s\")";
        let more = nodes.replace("64", "256");
        assert_eq!(lab.run(nodes).parts(), (4, 0));
        let log = lab.run(&more);
        assert_eq!((log.parts(), log.outcome.totals.counts["samples"]), ((12, 4), 192));
        let grown = lab.out("s");
        assert_eq!((Lab::on_disk().run(&more).parts(), lab.run(&more).parts()), ((16, 0), (0, 0)));
        // A parameter that no part names changes none of them.
        assert_eq!(lab.run(&more.replace("samples", "gain: 2.0, samples")).parts(), (0, 16));
        assert_eq!(lab.run(&more.replace("Number()", "Number(value: 2)")).parts(), (16, 0));
        let fresh = Lab::on_disk();
        fresh.run(&more);
        assert_eq!(fresh.out("s"), grown, "64 and then 256 equals 256");
    }
}

/// A part that is kept in memory is computed only once for equal inputs. This test fails if `StoredParts::keep`
/// does nothing, or if the key of a part does not contain the digests of the inputs.
#[test]
fn what_stays_in_memory_is_made_once_for_equal_inputs() {
    let lab = Lab { jobs: 1, ..Lab::on_disk() };
    let node = |id: &str, of: &str, plus: u32| format!("{id}: Prepared(value: \"{of}\", plus: {plus}),");
    let numbers = "a: Number(value: 271828), b: Number(value: 314159),";
    let all = [node("p", "a", 1), node("q", "a", 2), node("r", "b", 3)].concat();
    let sum = "t: Add(terms: [\"p\", \"q\", \"r\"]), w: WriteNumber(number: \"t\", path: \"t\")";
    // One after the other, since nodes that run at once each make their own.
    lab.run(&format!("{numbers}{all}{sum}"));
    let made = MADE.lock().unwrap();
    let times = |number: f64| made.iter().filter(|made| **made == number).count();
    assert_eq!((times(271_828.0), times(314_159.0)), (1, 1));
    assert_eq!(lab.out("t").trim().parse(), Ok(2.0 * 271_828.0 + 314_159.0 + 6.0));
}

#[test]
fn what_a_node_took_does_not_depend_on_what_was_known() {
    let lab = Lab::on_disk();
    let nodes = |samples: u32| format!("a: Number(), s: Series(value: \"a\", samples: {samples})");
    lab.run(&nodes(64));
    assert_eq!(lab.run(&nodes(256)).outcome.totals.counts["samples"], 192);
    let graph = lab.parse(&graph_text(&nodes(256))).unwrap();
    let counts = lab.engine().spent(&graph, 1).unwrap().counts;
    assert_eq!(counts["samples"], 256);
    assert_eq!((counts["bytes_read"], counts["bytes_made"]), (8, 8), "those of the node, not of its parts");
}

#[test]
fn bytes_are_those_of_inputs_files_and_outputs() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "4.25\n");
    let nodes = "a: LoadNumber(path: \"a.txt\"), sum: Add(terms: [\"a\", \"a\", \"a\"])";
    let counts = &lab.run(nodes).outcome.totals.counts;
    assert_eq!((counts["bytes_read"], counts["bytes_made"]), (5 + 3 * 8, 8 + 8));
}

#[test]
fn files_are_kept_equal_without_running_nodes() {
    let lab = Lab::on_disk();
    let nodes =
        "a: Number(value: 3), s: Scale(value: \"a\"), w: WriteNumber(number: \"s\", path: \"deep/w.txt\")";
    assert_eq!(lab.run(nodes).files(), "w.txt*");
    let file = lab.path("out/deep/w.txt");
    let before = std::fs::metadata(&file).unwrap().modified().unwrap();
    let log = lab.run(nodes);
    assert_eq!((log.files().as_str(), log.ran().as_str()), ("w.txt", ""));
    assert_eq!(std::fs::metadata(&file).unwrap().modified().unwrap(), before);
    std::fs::remove_file(&file).unwrap();
    let log = lab.run(nodes);
    assert_eq!((log.files().as_str(), log.ran().as_str(), log.remade().as_str()), ("w.txt*", "", ""));
    std::fs::write(&file, "6.1\n").unwrap();
    assert_eq!(lab.run(nodes).files(), "w.txt*");
    assert_eq!(lab.out("deep/w.txt"), "6.0\n");
    // Another file name does not make a new result.
    let log = lab.run(&nodes.replace("w.txt", "v.txt"));
    assert_eq!((log.files().as_str(), log.ran().as_str()), ("v.txt*", ""));
    let log = lab.run(&nodes.replace("w.txt", "w.csv"));
    assert_eq!((log.files().as_str(), log.ran().as_str()), ("w.csv*", "w"), "the ending names the format");
}

#[test]
fn files_come_before_the_end_of_their_node() {
    let lab = Lab::on_disk();
    for _ in 0..2 {
        let log = lab.run("a: Number(), w: WriteNumber(number: \"a\", path: \"w\")");
        let file = log.events.iter().position(|event| matches!(event, Event::File { .. }));
        let end = log.events.iter().position(|event| matches!(event, Event::Node { id, .. } if id == "w"));
        assert!(file.is_some() && file < end);
    }
}

#[test]
fn many_views_need_a_place_in_the_path() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(), b: Number(value: 2), w: WriteNumber(number: [\"a\", \"b\"], each: true, views: [\"left\"], path: \"w_{view}.txt\")";
    assert_eq!(lab.run(nodes).files(), "w_b.txt* w_left.txt*");
    assert_eq!((lab.out("w_left.txt"), lab.out("w_b.txt")), ("1.0\n".into(), "2.0\n".into()));
    std::fs::remove_file(lab.path("out/w_b.txt")).unwrap();
    assert_eq!(lab.run(nodes).files(), "w_b.txt* w_left.txt");
    let log = lab.run(&nodes.replace("_{view}", ""));
    assert_eq!((log.failed().as_str(), log.files().as_str()), ("w", ""));
    let text = log.failures();
    assert!(
        text.contains("names one file, but the sink writes one file for each view: left, b")
            && text.contains("put `{view}`"),
        "{text}"
    );
    assert!(text.contains("\"w.txt\""), "the path is underlined: {text}");
}

#[test]
fn views_cannot_lead_out_of_the_folder_nor_onto_each_other() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(), w: WriteNumber(number: [\"a\"], each: true, views: [\"..\"], path: \"in/{view}/w.txt\")";
    let log = lab.run(nodes);
    assert_eq!((log.files().as_str(), log.exit_code()), ("w.txt*", 0));
    assert!(!lab.path("out/w.txt").exists() && lab.path("out/in/__/w.txt").exists());
    let two = "a: Number(), b: Number(value: 2), w: WriteNumber(number: [\"a\", \"b\"], each: true, views: [\"x/y\", \"x_y\"], path: \"{view}.txt\")";
    let log = lab.run(two);
    assert!(log.failures().contains("`x/y` and `x_y` give the same file name"), "{}", log.failures());
    let sinks = "a: Number(), v: WriteNumber(number: \"a\", each: true, path: \"w_{view}.txt\"), w: WriteNumber(number: \"a\", path: \"w_a.txt\")";
    let log = lab.run(sinks);
    assert_eq!(log.exit_code(), 1);
    assert!(log.failures().contains("`w` failed: `v` also writes to "), "{}", log.failures());
}

#[test]
fn a_file_that_cannot_be_written_fails_its_sink() {
    let lab = Lab::on_disk();
    let nodes = "a: Number(), w: WriteNumber(number: \"a\", path: \"in/the/way.txt\"), v: WriteNumber(number: \"a\", path: \"ok.txt\")";
    std::fs::create_dir_all(lab.path("out")).unwrap();
    std::fs::write(lab.path("out/in"), "a file").unwrap();
    for _ in 0..2 {
        let log = lab.run(nodes);
        assert_eq!((log.failed().as_str(), log.files().trim_end_matches('*')), ("w", "ok.txt"));
        assert!(log.failures().contains("in/the"), "{}", log.failures());
    }
    std::fs::remove_file(lab.path("out/in")).unwrap();
    let log = lab.run(nodes);
    assert_eq!((log.ran().as_str(), log.files().as_str()), ("", "ok.txt way.txt*"));
}

#[test]
fn only_what_is_named_runs() {
    let lab = Lab::on_disk();
    let text = graph_text(
        "a: Number(), s: Scale(value: \"a\"), t: Scale(value: \"a\", by: 3.0), v: WriteNumber(number: \"s\", path: \"v\"), w: WriteNumber(number: \"t\", path: \"w\")",
    );
    let log = lab.run_only(&text, &["s"]);
    assert_eq!((log.ran().as_str(), log.files().as_str()), ("a s", ""));
    let log = lab.run_only(&text, &["w", "t"]);
    assert_eq!((log.ran().as_str(), log.files().as_str()), ("t w", "w*"));
    assert_eq!(lab.run_text(&text).ran(), "v");
    // Without sinks, nodes that no other node reads are wanted.
    assert_eq!(
        Lab::on_disk().run("a: Number(), s: Scale(value: \"a\"), t: Scale(value: \"a\", by: 3.0)").ran(),
        "a s t"
    );
}

#[test]
fn one_key_is_computed_once() {
    for lab in [Lab::on_disk(), Lab::in_memory()] {
        let nodes: String = (0..20)
            .map(|n| {
                format!("a{n}: Number(value: 4), s{n}: Slow(value: \"a{n}\"), t{n}: Scale(value: \"s{n}\"),")
            })
            .collect();
        let log = lab.run(&nodes);
        let totals = &log.outcome.totals;
        assert_eq!((totals.ran, totals.cached), (3, 57));
    }
    // Nor twice if nothing can be kept, whether the second starts while the first runs or later.
    let mut lab = Lab::on_disk();
    lab.run("a: Number()");
    lab.options.read_only = true;
    let log = lab.run(
        "x: Number(value: 5), y: Number(value: 5), first: Scale(value: \"x\"), slow: Slow(value: \"y\"), \
         late: Scale(value: \"slow\"), both: Add(terms: [\"first\", \"late\"])",
    );
    assert_eq!((log.outcome.totals.ran, log.outcome.totals.cached), (4, 2));
}

#[test]
fn what_needs_more_memory_than_there_is_never_starts() {
    let mut lab = Lab::on_disk();
    lab.budget = 100 << 20;
    let log = lab.run("a: Number(), h: Heavy(value: \"a\", megabytes: 4000000), s: Scale(value: \"h\")");
    assert_eq!((log.failed().as_str(), log.skipped().as_str()), ("h", "s"));
    assert!(!log.events.iter().any(|event| matches!(event, Event::Start { id, .. } if id == "h")));
    let text = log.failures();
    assert!(text.contains("needs about 3906.2 GiB of memory, but the budget is 100.0 MiB"), "{text}");
}

#[test]
fn two_that_do_not_fit_together_run_one_after_the_other() {
    let mut lab = Lab::on_disk();
    lab.jobs = 4;
    lab.budget = 100 << 20;
    let nodes: String = (0..4)
        .map(|n| format!("a{n}: Number(value: {n}), h{n}: Heavy(value: \"a{n}\", megabytes: 60),"))
        .collect();
    assert_eq!(lab.run(&nodes).outcome.totals.ran, 8);
    assert_eq!(HEAVY.1.swap(0, Ordering::SeqCst), 1);
    lab.budget = 1000 << 20;
    // On a busy machine a thread may come too late to meet another one, but not every time.
    let together = (1..50).any(|time| {
        // Other nodes than before, since those are in the cache.
        let others = nodes.replace("Number(value: ", &format!("Number(value: {time}"));
        assert_eq!(lab.run(&others).outcome.totals.ran, 8);
        HEAVY.1.load(Ordering::SeqCst) > 1
    });
    assert!(together, "with enough memory they run concurrently");
}

#[test]
fn a_run_holds_about_what_its_budget_allows() {
    // A warm cache of 40 lists of 8 MB, and then a change below all of them: they come one by one.
    let mut lab = Lab::on_disk();
    let nodes: String = (0..40)
        .map(|n| format!("a{n}: Number(value: {n}), r{n}: Ramp(value: \"a{n}\", count: 100000), s{n}: Sum(numbers: \"r{n}\"), t{n}: Scale(value: \"s{n}\"),"))
        .collect();
    lab.run(&nodes);
    lab.budget = 3 << 20;
    let mut sum = engine::KindEntry::of::<crate::arithmetic::Sum>();
    sum.version += 1;
    lab.registry = crate::arithmetic::registry_with(sum);
    let log = lab.run(&nodes);
    assert_eq!((log.outcome.totals.ran, log.remade()), (40, String::new()));
    let peak = log.outcome.totals.peak_bytes;
    assert!(peak <= 6 << 20, "held {peak} bytes");
}

#[test]
fn another_engine_on_the_same_cache_computes_nothing_twice() {
    let lab = Lab::on_disk();
    let nodes: String = (0..12)
        .map(|n| format!("a{n}: Number(value: {n}), s{n}: Slow(value: \"a{n}\", millis: 30), t{n}: Scale(value: \"s{n}\"),"))
        .collect();
    let text = graph_text(&nodes);
    let run = || lab.run_on(&lab.engine(), &text, &[], |_, _| {});
    let logs = std::thread::scope(|scope| {
        [scope.spawn(run), scope.spawn(run), scope.spawn(run)].map(|thread| thread.join().unwrap())
    });
    let ran: usize = logs.iter().map(|log| log.outcome.totals.ran).sum();
    let cached: usize = logs.iter().map(|log| log.outcome.totals.cached).sum();
    assert_eq!((ran, cached), (36, 72));
    assert!(logs.windows(2).all(|pair| pair[0].keys() == pair[1].keys()));
}

#[test]
fn a_part_that_several_want_at_once_is_computed_once() {
    let samples = |logs: &[Log]| -> u64 {
        logs.iter().map(|log| log.outcome.totals.counts.get("samples").copied().unwrap_or(0)).sum()
    };
    let series = |gain: u32| format!("s{gain}: Series(value: \"n\", samples: 48, gain: {gain}, millis: 40),");
    // Two nodes of a run: other keys, the same parts.
    let lab = Lab::on_disk();
    let log = lab.run_text(&graph_text(&format!("n: Number(value: 3), {}{}", series(1), series(2))));
    assert_eq!((log.outcome.totals.ran, samples(&[log])), (3, 48));
    // Concurrent runs.
    let lab = Lab::on_disk();
    let run = |gain| {
        let text = graph_text(&format!("n: Number(value: 3), {}", series(gain)));
        lab.run_on(&lab.engine(), &text, &[], |_, _| {})
    };
    let logs = std::thread::scope(|scope| {
        [1, 2, 3].map(|gain| scope.spawn(move || run(gain))).map(|thread| thread.join().unwrap())
    });
    assert_eq!(samples(&logs), 48);
    assert!(logs.iter().all(|log| log.outcome.totals.failed == 0));
}

#[test]
fn a_busy_key_does_not_hold_up_the_rest() {
    // On a machine so busy that the key is free before it is asked for, it is held for longer.
    let went_ahead = [400, 4_000, 40_000].into_iter().any(|millis| {
        let mut lab = Lab::on_disk();
        lab.jobs = 1;
        let slow = format!("a: Number(), s: Slow(value: \"a\", millis: {millis})");
        let text = graph_text(&format!("{slow}, b: Number(value: 2), t: Scale(value: \"b\")"));
        let (other, slow) = (lab.engine(), graph_text(&slow));
        let (sender, started) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                lab.run_on(&other, &slow, &[], |event, _| {
                    if matches!(event, Event::Start { id, .. } if id == "s") {
                        sender.send(()).unwrap();
                    }
                })
            });
            started.recv().unwrap();
            let mut ends = Vec::new();
            let log = lab.run_on(&lab.engine(), &text, &[], |event, _| {
                if let Event::Node { id, .. } = event {
                    ends.push(id.clone());
                }
            });
            assert_eq!((log.ran().as_str(), log.cached().as_str()), ("b t", "a s"));
            ends.iter().position(|id| id == "t") < ends.iter().position(|id| id == "s")
        })
    });
    assert!(went_ahead, "`t` waited for a key that it does not need");
}

#[test]
fn a_stored_value_can_be_looked_at() {
    let lab = Lab::on_disk();
    let text = graph_text("a: Number(value: 2), s: Scale(value: \"a\")");
    lab.run_text(&text);
    let graph = lab.parse(&text).unwrap();
    let wire = engine::Wire { node: graph.find("s").unwrap(), port: 0 };
    let value: Option<crate::arithmetic::Num> = lab.engine().value(&graph, wire);
    assert_eq!(value, Some(crate::arithmetic::Num(4.0)));
    let engine = Engine::new(Store::in_memory(), 1, 1 << 20);
    assert_eq!(engine.value::<crate::arithmetic::Num>(&graph, wire), None);
}

#[test]
fn a_value_of_which_only_the_digest_was_kept_is_made_again_and_never_another_one() {
    // `s` keeps nothing, nor does the loader above it; `t`, which it reads too, keeps its value.
    let mut lab = Lab::on_disk();
    lab.write("a.txt", "4\n");
    let mut add = engine::KindEntry::of::<crate::arithmetic::Add>();
    add.store = engine::Keep::Cheap;
    lab.registry = crate::arithmetic::registry_with(add);
    let text = graph_text(
        "a: LoadNumber(path: \"a.txt\"), t: Scale(value: \"a\"), s: Add(terms: [\"a\", \"t\"]), \
         u: Add(terms: \"s\", bias: 1.0), d: Drift(value: \"a\")",
    );
    lab.run_text(&text);
    let graph = lab.parse(&text).unwrap();
    let value = |name: &str| {
        let wire = engine::Wire { node: graph.find(name).unwrap(), port: 0 };
        lab.engine().value::<crate::arithmetic::Num>(&graph, wire).map(|number| number.0)
    };
    assert_eq!(["s", "u"].map(value), [Some(12.0), Some(13.0)]);
    assert_eq!(value("d"), None, "it gives another number each time");
    lab.write("a.txt", "5\n");
    assert_eq!(value("s"), None, "the file is another one now");
}

/// A value that is not in the store is given without the work of nodes that store their values. This test fails if
/// `value_at_hand` gives every value.
#[test]
fn a_value_at_hand_needs_no_stored_values_to_be_computed_again() {
    let mut lab = Lab::on_disk();
    lab.write("a.txt", "4\n");
    let text = graph_text("a: LoadNumber(path: \"a.txt\"), t: Scale(value: \"a\"), s: Scale(value: \"t\")");
    // The run keeps only digests, as if the values were elsewhere.
    let mut scale = engine::KindEntry::of::<crate::arithmetic::Scale>();
    scale.store = engine::Keep::Cheap;
    lab.registry = crate::arithmetic::registry_with(scale);
    let log = lab.run_text(&text);
    lab.registry = crate::arithmetic::registry();
    let graph = lab.parse(&text).unwrap();
    let both = |name: &str| {
        let wire = engine::Wire { node: graph.find(name).unwrap(), port: 0 };
        let engine = lab.engine();
        let at_hand = engine.value_at_hand::<crate::arithmetic::Num>(&graph, &log.keys_in(&graph), wire);
        [at_hand, engine.value(&graph, wire)].map(|number| number.map(|number| number.0))
    };
    assert_eq!(["a", "s"].map(both), [[Some(4.0); 2], [None, Some(16.0)]]);
    // Stored values are at hand.
    let text = text.replace("value: \"a\"", "value: \"a\", by: 3.0");
    let log = lab.run_text(&text);
    let graph = lab.parse(&text).unwrap();
    let wire = engine::Wire { node: graph.find("s").unwrap(), port: 0 };
    let of = |log: &Log| {
        let value = lab.engine().value_at_hand::<crate::arithmetic::Num>(&graph, &log.keys_in(&graph), wire);
        value.map(|number| number.0)
    };
    assert_eq!(of(&log), Some(24.0));
    // Another process runs the graph with another value. An earlier version then gave this other value.
    let other = lab.run_text(&text.replace("by: 3.0", "by: 5.0"));
    assert_eq!((of(&log), of(&other)), (Some(24.0), Some(40.0)));
}

#[test]
fn who_waits_for_another_process_says_so() {
    let lab = Lab::on_disk();
    let text = graph_text("a: Number(value: 5)");
    let mut key = None;
    Lab::in_memory().run_until(&text, &[], |event, _| {
        if let Event::Node { key: made, .. } = event {
            key = *made;
        }
    });
    // As by a process that is stopped while it computes: it holds the lease.
    let store = Store::open(&lab.cache(), Options::default()).unwrap();
    let LeaseState::Acquired(lease) = store.lease(&key.unwrap()) else { panic!("busy") };
    let held = std::cell::Cell::new(Some(lease));
    let log = lab.run_on(&lab.engine(), &text, &[], |event, _| {
        if matches!(event, Event::Warning { id: "waits", text } if text.starts_with("`a` waits")) {
            assert!(held.take().is_some(), "reported once");
        }
    });
    assert!(held.take().is_none());
    assert_eq!((log.outcome.totals.ran, log.outcome.totals.failed), (1, 0));
}

#[test]
fn a_stopped_process_is_not_waited_for() {
    let lab = Lab::on_disk();
    let text = graph_text("a: Number(value: 6), s: Scale(value: \"a\")");
    let mut keys = Vec::new();
    Lab::in_memory().run_until(&text, &[], |event, _| {
        if let Event::Node { key: Some(key), .. } = event {
            keys.push(*key);
        }
    });
    // Processes that hold the lease of `a`: one is stopped, and one renews its lease, as a run does.
    for renewing in [true, false] {
        let store = Store::open(&lab.cache(), Options::default()).unwrap();
        let LeaseState::Acquired(lease) = store.lease(&keys[0]) else { panic!("busy") };
        let held = std::sync::Mutex::new(Some(lease));
        let start = Instant::now();
        let patience = cache::STALLED_AFTER.as_secs();
        let log = std::thread::scope(|scope| {
            scope.spawn(|| {
                while renewing && start.elapsed().as_secs() < patience + 3 {
                    store.renew_leases();
                    std::thread::sleep(Duration::from_millis(500));
                }
                if renewing {
                    drop(held.lock().unwrap().take());
                }
            });
            lab.run_text(&text)
        });
        let seconds = start.elapsed().as_secs();
        let stalled =
            log.warnings().iter().any(|(id, text)| *id == "stalled" && text.starts_with("`a` is computed"));
        assert_eq!((log.ran().as_str(), stalled), ("a s", !renewing), "{:?}", log.warnings());
        assert!(seconds >= patience, "{seconds} s");
        std::fs::remove_file(lab.cache().join("v1/records.log")).unwrap();
    }
}
