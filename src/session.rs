//! What most verbs begin with: a checked graph, a store, threads.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use cache::{Fsync, Store, TempFolder};
use clap::Args;
use engine::{Diagnostics, EditError, Engine, Graph, ReadFiles, Registry, Setting, Source, SourceRoot};

use crate::origin::{Origin, OriginArgs, is_picture};
use crate::report::{self, names};

/// Why a verb cannot begin. Exit code 2.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The graph file, or one that goes with it, cannot be read.
    #[error("cannot read the {what} `{}`: {source}", path.display())]
    Read { what: &'static str, path: PathBuf, source: std::io::Error },
    /// The graph file has mistakes.
    #[error("{0}")]
    Graph(Diagnostics),
    /// A `--set` does not fit.
    #[error("{}", .0.join("\n"))]
    Edit(Vec<String>),
    /// A node that is not there.
    #[error("the graph has no node `{name}`{hint}; its nodes are {known}")]
    Node { name: String, hint: String, known: String },
    /// The name of what is no node.
    #[error("`{name}` is no node but gathers `{of}`; name that, or what reads `{name}`")]
    Gather { name: String, of: String },
    /// A node that axes multiply, where one is wanted.
    #[error("`{name}` is several nodes; name one of {known}")]
    Several { name: String, known: String },
    /// A kind that is not there.
    #[error("no kind is named `{name}`{hint}")]
    Kind { name: String, hint: String },
    /// The cache folder cannot be used.
    #[error(
        "cannot open the cache `{}`: {why}; name another folder with `--cache` or LIGHTHARMONY_CACHE",
        folder.display()
    )]
    OpenCache { folder: PathBuf, why: String },
    /// A file cannot be written, or the cache not be cared for: what was tried on which path, and why not.
    #[error("{0}")]
    Cache(String),
    /// The machine gives no home folder to keep a cache in.
    #[error("no folder for the cache is known; name one with `--cache` or LIGHTHARMONY_CACHE")]
    NoCacheFolder,
    /// Something to watch that cannot change.
    #[error("{0}")]
    Unwatchable(&'static str),
    /// A time that is none.
    #[error("`{0}` is not a time; write a number with ms, s, m, h or d, such as 10s, 1.5h or 30d")]
    Time(String),
    /// A cache that is not there.
    #[error("there is no cache in `{}`", .0.display())]
    NoCache(PathBuf),
    /// A file that is not there.
    #[error("cannot open `{}`: {source}", path.display())]
    Open { path: PathBuf, source: std::io::Error },
    /// A bundle that is not sound, or cannot be made.
    #[error("`{}`: {source}", path.display())]
    Bundle { path: PathBuf, source: engine::BundleError },
    /// A picture whose recipe cannot run.
    #[error("`{}`: {source}", path.display())]
    Recipe { path: PathBuf, source: engine::RecipeError },
    /// A picture that another version made.
    #[error(
        "`{}` cannot be made again here:\n{}\nrun it all the same with --other-versions, and it may come out otherwise",
        path.display(),
        other.join("\n")
    )]
    Versions { path: PathBuf, other: Vec<String> },
    /// Files beside those that a recipe names.
    #[error("`{}` was made from other files:\n{}", path.display(), other.join("\n"))]
    OtherSources { path: PathBuf, other: Vec<String> },
    /// `--inputs` for a graph of one's own.
    #[error("--inputs is for bundles and pictures; the paths in a graph file are relative to its folder")]
    Inputs,
    /// A file that a graph reads cannot be read.
    #[error("{0}")]
    Sources(engine::NodeError),
    /// An error or a time for a graph that takes no samples.
    #[error(
        "no node of this graph takes samples that an error or a time could bound; `path-trace` does, where its `samples` do not vary along an axis"
    )]
    NoSamples,
    /// A graph that is not what its lock says.
    #[error("the graph is not what its lock says:\n{}\n`lightharmony lock` writes a new one", .0.join("\n"))]
    Locked(Vec<String>),
    /// A graph whose lock was not written.
    #[error("there is no lock `{}`; `lightharmony lock` writes it", .0.display())]
    Unlocked(PathBuf),
    /// A graph that has no place for a lock.
    #[error("this graph has no place for a lock; name a file with --to")]
    NoLock,
    /// A lock that is none.
    #[error(transparent)]
    Lock(#[from] engine::LockError),
    /// A file that would be overwritten.
    #[error("`{}` is there already", .0.display())]
    Exists(PathBuf),
    /// A file to write that the graph is made of.
    #[error("`{}` is the graph or a file that it reads; name another one to write", .0.display())]
    IsRead(PathBuf),
    /// A stranger's overlay for a graph of one's own.
    #[error(
        "`{}` came out of a bundle and could have this graph read anything; remove `.lightharmony-bundle` from its folder to make it your own",
        .0.display()
    )]
    Strange(PathBuf),
    /// A graph that is too large to draw.
    #[error("this graph is too large to draw here; `--format dot` leaves that to Graphviz")]
    TooLarge,
    /// A size that is none.
    #[error("`{0}` is not a size; write a number with K, M or G, such as 4G")]
    Size(String),
    /// A measure that is none.
    #[error(
        "`{text}` is no measure of error; write one of {known}, with `touched.`, `object.` or `shadow.` in front for what the object changes, covers, or only shades and lights"
    )]
    Metric { text: String, known: String },
    /// A bound that is none.
    #[error(
        "`{text}` is no bound of an error; write METRIC=VALUE, such as flip=0.02, with a value of 0 or more and one of {known}, with `touched.`, `object.` or `shadow.` in front for what the object changes, covers, or only shades and lights"
    )]
    Bound { text: String, known: String },
    /// A cost that is none.
    #[error("{option} must be a number above 0, and is {value}")]
    NoCost { option: &'static str, value: f64 },
    /// `tune` without a goal.
    #[error("say what is wanted: --max-error flip=0.02, --max-seconds 10 or --max-work 1e8")]
    NoGoal,
    /// Nothing to compare.
    #[error(
        "no picture comes to what is wanted of this graph, so there is nothing to compare; name a node that makes one with --only"
    )]
    NoPicture,
    /// Nothing to turn.
    #[error(
        "no knob reaches `{0}`, so every setting gives the same picture; `lightharmony knobs` lists what can be turned, and a graph's own `reference` preset may set anything else"
    )]
    NoKnob(String),
    /// A measure that does not exist for these pictures.
    #[error("`{metric}` cannot be computed of every picture here; it needs {why}")]
    NotComputed { metric: String, why: &'static str },
    /// A graph that does not run at some setting.
    #[error("with the setting {setting}:\n{why}")]
    Setting { setting: String, why: String },
    /// Ctrl-C cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signal(#[from] ctrlc::Error),
    /// Standard output is closed or full.
    #[error("cannot write: {0}")]
    Output(#[from] std::io::Error),
}

impl From<cache::Error> for Error {
    fn from(error: cache::Error) -> Self {
        Self::Cache(causes(error))
    }
}

/// The chain of causes: what was tried on which path, and what the system said.
fn causes(error: cache::Error) -> String {
    engine::NodeError::from(error).to_string()
}

/// Which graph, with which values in place of those written in it.
#[derive(Debug, Args)]
pub struct GraphArgs {
    /// The graph file (RON), a bundle, or a picture that carries its recipe; `-` reads standard input
    pub graph: PathBuf,
    /// Sets one field for this run: node.field=value, as often as needed
    #[arg(long = "set", value_name = "NODE.FIELD=VALUE")]
    pub set: Vec<String>,
    /// Lays a preset over the graph, as often as needed: one of its own, or draft, preview, final, reference, which
    /// set its knobs; `--overlay` and `--set` go over presets
    #[arg(long, value_name = "NAME")]
    pub preset: Vec<String>,
    /// Lays the values of a file over the graph, as often as needed: Overlay(nodes: (trace: (samples: 4)))
    #[arg(long, value_name = "FILE")]
    pub overlay: Vec<PathBuf>,
    /// Only these nodes and what they need, separated by commas; default: every sink
    #[arg(long, value_name = "NODES", value_delimiter = ',')]
    pub only: Vec<String>,
    // Not flattened from `OriginArgs`: an optional `GraphArgs` is there only if clap sees an argument of its own.
    /// For a bundle or a picture: a folder whose files the graph may read, as often as needed
    #[arg(long, value_name = "DIR")]
    pub inputs: Vec<PathBuf>,
    /// For a picture: run it although its kinds have other versions here, which may give another picture
    #[arg(long)]
    pub other_versions: bool,
}

/// Where results are kept and what may be used.
#[derive(Debug, Clone, Args)]
pub struct EngineArgs {
    /// Folder of the cache [env: LIGHTHARMONY_CACHE; default: the user's cache folder]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Threads; default, and 0: one for each core
    #[arg(long, short, value_name = "N", value_parser = clap::value_parser!(u16).range(..=1024))]
    pub jobs: Option<u16>,
    /// Memory for values and running nodes, such as 4G; default, and 0: three quarters of what is free. Nodes wait
    /// for their share, and one that would need more than all of it fails before it starts
    #[arg(long, value_name = "SIZE")]
    pub memory: Option<String>,
    /// When results are forced onto the disk; it matters to a loss of power only
    #[arg(long, value_name = "WHEN", default_value = "batch")]
    pub fsync: When,
}

/// When results are forced onto the disk.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum When {
    /// Once, at the end of a run
    Batch,
    /// After every result
    Always,
    /// Never
    Off,
}

/// A checked graph and the nodes that are wanted of it.
pub struct Loaded {
    pub graph: Arc<Graph>,
    pub only: Vec<usize>,
    /// The files that it was read from.
    pub texts: Vec<PathBuf>,
    /// Where its lock lies, or would.
    pub lock: Option<PathBuf>,
    /// Where a bundle lies unpacked as long as this lives.
    pub unpacked: Option<TempFolder>,
}

impl Loaded {
    /// Refuses sinks that would write over the graph or a file it reads.
    pub fn check_outputs(&self, out: &Path) -> Result<(), Error> {
        self.graph.check_outputs(&self.only, out, &self.texts).map_err(Error::Graph)
    }

    /// Refuses to write anything else there.
    pub fn check_output(&self, path: &Path) -> Result<(), Error> {
        let read = ReadFiles::new(self.texts.iter().cloned().chain(self.graph.files()));
        if read.has(path) { Err(Error::IsRead(path.to_owned())) } else { Ok(()) }
    }
}

impl GraphArgs {
    /// Reads and checks the graph.
    pub fn load(&self) -> Result<Loaded, Error> {
        let mut texts = Vec::new();
        let origin = self.read(&mut texts)?;
        self.check(origin, &texts, |source, registry, root| {
            Graph::parse(source, registry, root).map(Arc::new).map_err(Error::Graph)
        })
    }

    /// The same for work on knobs, where it matters that the recipe of a picture knows less than its graph did.
    pub fn load_to_turn(&self) -> Result<Loaded, Error> {
        if is_picture(&self.graph) {
            report::remark(
                "the recipe of a picture has no presets of its graph and other names of nodes, so settings of these knobs fit \
                 the picture and not the graph",
            );
        }
        self.load()
    }

    /// The same for a watch. `known` is the graph as it was, where no file that its nodes read has changed since: what
    /// the text says as it did is not read again. The files that the graph itself consists of go to `texts`, found
    /// or not.
    pub fn load_again(
        &self,
        known: Option<&(Arc<Graph>, Vec<usize>)>,
        texts: &mut Vec<PathBuf>,
    ) -> Result<Loaded, Error> {
        if let Some((known, only)) = known
            && let Some(graph) = self.edited(known)
        {
            texts.push(self.graph.clone());
            return Ok(Loaded {
                graph,
                only: only.clone(),
                texts: texts.clone(),
                lock: None,
                unpacked: None,
            });
        }
        let origin = self.read(texts)?;
        self.check(origin, texts, |source, registry, root| match known {
            Some((known, _)) if known.source == source => Ok(known.clone()),
            _ => Graph::parse(source, registry, root).map(Arc::new).map_err(Error::Graph),
        })
    }

    /// The graph as its file has it now, where that is one and the same file and little in it changed.
    fn edited(&self, known: &Arc<Graph>) -> Option<Arc<Graph>> {
        let path = self.graph.canonicalize().ok()?;
        let text = std::fs::read_to_string(&path).ok()?;
        if path.parent() != Some(known.root.folder()) {
            return None;
        }
        known.reparse(text, nodes::registry)
    }

    /// Checks a graph that was read, and opens an engine. A wrong graph leaves no cache behind.
    pub fn check_with(
        &self,
        origin: Origin,
        texts: &[PathBuf],
        engine: &EngineArgs,
    ) -> Result<(Loaded, Engine), Error> {
        let loaded = self.check(origin, texts, |source, registry, root| {
            Graph::parse(source, registry, root).map(Arc::new).map_err(Error::Graph)
        })?;
        Ok((loaded, engine.open()?))
    }

    /// Reads the graph, what is laid over it and what it includes. The files of that go to `texts`, found or not.
    pub fn read(&self, texts: &mut Vec<PathBuf>) -> Result<Origin, Error> {
        texts.push(self.graph.clone());
        texts.extend(self.overlay.iter().cloned());
        let origin = OriginArgs { inputs: self.inputs.clone(), other_versions: self.other_versions };
        let Origin { mut source, root, lock, recipe, unpacked } = Origin::open(&self.graph, &origin)?;
        if !self.preset.is_empty() {
            // Presets speak of the nodes of included files, too.
            let (joined, included) = source.including(&root);
            texts.extend(included);
            source = joined;
        }
        for preset in &self.preset {
            source = source.with_preset(preset, &nodes::registry());
        }
        for path in &self.overlay {
            if root.is_strange(path) {
                return Err(Error::Strange(path.clone()));
            }
            let failed = |source| Error::Read { what: "overlay", path: path.clone(), source };
            source =
                source.overlaid(&path.display().to_string(), &std::fs::read_to_string(path).map_err(failed)?);
        }
        let (mut settings, mut wrong) = (Vec::<Setting>::new(), Vec::new());
        for text in &self.set {
            match text.parse() {
                Ok(setting) => settings.push(setting),
                Err(EditError::Form(_)) => {
                    wrong.push(format!("`--set {text}` is no setting; write --set node.field=value"));
                }
            }
        }
        if !wrong.is_empty() {
            return Err(Error::Edit(wrong));
        }
        // Last, since what is laid over may name other files.
        let (source, included) = engine::apply(&source, &settings).including(&root);
        texts.extend(included);
        Ok(Origin { source, root, lock, recipe, unpacked })
    }

    fn check(
        &self,
        origin: Origin,
        texts: &[PathBuf],
        parse: impl FnOnce(Source, &Registry, SourceRoot) -> Result<Arc<Graph>, Error>,
    ) -> Result<Loaded, Error> {
        let Origin { source, root, lock, recipe, unpacked } = origin;
        let graph = parse(source, &nodes::registry(), root)?;
        let as_it_was = self.set.is_empty() && self.preset.is_empty() && self.overlay.is_empty();
        if let Some(recipe) = recipe.filter(|_| as_it_was) {
            let other = recipe.other_sources(&graph, &Store::in_memory()).map_err(Error::Sources)?;
            if !other.is_empty() {
                return Err(Error::OtherSources { path: self.graph.clone(), other });
            }
        }
        if self.only.iter().any(|name| name.trim().is_empty()) {
            return Err(Error::Edit(vec!["`--only` takes names, with one comma between two".to_owned()]));
        }
        let only =
            self.only.iter().map(|name| find_all(&graph, name.trim())).collect::<Result<Vec<_>, _>>()?;
        Ok(Loaded { graph, only: only.concat(), texts: texts.to_vec(), lock, unpacked })
    }
}

/// The one node of a name, or an error that lists those there are.
pub fn find(graph: &Graph, name: &str) -> Result<usize, Error> {
    match find_all(graph, name)?.as_slice() {
        [node] => Ok(*node),
        nodes => Err(Error::Several { name: name.to_owned(), known: names(graph, nodes.iter().copied()) }),
    }
}

/// Every node of a name; axes make several of one.
fn find_all(graph: &Graph, name: &str) -> Result<Vec<usize>, Error> {
    let found = graph.find_all(name);
    match found.as_slice() {
        [] => {
            if let Some(of) = graph.source.gathered(name) {
                return Err(Error::Gather { name: name.to_owned(), of });
            }
            let near = engine::nearest(name, graph.nodes.iter().map(|node| node.id.as_str()));
            let hint = near.map(|near| format!(" (did you mean `{near}`?)")).unwrap_or_default();
            Err(Error::Node { name: name.to_owned(), hint, known: names(graph, 0..graph.nodes.len()) })
        }
        _ => Ok(found),
    }
}

impl EngineArgs {
    /// Bytes of memory for values; 0 for what the engine takes by itself.
    pub fn memory(&self) -> Result<u64, Error> {
        self.memory.as_deref().map_or(Ok(0), size)
    }

    /// Opens the store.
    pub fn open(&self) -> Result<Engine, Error> {
        let memory = self.memory()?;
        let fsync = match self.fsync {
            When::Batch => Fsync::Batch,
            When::Always => Fsync::Always,
            When::Off => Fsync::Off,
        };
        let options = cache::Options { fsync, ..cache::Options::default() };
        let folder = cache_folder(self.cache.as_deref())?;
        let store = Store::open(&folder, options)
            .map_err(|error| Error::OpenCache { folder: folder.clone(), why: causes(error) })?;
        Ok(Engine::new(store, self.jobs(), memory))
    }

    /// How many threads; 0 for what the engine takes by itself.
    pub fn jobs(&self) -> usize {
        self.jobs.map_or(0, usize::from)
    }
}

/// A flag that Ctrl-C sets: the first one asks, the second one is meant.
pub fn on_interrupt() -> Result<Arc<AtomicBool>, Error> {
    let cancel = Arc::new(AtomicBool::new(false));
    let again = cancel.clone();
    ctrlc::set_handler(move || {
        if again.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    })?;
    Ok(cancel)
}

/// The folder of the cache: the one that was named, else that of the environment, else the user's.
pub fn cache_folder(named: Option<&Path>) -> Result<PathBuf, Error> {
    match (named, std::env::var_os("LIGHTHARMONY_CACHE")) {
        (Some(folder), _) => Ok(folder.to_owned()),
        (None, Some(folder)) if !folder.is_empty() => Ok(folder.into()),
        _ => {
            let folders =
                directories::ProjectDirs::from("", "", "lightharmony").ok_or(Error::NoCacheFolder)?;
            Ok(folders.cache_dir().to_owned())
        }
    }
}

/// Bytes, from a number with or without K, M, G or T.
pub fn size(text: &str) -> Result<u64, Error> {
    engine::parse_bytes(text).ok_or_else(|| Error::Size(text.to_owned()))
}
