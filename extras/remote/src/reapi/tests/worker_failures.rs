//! Failures of workers, and what a run does about them.

use std::time::Duration;

use engine::Event;
use tonic::Code;

use super::client::{Client, WRITTEN};
use super::executing::{results, send, server};
use super::fake_workers::{FAILED, Fault};
use crate::reapi::WorkerOptions;

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
        let fake = server(std::slice::from_ref(&fault));
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
        assert_eq!(
            (ran.written.as_deref(), ran.ids()),
            (Some(WRITTEN), vec![]),
            "{faults:?} {:?}",
            ran.warnings
        );
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
    let failures = ran.outcome.failures.as_ref().expect("failures").render(false);
    assert!(failures.contains("as planned") && failures.contains("plan otherwise"), "{failures}");
    assert_eq!((ran.ids(), ran.written.as_deref(), ran.outcome.totals.failed), (vec![], None, 2));
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
    let ran =
        client.send(&fake.address, WorkerOptions { program: client.worker_options().program, ..options });
    assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec!["remote-memory"]));
}

#[test]
fn after_three_failures_in_a_row_nothing_more_is_sent() {
    let fake = server(&vec![Fault::Exit(127, ""); 9]);
    let ran = send(&Client::new(&[]), &fake);
    assert_eq!(ran.written.as_deref(), Some(WRITTEN));
    assert_eq!((ran.ids(), fake.count("execute")), (vec!["remote-worker", "remote-stopped"], 3));
}
