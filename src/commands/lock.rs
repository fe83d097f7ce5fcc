//! `lock`: writes down what a graph is made of, by digest.

use std::io::ErrorKind;
use std::path::PathBuf;

use clap::Args;
use engine::{Engine, Graph, Lock, Source};

use crate::session::{EngineArgs, Error, GraphArgs, Loaded};

/// Writes down the digests of what a graph reads, the versions of its kinds, and what is known of its results.
#[derive(Debug, Args)]
pub struct MakeLock {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    /// The file to write; default: the graph file with the ending `.lock`
    #[arg(long, value_name = "FILE")]
    to: Option<PathBuf>,
}

impl MakeLock {
    /// Writes the lock and says what is in it.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let path = self.to.or(loaded.lock.clone()).ok_or(Error::NoLock)?;
        loaded.check_output(&path)?;
        let lock = self.engine.open()?.lock(&loaded.graph, &loaded.only).map_err(Error::Sources)?;
        cache::publish_file(&path, lock.text().as_bytes())?;
        let (inputs, kinds, results) = (lock.inputs.len(), lock.kinds.len(), lock.results.len());
        super::print(&format!(
            "{}: {inputs} inputs, {kinds} kinds, {results} results of {} nodes\n",
            path.display(),
            loaded.graph.nodes.len()
        ))?;
        Ok(0)
    }
}

/// Reads the lock that belongs to a graph.
pub fn read(loaded: &Loaded) -> Result<Lock, Error> {
    let path = loaded.lock.as_deref().ok_or(Error::NoLock)?;
    let text = std::fs::read_to_string(path).map_err(|source| match source.kind() {
        ErrorKind::NotFound => Error::Unlocked(path.to_owned()),
        _ => Error::Read { what: "lock", path: path.to_owned(), source },
    })?;
    Ok(Lock::parse(&Source::new(path.display().to_string(), text))?)
}

/// Refuses a graph whose kinds or inputs are not those of its lock.
pub fn refuse(engine: &Engine, graph: &Graph, only: &[usize], lock: &Lock) -> Result<(), Error> {
    let now = engine.lock(graph, only).map_err(Error::Sources)?;
    let differences = lock.differences(&now).before;
    if differences.is_empty() { Ok(()) } else { Err(Error::Locked(differences)) }
}
