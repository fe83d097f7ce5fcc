//! Nodes that the workers of a server compute.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use engine::{Canary, Event, Graph, Source, SourceRoot};
use tonic::Code;

use super::client::{Client, Ran, WRITTEN};
use super::fake::{Fake, Script};
use super::fake_workers::{FAILED, Fault};
use crate::reapi::WorkerOptions;
use crate::testing::registry;

const BLAKE3: i32 = 9;
const SHA256: i32 = 1;

fn server(faults: &[Fault]) -> Fake {
    Fake::start(Script {
        functions: vec![SHA256],
        updates: true,
        executes: true,
        faults: faults.to_vec(),
        ..Script::default()
    })
}

fn send(client: &Client, server: &Fake) -> Ran {
    client.send(&server.address, client.worker_options())
}

/// The keys of the results in the cache of a client, and the digests of all values in them.
fn results(client: &Client) -> Vec<(cache::Digest, Vec<cache::Digest>)> {
    let engine = client.engine();
    let store = engine.store();
    let mut keys = store.record_keys().expect("keys");
    keys.sort();
    let value = |key: &cache::Digest| {
        let record = store.get_record(key).expect("a record");
        // A value that is not here is not listed, so the manifest, which is the key, identifies the result.
        engine::blobs_of(&record)
    };
    keys.iter().map(|key| (*key, value(key))).collect()
}

#[test]
fn workers_compute_nodes_and_values_stay_there_until_they_are_needed() {
    let alone = Client::new(&[]);
    alone.run_alone();
    for functions in [vec![SHA256], vec![BLAKE3]] {
        let fake = server(&[]);
        fake.script().functions = functions;
        let client = Client::new(&[]);
        let mut stages = Vec::new();
        let ran = client.send_until(&fake.address, client.worker_options(), |event, _| {
            if let Event::Stage { id, stage, worker } = event
                && id == "e"
            {
                stages.push(format!("{stage} {worker}"));
            }
        });
        assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec![]), "{:?}", ran.warnings);
        assert_eq!((ran.ran.as_str(), ran.traffic.executed, ran.outcome.totals.ran), ("d e n w", 3, 4));
        assert_eq!(stages, ["sending ", "queued ", "executing fake-1"]);
        // Only the value that the sink reads was fetched, although `d` reads 1.2 MB from `n`.
        assert_eq!(ran.traffic.values, 1);
        assert!(ran.traffic.bytes_down < 200 && ran.traffic.bytes_up < 20_000, "{:?}", ran.traffic);
        let keys = |client: &Client| results(client).into_iter().map(|(key, _)| key).collect::<Vec<_>>();
        assert_eq!(keys(&client), keys(&alone));

        // Nothing is executed again, and the digests under which values are stored are known in a later run.
        let executed = fake.count("execute");
        std::fs::remove_file(client.path("out/w.txt")).expect("the file");
        let ran = send(&client, &fake);
        assert_eq!((ran.ran.as_str(), ran.written.as_deref()), ("", Some(WRITTEN)));
        assert_eq!((fake.count("execute"), fake.count("update")), (executed, 0));
        // Without the server, the values are computed here.
        std::fs::remove_file(client.path("out/w.txt")).expect("the file");
        let ran = client.run_alone();
        assert_eq!((ran.ran.as_str(), ran.written.as_deref()), ("", Some(WRITTEN)));
    }
}

#[test]
fn a_second_client_uses_the_signed_results_of_workers_and_no_others() {
    let fake = server(&[]);
    let first = Client::new(&[]).publishing();
    let ran = send(&first, &fake);
    assert_eq!((ran.traffic.executed, ran.traffic.stored), (3, 4), "{:?}", ran.warnings);
    let second = Client::new(&[&first]);
    let ran = send(&second, &fake);
    assert_eq!((ran.ran.as_str(), ran.written.as_deref()), ("", Some(WRITTEN)));
    assert_eq!((ran.traffic.executed, ran.traffic.found, ran.traffic.values), (0, 4, 1));
    // A client that does not trust the first one has the nodes executed again, although the server knows the actions.
    let third = Client::new(&[]);
    let ran = send(&third, &fake);
    assert_eq!((ran.traffic.executed, ran.ids()), (3, vec!["remote-untrusted"]));
    // Inputs that the server has are not sent again.
    assert!(ran.traffic.bytes_up < 100, "{:?}", ran.traffic);
}

/// Each failure of a worker or of the server: the file is right, and there is one warning. Without fallback, the run
/// fails.
#[test]
fn failures_of_workers_never_change_a_byte() {
    let cases: [(Fault, &str); 21] = [
        (Fault::Status(Code::DeadlineExceeded), "remote-timeout"),
        (Fault::Status(Code::InvalidArgument), "remote-worker"),
        (Fault::Call(Code::InvalidArgument), "remote-worker"),
        (Fault::Call(Code::PermissionDenied), "remote-refused"),
        (Fault::Exit(2, ""), "remote-worker"),
        (Fault::Exit(127, ""), "remote-worker"),
        (Fault::Exit(137, ""), "remote-memory"),
        (Fault::Exit(1, "no JSON"), "remote-worker"),
        (Fault::Exit(0, ""), "remote-invalid"),
        (Fault::Link, "remote-invalid"),
        (Fault::Folder, "remote-invalid"),
        (Fault::More("out/values/other"), "remote-invalid"),
        (Fault::More("../entry"), "remote-invalid"),
        (Fault::More("out/entry"), "remote-invalid"),
        (Fault::Less, "remote-invalid"),
        (Fault::Longer, "remote-invalid"),
        (Fault::DamagedEntry, "remote-invalid"),
        (Fault::Stored, "remote-worker"),
        (Fault::Call(Code::Unimplemented), "remote-refused"),
        (Fault::Status(Code::PermissionDenied), "remote-worker"),
        (Fault::Exit(3, ""), "remote-invalid"),
    ];
    for (fault, id) in cases {
        // Every node in turn.
        for at in 0..3 {
            let mut faults = vec![];
            faults.resize(at, Fault::Interrupted);
            faults.push(fault.clone());
            let fake = server(&faults);
            let ran = send(&Client::new(&[]), &fake);
            assert_eq!(ran.written.as_deref(), Some(WRITTEN), "{fault:?}");
            assert_eq!((ran.ids(), ran.ran.as_str()), (vec![id], "d e n w"), "{fault:?}: {:?}", ran.warnings);
            assert_eq!(ran.traffic.executed, 2, "{fault:?}");
        }
        let strict = Client { fallback: false, ..Client::new(&[]) };
        let fake = server(&[fault.clone()]);
        let ran = send(&strict, &fake);
        assert!(ran.outcome.failures.is_some() && ran.written.is_none(), "{fault:?}");
    }
}

/// Failures after which the node is executed again, or its result arrives after all: no warning.
#[test]
fn interruptions_are_bridged() {
    let twice = |fault: Fault| vec![fault.clone(), fault];
    let cases = [
        vec![Fault::Interrupted],
        vec![Fault::Forgotten],
        vec![Fault::Status(Code::Unavailable)],
        vec![Fault::Status(Code::Internal)],
        vec![Fault::Status(Code::Aborted)],
        twice(Fault::Call(Code::Unavailable)),
        twice(Fault::Call(Code::ResourceExhausted)),
        vec![Fault::Lost],
    ];
    for faults in cases {
        let fake = server(&faults);
        let options = |client: &Client| WorkerOptions { in_flight: 1, ..client.worker_options() };
        let client = Client::new(&[]);
        let ran = client.send(&fake.address, options(&client));
        assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec![]), "{faults:?} {:?}", ran.warnings);
        assert_eq!(ran.traffic.executed, 3, "{faults:?}");
    }
    // A worker that is lost twice: the node is computed here.
    let fake = server(&twice(Fault::Status(Code::Unavailable)));
    let client = Client::new(&[]);
    let ran = client.send(&fake.address, WorkerOptions { in_flight: 1, ..client.worker_options() });
    assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec!["remote-worker"]));
    // A server that refuses all calls is not asked again.
    let fake = server(&[]);
    fake.script().failures = vec![("execute", Code::Unavailable, usize::MAX)];
    let ran = send(&Client::new(&[]), &fake);
    assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec!["remote-lost"]));
}

/// Blobs that are lost on the server between the nodes, and damaged values.
#[test]
fn lost_and_damaged_inputs_are_computed_again() {
    let fake = server(&[]);
    let client = Client::new(&[]);
    let mut ended = 0;
    let options = WorkerOptions { in_flight: 1, ..client.worker_options() };
    let ran = client.send_until(&fake.address, options, |event, _| {
        if let Event::Node { .. } = event {
            ended += 1;
            // Everything is gone after the first node.
            if ended == 1 {
                fake.script().blobs.clear();
            }
        }
    });
    assert_eq!(ran.written.as_deref(), Some(WRITTEN), "{:?}", ran.warnings);
    for at in 0..3 {
        let mut faults = vec![Fault::Interrupted; at];
        faults.push(Fault::Damaged);
        let fake = server(&faults);
        let client = Client::new(&[]);
        let options = WorkerOptions { in_flight: 1, ..client.worker_options() };
        let ran = client.send(&fake.address, options);
        assert_eq!(ran.written.as_deref(), Some(WRITTEN), "{at} {:?}", ran.warnings);
        let engine = client.engine();
        for (_, values) in results(&client) {
            for value in values {
                assert!(engine.store().get_blob(&value).expect("reads").is_some(), "every value is right");
            }
        }
    }
}

#[test]
fn a_node_that_fails_on_a_worker_fails() {
    let fake = server(&[Fault::Interrupted, Fault::Exit(1, FAILED), Fault::Exit(1, FAILED)]);
    let ran = send(&Client::new(&[]), &fake);
    let failures = ran.outcome.failures.expect("failures").render(false);
    assert!(failures.contains("as planned") && failures.contains("plan otherwise"), "{failures}");
    assert_eq!((ran.ids(), ran.written, ran.outcome.totals.failed), (vec![], None, 2));
}

#[test]
fn a_node_is_tried_once_with_more_memory() {
    let needs = r#"{"event":"failed","message":"too little","needs":5000000000}"#;
    let fake = server(&[Fault::Exit(1, needs), Fault::Interrupted]);
    let client = Client::new(&[]);
    let options = WorkerOptions {
        memory: Some(("memory-gib".to_owned(), vec![2, 4, 8, 16])),
        properties: vec![("OSFamily".to_owned(), "linux".to_owned())],
        timeout: Some(Duration::from_secs(600)),
        in_flight: 1,
        ..client.worker_options()
    };
    let ran = client.send(&fake.address, options.clone());
    assert_eq!((ran.written.as_deref(), ran.ids(), ran.traffic.executed), (Some(WRITTEN), vec![], 3));
    let script = fake.script();
    let memory: Vec<&str> = script
        .platforms
        .iter()
        .map(|platform| {
            assert_eq!(platform.properties[0].name, "OSFamily");
            platform.properties[1].value.as_str()
        })
        .collect();
    assert_eq!(memory, ["8", "2", "2"], "5 GB need 8 GiB; the first attempt did not run");
    assert!(script.timeouts.iter().all(|limit| limit.is_some_and(|limit| limit.seconds == 600)));
    drop(script);
    let fake = server(&vec![Fault::Exit(137, ""); 2]);
    let client = Client::new(&[]);
    let ran = client.send(&fake.address, WorkerOptions { program: client.worker_options().program, ..options });
    assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec!["remote-memory"]));
}

#[test]
fn after_three_failures_in_a_row_nothing_more_is_sent() {
    let fake = server(&vec![Fault::Exit(127, ""); 9]);
    let ran = send(&Client::new(&[]), &fake);
    assert_eq!(ran.written.as_deref(), Some(WRITTEN));
    assert_eq!((ran.ids(), fake.count("execute")), (vec!["remote-worker", "remote-stopped"], 3));
}

#[test]
fn a_check_names_the_node_and_the_worker_that_differ() {
    let checking = |client: &Client| WorkerOptions { checked: 1.0, in_flight: 1, ..client.worker_options() };
    let fake = server(&[]);
    let client = Client::new(&[]).publishing();
    let ran = client.send(&fake.address, checking(&client));
    assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec![]), "{:?}", ran.warnings);
    assert_eq!((ran.traffic.executed, ran.traffic.stored, ran.ran.as_str()), (3, 4, "d e n w"));

    // Unchecked, the lie is believed: the workers of the server are trusted.
    let lies = [Fault::Interrupted, Fault::Lie, Fault::Lie];
    let client = Client::new(&[]);
    let ran = send(&client, &server(&lies));
    assert!(ran.written.is_some_and(|written| written != WRITTEN) && ran.ids().is_empty());

    let client = Client::new(&[]);
    let fake = server(&lies);
    let ran = client.send(&fake.address, checking(&client));
    let failures = ran.outcome.failures.expect("a failure").render(false);
    assert!(failures.contains("differs") && failures.contains("`fake-1`"), "{failures}");
    assert_eq!(ran.ids(), ["remote-differs"]);
    assert!(fake.count("execute") < 4, "nothing more is sent");
    // What is in the cache is right.
    assert_eq!(client.run_alone().written.as_deref(), Some(WRITTEN));
}

#[test]
fn a_run_that_is_cancelled_cancels_its_actions() {
    let fake = server(&[Fault::Endless]);
    let client = Client::new(&[]);
    let begin = Instant::now();
    let ran = client.send_until(&fake.address, client.worker_options(), |event, cancel| {
        if matches!(event, Event::Stage { stage: "executing", .. }) {
            cancel.store(true, Ordering::Relaxed);
        }
    });
    assert!(ran.outcome.totals.stopped && begin.elapsed() < Duration::from_secs(5), "{:?}", begin.elapsed());
    assert_eq!((fake.count("cancel"), ran.ids()), (1, vec![]));
}

#[test]
fn a_server_that_executes_nothing_is_refused() {
    let fake = server(&[]);
    fake.script().executes = false;
    let client = Client::new(&[]);
    let shared = client.connect(&fake.address).expect("connects");
    let error = crate::reapi::ServerWorkers::new(shared.into(), client.worker_options());
    let error = error.err().expect("an error").to_string();
    assert!(error.contains("executes no actions"), "{error}");
}

#[test]
fn a_canary_is_computed_once_before_all_other_nodes() {
    let known = crate::testing::entry(7).blobs().expect("a record");
    let canary = |expected| {
        let text = "Graph(version: 1, scene: (up: \"+z\"), nodes: (\n n: Count(to: 7),\n))";
        let graph = Graph::parse(Source::new("c.ron", text), &registry(), SourceRoot::new("."));
        Canary::new(&graph.unwrap_or_else(|error| panic!("{error}")), expected).expect("a canary")
    };
    let options = |client: &Client, expected: &[cache::Digest]| WorkerOptions {
        canary: Some(canary(expected.to_vec())),
        ..client.worker_options()
    };
    let client = Client::new(&[]);
    let fake = server(&[]);
    for executed in [4, 3] {
        let ran = client.send(&fake.address, options(&client, &known));
        assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec![]), "{:?}", ran.warnings);
        assert_eq!(ran.traffic.executed, executed, "the canary is not computed again on the same day");
        // Only the results are forgotten, not the proof.
        for key in client.engine().store().record_keys().expect("keys") {
            client.engine().store().remove_record(&key).expect("removes");
        }
    }
    for (faults, id) in [(vec![Fault::Lie], "remote-differs"), (vec![Fault::Exit(127, "")], "remote-worker")] {
        let client = Client::new(&[]);
        let fake = server(&faults);
        let ran = client.send(&fake.address, options(&client, &known));
        assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec![id]), "{:?}", ran.warnings);
        assert_eq!(fake.count("execute"), 1);
    }
}
