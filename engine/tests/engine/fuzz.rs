//! Tests with bytes changed at random, from fixed seeds: no change causes a panic, and every run that completes has
//! the right result.
//!
//! Each test runs a fixed number of rounds or, if `LIGHTHARMONY_FUZZ_SECONDS` is set, for that many seconds.

use std::time::{Duration, Instant};

use cache::{Digest, Options, Store};
use engine::{Engine, Event, Graph, RunOptions, Source, apply};

use crate::lab::{Lab, graph_text};

/// Counter-based random numbers that are the same on every machine.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit.max(1) as u64) as usize
    }
}

/// One source of random numbers for each round. There are `usual` rounds unless `LIGHTHARMONY_FUZZ_SECONDS` is set.
fn rounds(usual: u64) -> impl Iterator<Item = Random> {
    let seconds = std::env::var("LIGHTHARMONY_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    let end = seconds.map(|seconds| Instant::now() + Duration::from_secs(seconds));
    (0..)
        .take_while(move |round| end.map_or(*round < usual, |end| Instant::now() < end))
        .map(|round: u64| Random(round << 32))
}

/// Makes one to four changes: flips, removes, repeats, inserts or overwrites bytes.
fn mutate(bytes: &mut Vec<u8>, random: &mut Random, tokens: &[&str]) {
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        let length = random.below(12).min(bytes.len() - at.min(bytes.len()));
        match random.below(6) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
            1 => drop(bytes.drain(at..at + length)),
            2 => {
                let piece = bytes[at..at + length].to_vec();
                let to = random.below(bytes.len());
                drop(bytes.splice(to..to, piece));
            }
            3 if !tokens.is_empty() => {
                let token = tokens[random.below(tokens.len())];
                drop(bytes.splice(at..at, token.bytes()));
            }
            4 if bytes.len() >= at + 8 => {
                let number = [0, 1, u64::MAX, 1 << 32, 255][random.below(5)];
                bytes[at..at + 8].copy_from_slice(&number.to_le_bytes());
            }
            _ => bytes.truncate(bytes.len() - random.below(4).min(bytes.len())),
        }
    }
}

const NODES: &str = r#"
    in: LoadNumber(path: "a.txt"), // a comment
    first: Ramp(value: "in", count: 300),
    sum: Sum(numbers: "first.numbers", times: 2),
    mean: Series(value: "sum", samples: 40),
    all: Add(terms: ["sum", "mean", "in"], bias: -1.5e-3),
    twice: Scale(value: "all", by: Axis("by")),
    save: WriteNumber(number: ["twice", "mean"], path: "deep/save_{by}.txt"),
"#;

fn text() -> String {
    graph_text(NODES).replace("nodes:", "axes: (by: List([1.0, 2.5])), nodes:")
}

#[test]
fn graph_files() {
    let tokens = [
        "(",
        ")",
        "[",
        "]",
        "\"",
        "'",
        ",",
        ":",
        "Axis(\"by\")",
        "nodes: (",
        "/*",
        "//",
        "r#\"",
        "\\",
        "NaN",
        "1e999",
        "-0",
        "\u{feff}",
        "\u{201c}",
        "Some(",
        "Range(0, 1e9)",
        "include",
        "a.b.c",
        "axes: (",
        "\0",
        "99999999999999999999",
    ];
    let lab = Lab::in_memory();
    lab.write("a.txt", "3");
    let (mut good, mut bad) = (0, 0);
    for mut random in rounds(3000) {
        let mut bytes = text().into_bytes();
        mutate(&mut bytes, &mut random, &tokens);
        let text = String::from_utf8_lossy(&bytes).into_owned();
        match lab.parse(&text) {
            Ok(_) => good += 1,
            Err(diagnostics) => {
                bad += 1;
                assert!(!diagnostics.render(false).is_empty(), "{text}");
            }
        }
        if let Ok(setting) = "sum.times=3".parse() {
            let _ = apply(&Source::new("graph.ron", text), &[setting]);
        }
    }
    assert!(good > 0 && bad > good / 20, "{good} good, {bad} bad");
}

/// Runs a graph and checks that nothing panics. Returns the number of [`Event::Node`] events.
fn run(lab: &Lab, engine: &Engine, graph: &Graph) -> usize {
    let options = RunOptions { out: lab.path("out"), ..RunOptions::default() };
    let mut ends = 0;
    let outcome =
        engine.run(graph, &options, |event| ends += usize::from(matches!(event, Event::Node { .. })));
    assert_eq!(outcome.totals.failed > 0, outcome.failures.is_some());
    let failures = outcome.failures.map(|failures| failures.render(false)).unwrap_or_default();
    assert!(!failures.contains("panicked"), "{failures}");
    ends
}

#[test]
fn records() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    let graph = lab.parse(&text()).unwrap();
    let engine = Engine::new(Store::in_memory(), 1, 1 << 30);
    run(&lab, &engine, &graph);
    let store = engine.store();
    let good: Vec<(Digest, Vec<u8>)> =
        store.record_keys().unwrap().into_iter().map(|key| (key, store.get_record(&key).unwrap())).collect();
    for mut random in rounds(400) {
        let (key, payload) = &good[random.below(good.len())];
        let mut bytes = payload.clone();
        mutate(&mut bytes, &mut random, &[]);
        engine::blobs_of(&bytes);
        store.put_record(key, &bytes).unwrap();
        let _ = engine.plan(&graph, &[]);
        assert!(run(&lab, &engine, &graph) >= graph.nodes.len());
        store.put_record(key, payload).unwrap();
    }
}

#[test]
fn logs_blobs_and_indices() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    lab.run_text(&text());
    let expected = lab.out("deep/save_2.5.txt");
    let files: Vec<_> =
        lab.cache_files().into_iter().map(|path| (std::fs::read(&path).unwrap(), path)).collect();
    for mut random in rounds(60) {
        for (bytes, path) in &files {
            let mut bytes = bytes.clone();
            if random.below(3) == 0 {
                mutate(&mut bytes, &mut random, &["LHe1"]);
            }
            // A repair removes the folder with the lookups of last runs.
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
        let _ = std::fs::remove_dir_all(lab.path("out"));
        let log = lab.run_text(&text());
        assert_eq!(
            (log.exit_code(), lab.out("deep/save_2.5.txt")),
            (0, expected.clone()),
            "{}",
            log.failures()
        );
        let store = Store::open(&lab.cache(), Options::default()).unwrap();
        store.check(true, &engine::blobs_of, &mut |_| true).unwrap();
        assert!(store.check(false, &engine::blobs_of, &mut |_| true).unwrap().is_whole());
    }
}
