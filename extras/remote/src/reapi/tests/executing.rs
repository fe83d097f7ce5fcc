//! Nodes that the workers of a server compute.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use engine::{Canary, Event, Graph, Source, SourceRoot};

use super::client::{Client, Ran, WRITTEN};
use super::fake::{Fake, Script};
use super::fake_workers::Fault;
use crate::reapi::WorkerOptions;
use crate::testing::registry;

const BLAKE3: i32 = 9;
const SHA256: i32 = 1;

pub fn server(faults: &[Fault]) -> Fake {
    Fake::start(Script {
        functions: vec![SHA256],
        updates: true,
        executes: true,
        faults: faults.to_vec(),
        ..Script::default()
    })
}

pub fn send(client: &Client, server: &Fake) -> Ran {
    client.send(&server.address, client.worker_options())
}

/// The keys of the results in the cache of a client, and the digests of all values in them.
pub fn results(client: &Client) -> Vec<(cache::Digest, Vec<cache::Digest>)> {
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
    assert!(ran.written.as_deref().is_some_and(|written| written != WRITTEN) && ran.ids().is_empty());

    let client = Client::new(&[]);
    let fake = server(&lies);
    let ran = client.send(&fake.address, checking(&client));
    let failures = ran.outcome.failures.as_ref().expect("a failure").render(false);
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
    let ran = client.send(&fake.address, options(&client, &known));
    assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec![]), "{:?}", ran.warnings);
    assert_eq!(ran.traffic.executed, 4, "the canary and three nodes");
    for (faults, id) in [(vec![Fault::Lie], "remote-differs"), (vec![Fault::Exit(127, "")], "remote-worker")]
    {
        let client = Client::new(&[]);
        let fake = server(&faults);
        let ran = client.send(&fake.address, options(&client, &known));
        assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec![id]), "{:?}", ran.warnings);
        assert_eq!(fake.count("execute"), 1);
    }
}
