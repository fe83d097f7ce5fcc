//! Tests that kill a run with `kill -9` at any moment. The next run completes and writes the same bytes as a run
//! that was not killed.

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use crate::{INSERT, Place};

/// Number of times that a run with an empty cache is killed; `LIGHTHARMONY_KILLS` sets another number.
fn rounds() -> usize {
    std::env::var("LIGHTHARMONY_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(8)
}

/// Kills a run after it has printed `lines` lines. Unlike times, numbers of lines are spread over the run on a
/// machine of any speed.
fn kill_after(place: &Place, lines: usize) {
    let mut command = place.command(&["run", "graph.ron", "--json"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let reported = BufReader::new(child.stdout.take().unwrap()).lines().take(lines).count();
    // It may have ended before.
    let _ = child.kill();
    child.wait().unwrap();
    assert!(reported <= lines);
}

#[test]
fn killed_runs_leave_nothing_wrong_behind() {
    let undisturbed = Place::new(INSERT);
    let lines = undisturbed.run(&[]).good().events.len();
    let bytes = undisturbed.outputs();
    for round in 0..rounds() {
        // Two kills in a row: the second one also meets what the first one left.
        let place = Place::new(INSERT);
        for attempt in 0..2 {
            kill_after(&place, lines * (round * 2 + attempt) / (rounds() * 2));
        }
        let after = place.run(&[]).good();
        assert!(place.outputs() == bytes, "round {round}");
        assert!(after.events.iter().all(|event| event["id"] != "cache-damage"), "nothing was damaged");
    }
}

/// A graph with a picture, a report and a few blobs. It writes files of all types within milliseconds.
const TINY: &str = r#"Graph(
    version: 1,
    scene: (up: "+z", seed: 3),
    nodes: (
        light:  LoadEnvironment(path: "light.hdr"),
        double: LoadEnvironment(path: "light.hdr", scale: 2.0),
        score:  Compare(image: "light.image", reference: "double.image"),
        save:   WriteExr(image: "score.difference", path: "difference.exr"),
        report: WriteReport(report: "score.report", path: "score.md"),
    ),
)
"#;

fn tiny() -> Place {
    let place = Place::new(TINY);
    let mut light = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n".to_vec();
    light.extend((0..16 * 32).flat_map(|n: u32| [40 + (n % 97) as u8, 90, 60 + (n / 4) as u8, 128]));
    std::fs::write(place.path("light.hdr"), light).unwrap();
    place
}

#[test]
fn runs_stopped_at_every_failpoint_leave_nothing_wrong_behind() {
    let undisturbed = tiny();
    undisturbed.run(&[]).good();
    let bytes = undisturbed.outputs();
    let mut stopped = 0;
    for name in cache::failpoint::NAMES {
        for count in [1, 3] {
            let place = tiny();
            let status = place
                .command(&["run", "graph.ron"])
                .env("LIGHTHARMONY_FAILPOINT", format!("{name}:{count}"))
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status()
                .unwrap();
            // A failpoint that is not reached once is not reached three times.
            if status.success() {
                break;
            }
            stopped += 1;
            place.run(&[]).good();
            assert!(place.outputs() == bytes, "{name}:{count}");
        }
    }
    assert!(stopped >= 20, "only {stopped} runs met their failpoint");
}
