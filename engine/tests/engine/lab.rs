//! A folder, a cache and an engine for running graphs, and a log of the events of a run.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use cache::{Options, Store};
use engine::{Diagnostics, Engine, Event, Graph, Outcome, Registry, RunOptions, Source, SourceRoot, State};

use crate::arithmetic::registry;

/// A folder in which graphs can be run.
pub struct Lab {
    pub folder: tempfile::TempDir,
    pub registry: Registry,
    /// The engine, if the cache is in memory; `None` if each run opens the cache on disk.
    pub memory: Option<Engine>,
    pub jobs: usize,
    pub budget: u64,
    pub options: Options,
}

/// The text of a graph with these nodes and the usual scene.
pub fn graph_text(nodes: &str) -> String {
    format!("Graph(version: 1, scene: (up: \"+z\", seed: 7), nodes: (\n{nodes}\n))\n")
}

impl Lab {
    /// A lab with a cache on disk. Every run reopens the cache, as a new process would.
    pub fn on_disk() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (jobs, budget) = (2, 1 << 30);
        Self { folder, registry: registry(), memory: None, jobs, budget, options: Options::default() }
    }

    /// A lab with a cache in memory.
    pub fn in_memory() -> Self {
        let engine = Engine::new(Store::in_memory(), 2, 1 << 30);
        Self { memory: Some(engine), ..Self::on_disk() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    /// The content of a file that a sink wrote.
    pub fn out(&self, name: &str) -> String {
        std::fs::read_to_string(self.path("out").join(name)).unwrap()
    }

    pub fn cache(&self) -> PathBuf {
        self.path("cache")
    }

    /// Every file inside the cache folder and its subfolders, in order of path.
    pub fn cache_files(&self) -> Vec<PathBuf> {
        let mut found = Vec::new();
        let mut folders = vec![self.cache()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() { folders.push(path) } else { found.push(path) }
            }
        }
        found.sort();
        found
    }

    /// Paths of the files that contain a single large blob each.
    pub fn blob_files(&self) -> Vec<PathBuf> {
        let blobs = self.cache().join("v1/blobs");
        self.cache_files().into_iter().filter(|path| path.starts_with(&blobs)).collect()
    }

    pub fn engine(&self) -> Engine {
        let store = Store::open(&self.cache(), self.options).unwrap();
        Engine::new(store, self.jobs, self.budget)
    }

    pub fn parse(&self, text: &str) -> Result<Graph, Diagnostics> {
        Graph::parse(Source::packed("graph.ron", text), &self.registry, SourceRoot::new(self.folder.path()))
    }

    /// The mistakes of a graph, as printed.
    pub fn mistakes(&self, text: &str) -> String {
        match self.parse(text) {
            Ok(_) => panic!("nothing is wrong with this graph:\n{text}"),
            Err(diagnostics) => diagnostics.render(false),
        }
    }

    /// Runs a graph of the given nodes.
    pub fn run(&self, nodes: &str) -> Log {
        self.run_text(&graph_text(nodes))
    }

    /// Runs a whole graph file.
    pub fn run_text(&self, text: &str) -> Log {
        self.run_only(text, &[])
    }

    /// Runs the named nodes and the nodes that they need.
    pub fn run_only(&self, text: &str, only: &[&str]) -> Log {
        self.run_until(text, only, |_, _| {})
    }

    /// Runs a graph and calls `watch` for every event. `watch` may set the flag that cancels the run.
    pub fn run_until(&self, text: &str, only: &[&str], watch: impl FnMut(&Event, &AtomicBool)) -> Log {
        match &self.memory {
            Some(engine) => self.run_on(engine, text, only, watch),
            None => self.run_on(&self.engine(), text, only, watch),
        }
    }

    /// Runs a graph on a given engine.
    pub fn run_on(
        &self,
        engine: &Engine,
        text: &str,
        only: &[&str],
        mut watch: impl FnMut(&Event, &AtomicBool),
    ) -> Log {
        let graph = self.parse(text).unwrap_or_else(|e| panic!("{e}"));
        let cancel = Arc::new(AtomicBool::new(false));
        let options = RunOptions {
            out: self.path("out"),
            only: only.iter().map(|id| graph.find(id).unwrap()).collect(),
            cancel: cancel.clone(),
            ..RunOptions::default()
        };
        let mut events = Vec::new();
        let outcome = engine.run(&graph, &options, |event| {
            watch(&event, &cancel);
            events.push(event);
        });
        let log = Log { events, outcome };
        log.check();
        log
    }
}

/// The events of a run.
pub struct Log {
    pub events: Vec<Event>,
    pub outcome: Outcome,
}

impl Log {
    /// Checks the invariants of every run: each node ends once, and the totals agree with the events.
    fn check(&self) {
        let mut ends: BTreeMap<&str, State> = BTreeMap::new();
        for event in &self.events {
            if let Event::Node { id, state, error, key, .. } = event {
                let done = matches!(state, State::Ran | State::Cached);
                assert_eq!(error.is_some(), *state == State::Failed, "{id}");
                assert!(key.is_some() || !done, "{id}");
                let before = ends.insert(id, *state);
                // Only the result of a node that must run again and cannot is withdrawn.
                assert!(before.is_none() || *state == State::Failed, "{id}: {before:?}, then {state:?}");
            }
        }
        let totals = &self.outcome.totals;
        let count = |state: State| ends.values().filter(|end| **end == state).count();
        let counts = [State::Ran, State::Cached, State::Failed, State::Skipped].map(count);
        assert_eq!(counts, [totals.ran, totals.cached, totals.failed, totals.skipped]);
        assert_eq!(totals.failed > 0, self.outcome.failures.is_some());
        assert!(
            matches!(self.events.last(), Some(Event::Done(done)) if done == totals),
            "the end comes last"
        );
    }

    fn in_state(&self, wanted: State) -> String {
        let mut ids: Vec<&str> = self
            .events
            .iter()
            .filter_map(|event| match event {
                Event::Node { id, state, .. } if *state == wanted => Some(id.as_str()),
                _ => None,
            })
            .collect();
        ids.sort_unstable();
        ids.join(" ")
    }

    /// Names of the nodes whose code ran, in alphabetical order.
    pub fn ran(&self) -> String {
        self.in_state(State::Ran)
    }

    pub fn cached(&self) -> String {
        self.in_state(State::Cached)
    }

    pub fn failed(&self) -> String {
        self.in_state(State::Failed)
    }

    pub fn skipped(&self) -> String {
        self.in_state(State::Skipped)
    }

    pub fn exit_code(&self) -> u8 {
        self.outcome.totals.exit_code()
    }

    /// Names of the nodes that ran again because their values were needed.
    pub fn remade(&self) -> String {
        let mut ids: Vec<&str> = self
            .events
            .iter()
            .filter_map(|event| match event {
                Event::Remake { id, .. } => Some(id.as_str()),
                _ => None,
            })
            .collect();
        ids.sort_unstable();
        ids.join(" ")
    }

    /// Names of the output files. A star marks the files that were written.
    pub fn files(&self) -> String {
        let mut names: Vec<String> = self
            .events
            .iter()
            .filter_map(|event| match event {
                Event::File { path, written, .. } => {
                    let name = path.file_name().unwrap().to_string_lossy();
                    Some(format!("{name}{}", if *written { "*" } else { "" }))
                }
                _ => None,
            })
            .collect();
        names.sort_unstable();
        names.join(" ")
    }

    /// Ids and texts of the warnings of the engine.
    pub fn warnings(&self) -> Vec<(&'static str, String)> {
        self.events
            .iter()
            .filter_map(|event| match event {
                Event::Warning { id, text } => Some((*id, text.clone())),
                _ => None,
            })
            .collect()
    }

    /// Number of parts that ran, and number of parts that came from the cache.
    pub fn parts(&self) -> (usize, usize) {
        let count = |wanted: State| {
            self.events
                .iter()
                .filter(|event| matches!(event, Event::Part { state, .. } if *state == wanted))
                .count()
        };
        (count(State::Ran), count(State::Cached))
    }

    /// The keys of the nodes of a graph in this run, by index.
    pub fn keys_in(&self, graph: &Graph) -> impl Fn(usize) -> Option<engine::Digest> {
        let all: Vec<Option<engine::Digest>> = (graph.nodes.iter())
            .map(|node| {
                self.events.iter().rev().find_map(|event| match event {
                    Event::Node { id, key, .. } if *id == node.id => *key,
                    _ => None,
                })
            })
            .collect();
        move |index| all[index]
    }

    /// The name and key of every node that has a key, sorted by name.
    pub fn keys(&self) -> Vec<(String, String)> {
        let mut keys: Vec<_> = self
            .events
            .iter()
            .filter_map(|event| match event {
                Event::Node { id, key: Some(key), .. } => Some((id.clone(), key.to_string())),
                _ => None,
            })
            .collect();
        keys.sort();
        keys
    }

    /// The errors of the run, as printed.
    pub fn failures(&self) -> String {
        self.outcome.failures.as_ref().map(|failures| failures.render(false)).unwrap_or_default()
    }

    /// All notes of a node: level, id, text.
    pub fn notes(&self, wanted: &str) -> Vec<String> {
        self.events
            .iter()
            .filter_map(|event| match event {
                Event::Node { id, notes, .. } if id == wanted => Some(notes),
                _ => None,
            })
            .flatten()
            .map(|note| format!("{:?} {}: {}", note.level, note.id, note.text))
            .collect()
    }
}
