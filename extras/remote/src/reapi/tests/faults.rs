//! Faults of a real server: lost and damaged blobs, a server that is gone, a server that does not answer.

use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use engine::Event;

use super::casd::Casd;
use super::client::{Client, Ran, WRITTEN};

type Fault = fn(&[u8]) -> Option<Vec<u8>>;

/// Ways to damage a file. `None` removes it.
const FAULTS: [(&str, Fault); 9] = [
    ("removed", |_| None),
    ("emptied", |_| Some(Vec::new())),
    ("cut in half", |bytes| Some(bytes[..bytes.len() / 2].to_vec())),
    ("cut by one byte", |bytes| Some(bytes[..bytes.len().saturating_sub(1)].to_vec())),
    ("longer by one byte", |bytes| Some([bytes, &[7]].concat())),
    ("first bit", |bytes| Some(flipped(bytes, 0))),
    ("middle bit", |bytes| Some(flipped(bytes, bytes.len() / 2))),
    ("last bit", |bytes| Some(flipped(bytes, bytes.len().saturating_sub(1)))),
    ("zeros", |bytes| Some(vec![0; bytes.len()])),
];

fn flipped(bytes: &[u8], at: usize) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    if let Some(byte) = bytes.get_mut(at) {
        *byte ^= 0x10;
    }
    bytes
}

fn is_right(ran: &Ran, what: &str) {
    assert_eq!(ran.written.as_deref(), Some(WRITTEN), "{what}: {:?}", ran.warnings);
    assert_eq!(ran.outcome.totals.failed, 0, "{what}");
    let counts = ran.ids().iter().map(|id| ran.ids().iter().filter(|other| *other == id).count()).max();
    assert!(counts.unwrap_or(1) == 1, "{what}: each warning is made once: {:?}", ran.warnings);
}

/// Replaces the file, which the server may have made read-only, or shares with nothing else.
fn replace(path: &Path, content: Option<&[u8]>) {
    let _ = std::fs::remove_file(path);
    if let Some(content) = content {
        std::fs::write(path, content).expect("writes");
    }
}

/// Every blob and every result of the server is damaged in every way. The outcome is that of a server without the
/// blob, and at most one warning of each kind.
#[test]
fn no_damage_on_the_server_gives_a_wrong_byte() {
    let Some(server) = Casd::start() else { return };
    let first = Client::new(&[]).publishing();
    is_right(&first.run(&server.address()), "the first run");
    let (blobs, results) = (server.blobs(), server.results());
    assert!(blobs.len() >= 10 && results.len() >= 4, "{} blobs, {} results", blobs.len(), results.len());
    let (mut faults, mut unharmed) = (0, 0);
    for path in blobs.iter().chain(&results) {
        let good = std::fs::read(path).expect("reads");
        for (name, fault) in FAULTS {
            let bad = fault(&good);
            if bad.as_deref() == Some(&good) {
                continue;
            }
            replace(path, bad.as_deref());
            let second = Client::new(&[&first]);
            let what = format!("{} {name}", path.display());
            let ran = second.run(&server.address());
            is_right(&ran, &what);
            unharmed += usize::from(ran.ran.is_empty());
            replace(path, Some(&good));
            faults += 1;
        }
    }
    assert!(faults >= 130, "{faults} faults");
    assert!(unharmed < faults, "the faults had an effect");
    assert_eq!(Client::new(&[&first]).run(&server.address()).ran, "", "the server is as it was");
}

#[test]
fn a_server_that_is_gone_costs_one_warning_or_refuses() {
    let Some(mut server) = Casd::start() else { return };
    let first = Client::new(&[]).publishing();
    first.run(&server.address());
    // Gone before the run: the command decides what follows.
    server.kill();
    assert!(first.connect(&server.address()).is_err());
    server.resume();
    // Gone at each event of a run.
    for stop_at in 0..12 {
        for fallback in [true, false] {
            let client = Client { fallback, ..Client::new(&[&first]) };
            let mut count = 0;
            let ran = client.run_until(&server.address(), |event, _| {
                if !matches!(event, Event::Progress { .. }) && count == stop_at {
                    server.kill();
                }
                count += 1;
            });
            let what = format!("gone at {stop_at}, fallback {fallback}: {:?}", ran.warnings);
            if fallback || ran.outcome.totals.failed == 0 {
                is_right(&ran, &what);
            } else {
                let error = ran.outcome.failures.expect("failures").to_string();
                assert!(
                    error.contains("are not available") && error.contains("--no-remote-fallback"),
                    "{error}"
                );
                assert!(ran.warnings.is_empty(), "{what}");
            }
            // The next run completes whatever is missing.
            server.kill();
            server.resume();
            let again = client.run(&server.address());
            is_right(&again, &what);
            assert_eq!(again.ids().len(), 0, "{what}");
        }
    }
}

#[test]
fn a_server_that_does_not_answer_is_given_up_after_the_limit() {
    let Some(server) = Casd::start() else { return };
    let first = Client::new(&[]).publishing();
    let shared = std::sync::Arc::new(first.connect(&server.address()).expect("connects"));
    server.freeze(true);
    let begin = Instant::now();
    let ran = first.run_on(&first.engine().sharing(shared), |_, _| {});
    let took = begin.elapsed();
    server.freeze(false);
    is_right(&ran, "a frozen server");
    assert_eq!(ran.ids(), ["remote-lost"], "{:?}", ran.warnings);
    // Two nodes may have asked before the first answer was given up.
    assert!(took > Duration::from_millis(2300) && took < Duration::from_secs(20), "{took:?}");
}

#[test]
fn a_cancelled_run_does_not_wait_for_the_server() {
    let Some(server) = Casd::start() else { return };
    let client = Client::new(&[]).publishing();
    let shared = std::sync::Arc::new(client.connect(&server.address()).expect("connects"));
    server.freeze(true);
    let engine = client.engine().sharing(shared);
    let begin = Instant::now();
    let ran = std::thread::scope(|scope| {
        let (send, receive) = std::sync::mpsc::channel();
        let (client, engine) = (&client, &engine);
        let runs = scope.spawn(move || {
            client.run_with(engine, |cancel| send.send(cancel).expect("the test waits"), |_, _| {})
        });
        let cancel = receive.recv().expect("the flag");
        std::thread::sleep(Duration::from_millis(100));
        cancel.store(true, Ordering::Relaxed);
        runs.join().expect("it ends")
    });
    let took = begin.elapsed();
    server.freeze(false);
    assert!(ran.outcome.totals.stopped && took < Duration::from_millis(700), "{took:?}");
    assert!(ran.ids().is_empty(), "{:?}", ran.warnings);
}
