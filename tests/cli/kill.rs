//! `kill -9` at any moment: every following run completes with the bytes of an undisturbed one.

use std::process::Stdio;
use std::time::{Duration, Instant};

use crate::{INSERT, Place};

/// How often a cold run is killed. The issue asks for 50; `LIGHTHARMONY_KILLS` sets another number.
fn rounds() -> u32 {
    std::env::var("LIGHTHARMONY_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(12)
}

#[test]
fn killed_runs_leave_nothing_wrong_behind() {
    let undisturbed = Place::new(INSERT);
    let start = Instant::now();
    undisturbed.run(&[]).good();
    let whole = start.elapsed();
    let bytes = undisturbed.outputs();
    let rounds = rounds();
    let mut cut_short = 0;
    for round in 0..rounds {
        // Two kills in a row: the second one also meets what the first one left.
        let place = Place::new(INSERT);
        for attempt in 0..2 {
            let mut child = place
                .command(&["run", "graph.ron"])
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            let share = f64::from(round * 2 + attempt + 1) / f64::from(rounds * 2 + 1);
            std::thread::sleep(Duration::from_secs_f64(whole.as_secs_f64() * share));
            cut_short += u32::from(child.try_wait().unwrap().is_none());
            child.kill().unwrap();
            child.wait().unwrap();
        }
        let after = place.run(&[]).good();
        assert!(place.outputs() == bytes, "round {round}");
        assert!(after.events.iter().all(|event| event["id"] != "cache-damage"), "nothing was damaged");
    }
    assert!(cut_short * 3 > rounds, "only {cut_short} of {} runs were cut short", rounds * 2);
}

#[test]
#[cfg(feature = "failpoints")]
fn runs_stopped_at_every_failpoint_leave_nothing_wrong_behind() {
    let undisturbed = Place::new(INSERT);
    undisturbed.run(&[]).good();
    let bytes = undisturbed.outputs();
    let mut stopped = 0;
    for name in cache::failpoint::NAMES {
        for count in [1, 3] {
            let place = Place::new(INSERT);
            let status = place
                .command(&["run", "graph.ron"])
                .env("LIGHTHARMONY_FAILPOINT", format!("{name}:{count}"))
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status()
                .unwrap();
            stopped += u32::from(!status.success());
            place.run(&[]).good();
            assert!(place.outputs() == bytes, "{name}:{count}");
        }
    }
    assert!(stopped >= 20, "only {stopped} runs met their failpoint");
}
