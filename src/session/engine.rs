//! The cache, threads and memory that a command uses.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use cache::{Fsync, Store};
use clap::Args;
use engine::Engine;

use super::error::{Error, causes};

/// The cache, and limits of threads and memory.
#[derive(Debug, Clone, Args)]
pub struct EngineArgs {
    /// Folder of the cache [env: LIGHTHARMONY_CACHE; default: the user's cache folder]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Number of threads; 0 (the default) means one per core
    #[arg(long, short, value_name = "N", value_parser = clap::value_parser!(u16).range(..=1024))]
    pub jobs: Option<u16>,
    /// Memory for values and running nodes, such as 4G; 0 (the default) means three quarters of the free memory.
    /// Nodes wait until the memory that they need is free, and a node that needs more than this limit fails before
    /// it starts
    #[arg(long, value_name = "SIZE")]
    pub memory: Option<String>,
    /// When to sync results to disk; this matters only if the power fails
    #[arg(long, value_name = "WHEN", default_value = "batch")]
    pub fsync: When,
}

/// Policy for syncing results to disk.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum When {
    /// Once, at the end of a run
    Batch,
    /// After every result
    Always,
    /// Never
    Off,
}

impl EngineArgs {
    /// Memory limit for values in bytes; 0 selects the default of the engine.
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
        // Without a cache, a run takes longer but gives the same results, so it continues with a warning.
        let store = Store::open(&folder, options).unwrap_or_else(|error| {
            Store::unavailable(format!(
                "cannot open `{}`: {}; name another folder with `--cache` or LIGHTHARMONY_CACHE",
                folder.display(),
                causes(error)
            ))
        });
        Ok(Engine::new(store, self.jobs(), memory))
    }

    /// Number of threads; 0 selects the default of the engine.
    pub fn jobs(&self) -> usize {
        self.jobs.map_or(0, usize::from)
    }
}

/// Returns a flag that the first Ctrl-C sets. The second Ctrl-C ends the process.
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

/// Calls `stop` when standard input reaches its end, on a thread of its own. The input itself is ignored.
pub fn at_end_of_input(stop: impl FnOnce() + Send + 'static) {
    std::thread::spawn(move || {
        // If standard input cannot be read, it has ended as well.
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
        stop();
    });
}

/// The folder of the cache: `named` if given, otherwise the folder in the environment variable
/// `LIGHTHARMONY_CACHE`, otherwise the user's cache folder.
pub fn cache_folder(named: Option<&Path>) -> Result<PathBuf, Error> {
    match (named, std::env::var_os("LIGHTHARMONY_CACHE")) {
        (Some(folder), _) => Ok(folder.to_owned()),
        (None, Some(folder)) if !folder.is_empty() => Ok(folder.into()),
        _ => {
            let folders = directories::ProjectDirs::from("", "", "lightharmony");
            folders.map(|folders| folders.cache_dir().to_owned()).ok_or_else(|| {
                let why = "no folder for the cache: the user has no home folder";
                Error::usage(format!("{why}; name one with `--cache` or LIGHTHARMONY_CACHE"))
            })
        }
    }
}

/// Parses a number of bytes, which may end in K, M, G or T.
pub fn size(text: &str) -> Result<u64, Error> {
    engine::parse_bytes(text).ok_or_else(|| {
        Error::usage(format!("`{text}` is not a size; write a number with K, M or G, such as 4G"))
    })
}

/// Parses a time with its unit, such as `1.5h`.
pub fn time(text: &str) -> Result<Duration, Error> {
    let wrong = || {
        let how = "write a number with ms, s, m, h or d, such as 10s, 1.5h or 30d";
        Error::usage(format!("`{text}` is not a time; {how}"))
    };
    let digits = text.trim_end_matches(|c: char| c.is_alphabetic());
    let unit = match &text[digits.len()..] {
        "ms" => 1e-3,
        "s" => 1.0,
        "m" => 60.0,
        "h" => 60.0 * 60.0,
        "d" => 24.0 * 60.0 * 60.0,
        _ => return Err(wrong()),
    };
    let number: f64 = digits.parse().map_err(|_| wrong())?;
    Duration::try_from_secs_f64(number * unit).map_err(|_| wrong())
}
