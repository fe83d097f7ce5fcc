//! Tests of damage to the cache between runs. Damage costs time and causes one warning, but never gives a wrong
//! result.

use std::fs;
use std::path::Path;

use crate::lab::{Lab, Log, graph_text};

/// A graph with two lists that are stored as separate files, small results, parts, and a loader whose outputs are
/// not stored. Its second half is computed from the result of its first half.
const GRAPH: &str = r#"
    a: LoadNumber(path: "a.txt"),
    first: Ramp(value: "a", count: 3000),
    sum: Sum(numbers: "first"),
    mean: Series(value: "sum", samples: 40),
    second: Ramp(value: "mean", count: 2000),
    total: Sum(numbers: "second"),
    twice: Scale(value: "total"),
    save: WriteNumber(number: ["twice", "mean"], path: "save.txt"),
"#;

/// The graph with different last steps, so that all nodes downstream of `second` need values from the store.
fn edited() -> String {
    let third =
        "third: Sum(numbers: \"first\", times: 2), more: WriteNumber(number: \"third\", path: \"more.txt\"),";
    GRAPH.replace("twice: Scale(", &format!("{third} twice: Scale(by: 3.0, "))
}

struct Warm {
    lab: Lab,
    expected: (String, String),
}

/// A lab with a warm cache, and the results that the edited graph gives with an empty cache.
fn warm() -> Warm {
    let clean = Lab::on_disk();
    clean.write("a.txt", "3");
    clean.run(&edited());
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    lab.run(GRAPH);
    Warm { lab, expected: (clean.out("save.txt"), clean.out("more.txt")) }
}

/// Runs the edited graph after some damage and checks the invariants.
fn recover(warm: &Warm, what: &str) -> Log {
    let log = warm.lab.run(&edited());
    assert_eq!(log.exit_code(), 0, "{what}: {}", log.failures());
    assert_eq!((warm.lab.out("save.txt"), warm.lab.out("more.txt")), warm.expected, "{what}");
    let again = warm.lab.run(&edited());
    assert_eq!((again.ran().as_str(), again.warnings()), ("", vec![]), "{what}: healed");
    log
}

/// Damages the bytes of a file. `how` selects one of several kinds of damage.
fn damage(path: &Path, how: usize) {
    let mut bytes = fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    match how {
        0 => bytes.clear(),
        1 => bytes.truncate(1),
        2 => bytes.truncate(middle),
        3 => drop(bytes.pop()),
        4 => bytes.extend_from_slice(b"junk"),
        5 => bytes[middle] ^= 1,
        6 => bytes[middle..].fill(0),
        _ => return fs::remove_file(path).unwrap(),
    }
    fs::write(path, bytes).unwrap();
}

#[test]
fn damaged_values_are_made_again_with_one_warning_each() {
    for how in 0..8 {
        let warm = warm();
        let blobs = warm.lab.blob_files();
        assert_eq!(blobs.len(), 2);
        blobs.iter().for_each(|path| damage(path, how));
        let log = recover(&warm, &format!("damage {how}"));
        // `third` reads the first list; no new node reads the second.
        let warnings = log.warnings();
        assert_eq!(warnings.len(), 1, "{how}: {warnings:?}");
        assert_eq!(warnings[0].0, "cache-damage");
        assert!(warnings[0].1.starts_with("`first`: "), "{}", warnings[0].1);
        assert_eq!(log.remade(), "a first", "the loader is needed to make it");
    }
}

#[test]
fn values_in_each_other_s_place_are_noticed() {
    let warm = warm();
    let blobs = warm.lab.blob_files();
    let (one, two) = (fs::read(&blobs[0]).unwrap(), fs::read(&blobs[1]).unwrap());
    fs::write(&blobs[0], two).unwrap();
    fs::write(&blobs[1], one).unwrap();
    assert_eq!(recover(&warm, "swapped").warnings().len(), 1);
}

#[test]
fn damaged_logs_cost_only_time() {
    for name in ["records.log", "blobs.log"] {
        for how in 0..8 {
            let warm = warm();
            damage(&warm.lab.cache().join("v1").join(name), how);
            recover(&warm, &format!("{name} {how}"));
        }
        // And at many places, one at a time.
        let warm = warm();
        let path = warm.lab.cache().join("v1").join(name);
        let good = fs::read(&path).unwrap();
        for at in (0..good.len()).step_by(good.len() / 40) {
            let mut bad = good.clone();
            bad[at] ^= 0x40;
            fs::write(&path, bad).unwrap();
            recover(&warm, &format!("{name} byte {at}"));
            fs::write(&path, &good).unwrap();
        }
    }
}

#[test]
fn an_emptied_cache_is_a_cold_one() {
    let warm = warm();
    fs::remove_dir_all(warm.lab.cache()).unwrap();
    assert_eq!(recover(&warm, "emptied").warnings(), []);
}

#[test]
fn a_chain_of_lost_values_is_made_again_from_its_start() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "1");
    let chain: String = (1..60).map(|n| format!("s{n}: Scale(value: \"s{}\", by: 1.5),", n - 1)).collect();
    let nodes = |end: &str| {
        format!("s0: LoadNumber(path: \"a.txt\"), {chain} {end} w: WriteNumber(number: \"e\", path: \"w\")")
    };
    lab.run(&nodes("e: Scale(value: \"s59\"),"));
    let expected = lab.out("w");
    // The records stay, every value is removed.
    fs::remove_file(lab.cache().join("v1/blobs.log")).unwrap();
    fs::remove_file(lab.path("out/w")).unwrap();
    let log = lab.run(&nodes("e: Scale(value: \"s59\"),"));
    let warnings = log.warnings();
    assert!(warnings.len() == 1 && warnings[0].1.contains("stored values of `s"), "one fault: {warnings:?}");
    assert_eq!((log.ran().as_str(), log.exit_code(), log.remade().split(' ').count()), ("", 0, 62));
    assert_eq!(lab.out("w"), expected);
}

#[test]
fn values_that_cannot_be_made_again_stop_only_their_readers() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "1");
    let nodes = "a: LoadNumber(path: \"a.txt\"), r: Ramp(value: \"a\"), s: Sum(numbers: \"r\"), \
        w: WriteNumber(number: \"s\", path: \"w\"), p: Drift(value: \"a\"), q: Scale(value: \"p\")";
    lab.run_only(&graph_text(nodes), &["w", "q"]);
    fs::remove_dir_all(lab.cache().join("v1/blobs")).unwrap();
    // `q` is new and needs `p`, which returns another result; `w` needs `r`, which is fine.
    let new = nodes.replace("Scale(value", "Scale(by: 5.0, value") + ", t: Sum(numbers: \"r\", times: 2)";
    let log = lab.run_only(&graph_text(&new), &["w", "q", "t"]);
    assert_eq!((log.failed().as_str(), log.skipped().as_str()), ("p", "q"));
    assert_eq!((log.ran().as_str(), log.exit_code()), ("t", 1));
}

#[test]
fn a_cache_that_cannot_be_written_is_reported_once_and_the_run_completes() {
    let warm = warm();
    let mut lab = warm.lab;
    lab.options.read_only = true;
    let before = lab.cache_files();
    for _ in 0..2 {
        let log = lab.run(&edited());
        assert_eq!((log.exit_code(), log.ran().as_str()), (0, "more save third twice"));
        let ids: Vec<_> = log.warnings().into_iter().map(|(id, _)| id).collect();
        assert_eq!(ids, ["cache-read-only"]);
        assert_eq!((lab.out("save.txt"), lab.out("more.txt")), warm.expected);
    }
    assert_eq!(lab.cache_files(), before);
    // An empty one, too.
    let mut lab = Lab::on_disk();
    lab.write("a.txt", "3");
    lab.options.read_only = true;
    let log = lab.run(&edited());
    assert_eq!((log.exit_code(), log.warnings().len()), (0, 1));
    assert_eq!((lab.out("save.txt"), lab.out("more.txt")), warm.expected);
}

#[test]
fn collections_beside_runs_take_nothing_that_a_run_needs() {
    use cache::{Limits, Options, Store};
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Duration;
    let (warm, edited) = (warm(), edited());
    let done = AtomicBool::new(false);
    let collected = std::thread::scope(|scope| {
        let collector = scope.spawn(|| {
            let mut collected = 0;
            // At least once: after the runs nothing blocks it.
            while !done.load(Ordering::Relaxed) || collected == 0 {
                let store = Store::open(&warm.lab.cache(), Options::default()).unwrap();
                let limits = Limits { max_size: Some(20_000 * (collected % 3)), ..Limits::default() };
                let result = store.collect(&limits, &engine::blobs_of, Duration::from_millis(20));
                collected += u64::from(result.is_ok());
            }
            collected
        });
        for round in 0..12 {
            let log = warm.lab.run(if round % 2 == 0 { GRAPH } else { &edited });
            assert_eq!((log.exit_code(), log.warnings()), (0, vec![]), "round {round}: {}", log.failures());
        }
        done.store(true, Ordering::Relaxed);
        collector.join().unwrap()
    });
    assert!(collected > 0);
    recover(&warm, "after it all");
}

#[test]
fn what_records_name_is_what_a_collection_leaves() {
    use cache::{Limits, Options, Store};
    let warm = warm();
    let store = Store::open(&warm.lab.cache(), Options::default()).unwrap();
    let check = || store.check(false, &engine::blobs_of, &mut |_| true).unwrap();
    let before = check();
    assert!(before.is_whole() && before.blobs > 5);
    let collected = store.collect(&Limits::default(), &engine::blobs_of, std::time::Duration::ZERO).unwrap();
    assert_eq!((collected.records, collected.blobs, check()), (0, 0, before));
    fs::remove_file(&warm.lab.blob_files()[0]).unwrap();
    assert_eq!(check().incomplete.len(), 1);
    drop(store);
    recover(&warm, "one value gone");
}
