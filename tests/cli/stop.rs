//! Tests of interrupted runs. Whenever a run is interrupted, its exit code reports the interruption, finished
//! results are kept, and the next run completes.
#![cfg(unix)]

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::{INSERT, Place};

/// Number of times that a run is interrupted; `LIGHTHARMONY_STOPS` sets another number.
fn rounds() -> usize {
    std::env::var("LIGHTHARMONY_STOPS").ok().and_then(|n| n.parse().ok()).unwrap_or(6)
}

#[test]
fn runs_stopped_at_any_moment_keep_what_finished() {
    let undisturbed = Place::new(INSERT);
    let lines = undisturbed.run(&[]).good().events.len();
    let bytes = undisturbed.outputs();
    for round in 0..rounds() {
        let place = Place::new(INSERT);
        let mut child =
            place.command(&["run", "graph.ron", "--json"]).stdout(Stdio::piped()).spawn().unwrap();
        let mut reported = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
        // After this many lines of output, so that the moments spread over a run on a machine of any speed.
        let mut events: Vec<String> = reported.by_ref().take(1 + lines * round / rounds()).collect();
        let signal = ["-INT", "-TERM", "-HUP"][round % 3];
        Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        events.extend(reported);
        let code = child.wait().unwrap().code();
        let events: Vec<Value> = events.iter().map(|line| serde_json::from_str(line).unwrap()).collect();
        let done = events.last().unwrap();
        assert_eq!(done["event"], "done", "{signal}: the end is reported");
        // It may have ended before the signal arrived.
        assert_eq!(code, Some(if done["stopped"] == true { 130 } else { 0 }), "{signal} in round {round}");
        let after = place.run(&[]).good();
        let ran = after.nodes("ran");
        for event in events.iter().filter(|event| event["event"] == "node" && event["state"] == "ran") {
            assert!(!ran.contains(&event["id"].as_str().unwrap()), "{} was finished: {ran:?}", event["id"]);
        }
        assert!(place.outputs() == bytes, "round {round}");
    }
}

#[test]
fn a_reader_that_goes_away_stops_nothing() {
    let place = Place::new(INSERT);
    for arguments in
        [&["run", "graph.ron"][..], &["run", "graph.ron", "--json"], &["plan", "graph.ron", "--json"]]
    {
        let mut child =
            place.command(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        drop(child.stdout.take());
        assert_eq!(child.wait().unwrap().code(), Some(0), "{arguments:?}");
    }
    assert_eq!(place.run(&[]).good().nodes("ran").len(), 0, "all of it was done");
}
