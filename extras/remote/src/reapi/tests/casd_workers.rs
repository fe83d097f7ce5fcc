//! Programs that misbehave as actions of a real server.

use std::os::unix::fs::PermissionsExt;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use engine::Event;

use super::casd::Casd;
use super::client::{Client, WRITTEN};
use crate::reapi::{WorkerOptions, WorkerProgram};

/// Options with a shell script as the program.
fn script(client: &Client, text: &str) -> WorkerOptions {
    let path = client.path("script");
    std::fs::write(&path, format!("#!/bin/sh\n{text}\n")).expect("writes");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).expect("sets the mode");
    WorkerOptions { program: WorkerProgram::Sent(path), in_flight: 1, ..client.worker_options() }
}

#[test]
fn a_program_that_misbehaves_costs_one_warning() {
    let Some(server) = Casd::executing() else { return };
    let cases = [
        ("exit 7", "remote-worker"),
        ("exit 0", "remote-invalid"),
        ("kill -9 $$", "remote-memory"),
        ("sleep 60", "remote-timeout"),
        ("echo '{\"event\":\"failed\",\"message\":\"little\",\"needs\":5}'; exit 1", "remote-memory"),
        ("ln -s /etc/passwd out/entry", "remote-worker"),
        ("mkdir out/entry", "remote-invalid"),
        ("for f in numbers last; do echo x > out/values/$f; done; echo x > out/entry", "remote-invalid"),
    ];
    for (text, id) in cases {
        let client = Client::new(&[]);
        let limit = if id == "remote-timeout" { 1 } else { 60 };
        let options = WorkerOptions { timeout: Some(Duration::from_secs(limit)), ..script(&client, text) };
        let ran = client.send(&server.address(), options);
        assert_eq!(ran.written.as_deref(), Some(WRITTEN), "{text}");
        assert_eq!(
            (ran.ids(), ran.traffic.executed),
            (vec![id, "remote-stopped"], 0),
            "{text}: {:?}",
            ran.warnings
        );
    }
}

#[test]
fn a_real_action_is_cancelled() {
    let Some(server) = Casd::executing() else { return };
    let client = Client::new(&[]);
    let begin = Instant::now();
    let ran = client.send_until(&server.address(), script(&client, "sleep 60"), |event, cancel| {
        if matches!(event, Event::Stage { stage: "queued", .. }) {
            std::thread::sleep(Duration::from_millis(300));
            cancel.store(true, Ordering::Relaxed);
        }
    });
    assert!(ran.outcome.totals.stopped && begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
    // The one process that may run has ended, since another action runs at once.
    let client = Client::new(&[]);
    let ran = client.send(&server.address(), script(&client, "exit 7"));
    assert_eq!(ran.written.as_deref(), Some(WRITTEN));
}

#[test]
fn a_server_that_is_killed_costs_one_warning() {
    let Some(mut server) = Casd::executing() else { return };
    let address = server.address();
    let client = Client::new(&[]);
    let ran = client.send_until(&address, script(&client, "sleep 60"), |event, _| {
        if matches!(event, Event::Stage { stage: "queued", .. }) {
            std::thread::sleep(Duration::from_millis(200));
            server.kill();
        }
    });
    assert_eq!(
        (ran.written.as_deref(), ran.ids()),
        (Some(WRITTEN), vec!["remote-lost"]),
        "{:?}",
        ran.warnings
    );
}
