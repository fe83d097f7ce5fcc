//! A client: a cache on disk, keys, and runs of one graph.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use cache::{Options, Store};
use engine::{Engine, Event, Graph, Outcome, RunOptions, Source, SourceRoot, State};
use tempfile::TempDir;

use crate::credentials::Credentials;
use crate::reapi::{
    CallError, Retry, ServerWorkers, SharedCache, SharedCacheOptions, Traffic, WorkerOptions, WorkerProgram,
};
use crate::secret_key::SecretKey;
use crate::testing::registry;
use crate::trusted_keys::TrustedKeys;

/// The graph: values of 1.2 MB, which are streamed, and small ones. `w` needs only small ones.
pub const GRAPH: &str = "Graph(version: 1, scene: (up: \"+z\"), nodes: (
    n: Count(to: 300000),
    d: Double(of: \"n\"),
    e: Double(of: \"n.last\"),
    w: WriteNumbers(of: \"e\", path: \"w.txt\"),
))";

/// The text that the sink of the graph writes.
pub const WRITTEN: &str = "599998\n";

/// A client with an empty cache.
pub struct Client {
    pub folder: TempDir,
    pub publish: bool,
    pub fallback: bool,
    pub credentials: Credentials,
    pub retry: Retry,
}

/// A run and its effects.
pub struct Ran {
    pub outcome: Outcome,
    /// The names of the nodes that ran, in order.
    pub ran: String,
    pub warnings: Vec<(&'static str, String)>,
    pub traffic: Traffic,
    /// The file that the sink wrote.
    pub written: Option<String>,
}

impl Ran {
    /// Ids of the warnings.
    pub fn ids(&self) -> Vec<&'static str> {
        self.warnings.iter().map(|(id, _)| *id).collect()
    }
}

impl Client {
    /// A client with a key of its own, which trusts itself and `others`.
    pub fn new(others: &[&Client]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let retry = Retry {
            attempts: 3,
            pause: Duration::from_millis(5),
            limit: Duration::from_millis(800),
            ..Retry::default()
        };
        let credentials = Credentials::default();
        let client = Self { folder, publish: false, fallback: true, credentials, retry };
        let key = SecretKey::create(&client.path("key"), "client").expect("a key");
        let mut trusted = client.trusted();
        trusted.trust(&key.public()).expect("trusts");
        for other in others {
            trusted.trust(&other.key().public()).expect("trusts");
        }
        client
    }

    pub fn publishing(self) -> Self {
        Self { publish: true, ..self }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn key(&self) -> SecretKey {
        SecretKey::read(&self.path("key")).expect("the key")
    }

    pub fn trusted(&self) -> TrustedKeys {
        TrustedKeys::read(&self.path("trusted")).expect("the list")
    }

    /// Empties the cache and the output folder.
    pub fn forget(&self) {
        for name in ["cache", "out"] {
            let _ = std::fs::remove_dir_all(self.path(name));
        }
    }

    pub fn engine(&self) -> Engine {
        let store = Store::open(&self.path("cache"), Options::default()).expect("a cache");
        Engine::new(store, 2, 1 << 30)
    }

    pub fn graph(&self) -> Graph {
        Graph::parse(Source::new("graph.ron", GRAPH), &registry(), SourceRoot::new("."))
            .unwrap_or_else(|error| panic!("{error}"))
    }

    pub fn connect(&self, address: &str) -> Result<SharedCache, CallError> {
        let options = SharedCacheOptions {
            address: address.parse().expect("an address"),
            credentials: self.credentials.clone(),
            trusted: self.trusted(),
            publish_as: self.publish.then(|| self.key()),
            fallback: self.fallback,
            retry: self.retry,
        };
        SharedCache::connect(options, &AtomicBool::new(false))
    }

    /// Runs the graph with the server.
    pub fn run(&self, address: &str) -> Ran {
        self.run_until(address, |_, _| {})
    }

    /// Runs the graph and calls `watch` for every event. `watch` may set the flag that cancels the run.
    pub fn run_until(&self, address: &str, watch: impl FnMut(&Event, &AtomicBool)) -> Ran {
        let shared = Arc::new(self.connect(address).unwrap_or_else(|error| panic!("{error}")));
        let ran = self.run_on(&self.engine().sharing(shared.clone()), watch);
        Ran { traffic: shared.traffic(), ..ran }
    }

    /// Settings for the workers of the small server, which do not run the program that is sent.
    pub fn worker_options(&self) -> WorkerOptions {
        let program = self.path("program");
        std::fs::write(&program, "a program").expect("writes");
        WorkerOptions {
            program: WorkerProgram::Sent(program),
            arguments: vec!["action".to_owned()],
            properties: Vec::new(),
            memory: None,
            in_flight: 4,
            priority: 0,
            timeout: None,
            checked: 0.0,
            canary: None,
        }
    }

    /// Runs the graph with the workers of a server.
    pub fn send(&self, address: &str, options: WorkerOptions) -> Ran {
        self.send_until(address, options, |_, _| {})
    }

    /// Runs the graph with the workers of a server and calls `watch` for every event.
    pub fn send_until(
        &self,
        address: &str,
        options: WorkerOptions,
        watch: impl FnMut(&Event, &AtomicBool),
    ) -> Ran {
        let engine = self.engine();
        let shared = self.connect(address).unwrap_or_else(|error| panic!("{error}"));
        let shared = Arc::new(shared.remember_in(engine.shared_store()));
        let workers = ServerWorkers::new(shared.clone(), options).unwrap_or_else(|error| panic!("{error}"));
        let engine = engine.sharing(shared.clone()).sending(Arc::new(workers));
        let ran = self.run_on(&engine, watch);
        Ran { traffic: shared.traffic(), ..ran }
    }

    /// Runs the graph without a server.
    pub fn run_alone(&self) -> Ran {
        self.run_on(&self.engine(), |_, _| {})
    }

    pub fn run_on(&self, engine: &Engine, watch: impl FnMut(&Event, &AtomicBool)) -> Ran {
        self.run_with(engine, |_| {}, watch)
    }

    /// Runs the graph. `begin` receives the flag that cancels the run.
    pub fn run_with(
        &self,
        engine: &Engine,
        begin: impl FnOnce(Arc<AtomicBool>),
        mut watch: impl FnMut(&Event, &AtomicBool),
    ) -> Ran {
        let graph = self.graph();
        let cancel = Arc::new(AtomicBool::new(false));
        begin(cancel.clone());
        let only = (0..graph.nodes.len()).collect();
        let options =
            RunOptions { out: self.path("out"), only, cancel: cancel.clone(), ..RunOptions::default() };
        let (mut names, mut warnings) = (Vec::new(), Vec::new());
        let outcome = engine.run(&graph, &options, |event| {
            watch(&event, &cancel);
            match event {
                Event::Node { id, state: State::Ran, .. } => names.push(id),
                Event::Warning { id, text } => warnings.push((id, text)),
                _ => {}
            }
        });
        names.sort();
        let written = std::fs::read_to_string(self.path("out/w.txt")).ok();
        Ran { outcome, ran: names.join(" "), warnings, traffic: Traffic::default(), written }
    }
}
