//! Tests of the assignment of threads to nodes: small nodes do not wait for large nodes to end.

use engine::{Event, State};

use crate::lab::{Lab, Log};

/// The position in the log of the event that reports that a node ran.
fn done(log: &Log, wanted: &str) -> usize {
    let is = |event: &Event| matches!(event, Event::Node { id, state: State::Ran, .. } if id == wanted);
    log.events.iter().position(is).unwrap_or_else(|| panic!("`{wanted}` ran"))
}

// This test fails if all nodes share one thread (`most` in `Workers::new`). A test next to `Threads::join` checks
// that helpers stop after their current tile.
#[test]
fn a_small_node_does_not_wait_for_the_tiles_of_a_large_one() {
    for jobs in [1, 2, 3] {
        let lab = Lab { jobs, ..Lab::on_disk() };
        lab.run("a: Number(), s: Slow(value: \"a\", millis: 5), t: Tiled(value: \"a\", tiles: 2)");
        // Small nodes one after the other, the last with tiles of its own, while the tiles of `big` take a second.
        let log = lab.run(
            "a: Number(), big: Tiled(value: \"a\", tiles: 200, millis: 10),
             b: Slow(value: \"a\", millis: 50), c: Slow(value: \"b\", millis: 20),
             d: Tiled(value: \"c\", tiles: 4), w: Scale(value: \"d\")",
        );
        assert!(done(&log, "w") < done(&log, "big"), "{jobs} threads");
    }
}

// This test fails if `Line::next` ignores short nodes, or if all nodes share one thread.
#[test]
fn a_short_node_runs_though_large_ones_have_every_thread() {
    let lab = Lab { jobs: 2, ..Lab::on_disk() };
    // How long a unit of work takes is known from here on.
    lab.run("a: Number(), s: Slow(value: \"a\", millis: 20)");
    let log = lab.run(
        "a: Number(),
         one: Slow(value: \"a\", millis: 1500), two: Slow(value: \"one\", millis: 1600),
         three: Slow(value: \"a\", millis: 2500), four: Slow(value: \"a\", millis: 2600),
         b: Slow(value: \"a\", millis: 50), c: Slow(value: \"b\", millis: 20),
         w: Scale(value: \"c\")",
    );
    for long in ["one", "two", "three", "four"] {
        assert!(done(&log, "w") < done(&log, long), "{long}");
    }
}

// This test fails if `Line::first_small` ignores nodes without a forecast.
#[test]
fn a_small_node_without_a_forecast_runs_though_large_ones_have_every_thread() {
    // The cache is empty, so no kind has a forecast.
    let lab = Lab { jobs: 2, ..Lab::on_disk() };
    let log = lab.run(
        "a: Number(),
         one: Slow(value: \"a\", millis: 2500), two: Slow(value: \"a\", millis: 2600),
         three: Slow(value: \"a\", millis: 2700), four: Slow(value: \"a\", millis: 2800),
         b: Tiled(value: \"a\", tiles: 4), c: Tiled(value: \"b\", tiles: 8), w: Scale(value: \"c\")",
    );
    for long in ["one", "two", "three", "four"] {
        assert!(done(&log, "w") < done(&log, long), "{long}");
    }
}
