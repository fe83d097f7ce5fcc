//! The lock of a graph, and the check that the graph agrees with it.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use engine::{Engine, Graph, Lock, Source};

use super::error::Error;
use super::graph::Loaded;

/// The lock file that belongs to a graph.
pub fn path(loaded: &Loaded) -> Result<PathBuf, Error> {
    let none =
        || Error::usage("this graph is not in a file of its own, so it has no lock; name a file with `--to`");
    loaded.lock.clone().ok_or_else(none)
}

/// Reads the lock that belongs to a graph.
pub fn read(loaded: &Loaded) -> Result<Lock, Error> {
    let path = path(loaded)?;
    let text =
        engine::read_text(&path, engine::MAX_GRAPH_BYTES).map_err(|error| unreadable(&path, &error))?;
    let lock = Lock::parse(&Source::new(path.display().to_string(), text));
    lock.map_err(|error| Error::usage(error.to_string()))
}

fn unreadable(path: &Path, error: &std::io::Error) -> Error {
    match error.kind() {
        ErrorKind::NotFound => {
            Error::usage(format!("there is no lock `{}`; `lightharmony lock` writes it", path.display()))
        }
        _ => Error::unreadable("lock", path, error),
    }
}

/// Rejects a graph whose kinds or inputs differ from those in its lock.
pub fn refuse(engine: &Engine, graph: &Graph, only: &[usize], lock: &Lock) -> Result<(), Error> {
    let now = engine.lock(graph, only)?;
    let differences = lock.differences(&now).before;
    if differences.is_empty() {
        return Ok(());
    }
    let differences = differences.join("\n");
    Err(Error::usage(format!(
        "the graph does not agree with its lock:\n{differences}\n`lightharmony lock` writes a new one"
    )))
}
