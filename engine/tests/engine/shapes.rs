//! Tests of large graphs: no code recurses over the nodes, and the time grows linearly with their number.

use std::time::{Duration, Instant};

use crate::lab::{Lab, graph_text};

/// CPU time of this thread, on which the scheduler runs. If the system does not report CPU time, the wall time
/// since `start`.
pub fn spent(start: Instant) -> Duration {
    let reported = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanos = reported.and_then(|text| text.split(' ').next()?.parse().ok());
    nanos.map_or_else(|| start.elapsed(), Duration::from_nanos)
}

/// Parses a graph and runs it twice in memory, first with an empty cache. Returns the CPU time of this thread for
/// each of the three steps.
fn times(nodes: &str, count: usize) -> [Duration; 3] {
    let lab = Lab::in_memory();
    let text = graph_text(nodes);
    let start = Instant::now();
    let before = spent(start);
    let graph = lab.parse(&text).unwrap_or_else(|e| panic!("{}", &e.render(false)[..1000]));
    let parsed = spent(start) - before;
    assert_eq!(graph.nodes.len(), count);
    let run = || {
        let before = spent(start);
        let log = lab.run_text(&text);
        (log.outcome.totals, spent(start) - before)
    };
    let ((cold, cold_time), (warm, warm_time)) = (run(), run());
    assert_eq!((cold.ran, cold.failed + cold.skipped), (count, 0));
    assert_eq!((warm.ran, warm.cached), (0, count));
    [parsed, cold_time, warm_time]
}

/// Checks that ten times as many nodes take about ten times as long, not a hundred times. Other load on the machine
/// can only lengthen a measurement, so the smallest of several measurements is used. Work that grows faster than
/// linearly fails the check, since it is slow in every measurement.
fn assert_linear(times: impl Fn(usize) -> [Duration; 3], count: usize) {
    let small = times(count);
    let allowed = small.map(|small| small.max(Duration::from_millis(2)) * 40);
    let mut large = times(10 * count);
    for _ in 0..4 {
        if large.iter().zip(&allowed).all(|(large, allowed)| large < allowed) {
            return;
        }
        for (least, again) in large.iter_mut().zip(times(10 * count)) {
            *least = (*least).min(again);
        }
    }
    assert!(large.iter().zip(&allowed).all(|(large, allowed)| large < allowed), "{large:?} after {small:?}");
}

fn chain(count: usize) -> String {
    let below = (1..count).map(|n| format!("n{n}: Add(terms: [\"n{}\"], bias: 0.5),\n", n - 1));
    std::iter::once("n0: Number(),\n".to_owned()).chain(below).collect()
}

/// A graph with one node that all other nodes read, and one node that reads all others.
fn fan(count: usize) -> String {
    let middle = 1..count - 1;
    let rays: String = middle.clone().map(|n| format!("n{n}: Scale(value: \"n0\", by: {n}e-4),\n")).collect();
    let names: Vec<String> = middle.map(|n| format!("\"n{n}\"")).collect();
    format!("n0: Number(),\n{rays}sum: Add(terms: [{}]),\n", names.join(", "))
}

/// A graph in which two paths lead from each node to the next, so that there are 2^n paths in total.
fn diamonds(count: usize) -> String {
    let below = (1..count).map(|n| {
        let (near, far) = (n - 1, n.saturating_sub(2));
        format!("n{n}: Add(terms: [\"n{near}\", \"n{far}\"], bias: -{n}.0),\n")
    });
    std::iter::once("n0: Number(),\n".to_owned()).chain(below).collect()
}

/// An empty graph is reported as a mistake, so every run has at least one node.
#[test]
fn no_nodes_is_a_mistake() {
    assert!(Lab::in_memory().mistakes(&graph_text("")).contains("the graph has no nodes"));
}

#[test]
fn a_chain_of_a_hundred_thousand_nodes() {
    // On a stack of the size that threads have: a walk that recurses overflows it.
    assert_linear(|count| times(&chain(count), count), 10_000);
}

#[test]
fn a_fan_and_a_node_that_reads_it_all() {
    assert_linear(|count| times(&fan(count), count), 2_000);
}

#[test]
fn diamonds_are_walked_once() {
    assert_linear(|count| times(&diamonds(count), count), 1_500);
}

#[test]
fn a_failure_at_the_top_skips_a_whole_chain() {
    let lab = Lab::in_memory();
    let chain =
        chain(50_000).replace("n1: Add(terms: [\"n0\"], bias: 0.5)", "n1: Refuse(value: \"n0\", above: 0.0)");
    let log = lab.run(&chain);
    let totals = &log.outcome.totals;
    assert_eq!((totals.ran, totals.failed, totals.skipped), (1, 1, 49_998));
}

#[test]
fn a_chain_whose_values_are_gone_is_made_again() {
    let lab = Lab::on_disk();
    let nodes = chain(3_000);
    lab.run(&nodes);
    std::fs::remove_file(lab.cache().join("v1/blobs.log")).unwrap();
    let log = lab.run(&format!("{nodes} last: Scale(value: \"n2999\")"));
    assert_eq!((log.ran().as_str(), log.remade().split(' ').count()), ("last", 3_000));
}
