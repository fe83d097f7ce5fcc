//! Measures the time of a run with nothing to do, stage by stage, in a new process.
//!
//! `noop SHAPE NODES FOLDER` makes a graph (`chain`, `fan` or `grid`) and runs it on the cache in FOLDER. The first
//! time, all nodes run. The second time, no node has to run, and the printed times show how long it takes to find
//! that out.
#![allow(clippy::print_stdout, reason = "this is what the program is for")]
#![allow(missing_docs, dead_code, reason = "kinds of the tests")]

#[path = "../tests/engine/arithmetic/mod.rs"]
mod arithmetic;

use std::error::Error;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use engine::{Engine, Graph, RunOptions, Source, SourceRoot};

/// A graph file of about `count` nodes.
fn graph(shape: &str, count: usize) -> String {
    let mut text = String::from("Graph(version: 1, scene: (up: \"+z\", seed: 7), nodes: (\n");
    let mut node = |id: usize, what: String| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "    n{id}: {what},");
    };
    node(0, "Number(value: 1.5)".to_owned());
    let side = count.isqrt().max(1);
    for id in 1..count {
        match shape {
            "chain" => node(id, format!("Add(terms: [\"n{}\"], bias: {id}.0)", id - 1)),
            "grid" if id >= side => {
                node(id, format!("Add(terms: [\"n{}\", \"n{}\"], bias: {id}.0)", id - 1, id - side));
            }
            _ if id + 1 < count => node(id, format!("Scale(value: \"n0\", by: {:?})", id as f64 / 1e4)),
            _ => {
                let all: Vec<String> = (0..id).map(|n| format!("\"n{n}\"")).collect();
                node(id, format!("Add(terms: [{}])", all.join(", ")));
            }
        }
    }
    text + "))\n"
}

/// Processor time of all threads so far, in milliseconds.
fn cpu_ms() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let spent = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("schedstat")).ok());
    spent.filter_map(|text| text.split(' ').next()?.parse::<f64>().ok()).sum::<f64>() / 1e6
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let shape = arguments.next().unwrap_or_else(|| "chain".to_owned());
    let count = arguments.next().unwrap_or_else(|| "10000".to_owned()).parse()?;
    let folder =
        arguments.next().map_or_else(|| std::env::temp_dir().join("lightharmony-noop"), PathBuf::from);
    let source = Source::new(format!("{shape}-{count}.ron"), graph(&shape, count));
    let mut stages = Vec::new();
    let (mut cpu, mut wall) = (cpu_ms(), Instant::now());
    let mut stage = |name: &'static str| {
        let now = cpu_ms();
        stages.push(format!("{name} {:.1} ({:.1} CPU)", wall.elapsed().as_secs_f64() * 1e3, now - cpu));
        (cpu, wall) = (now, Instant::now());
    };
    let store = cache::Store::open(&folder.join("cache"), cache::Options::default())?;
    let engine = Engine::new(store, 2, 1 << 30);
    stage("open");
    let root = SourceRoot::new(&folder);
    let graph =
        Graph::parse(source, &arithmetic::registry(), root).map_err(|mistakes| mistakes.render(false))?;
    stage("parse and check");
    let outcome = engine.run(&graph, &RunOptions::default(), |_| {});
    stage("run");
    drop(graph);
    drop(engine);
    stage("close");
    let totals = outcome.totals;
    println!("{shape} {count}: ran {}, cached {}; ms: {}", totals.ran, totals.cached, stages.join(", "));
    Ok(())
}
