//! `unpack`: unpacks a bundle into a folder.

use std::fs::File;
use std::path::PathBuf;

use clap::Args;
use engine::{Bundle, bytes_text};

use crate::session::{EngineArgs, Error};
use crate::terminal;

/// Unpacks a bundle into a new folder. If any part of the bundle is damaged, no folder is created.
#[derive(Debug, Args)]
pub struct Unpack {
    /// The bundle
    bundle: PathBuf,
    /// The folder to create; default: the name of the bundle without its extension
    folder: Option<PathBuf>,
    /// Only list its contents
    #[arg(long)]
    list: bool,
    /// Also copy its results into the cache without verifying them, for bundles from someone you trust
    #[arg(long)]
    trust_results: bool,
    #[command(flatten)]
    engine: EngineArgs,
}

impl Unpack {
    /// Creates the folder, or lists its contents.
    pub fn run(self) -> Result<u8, Error> {
        let named = |error: engine::BundleError| Error::of_file(&self.bundle, &error);
        let file = File::open(&self.bundle);
        let file = file.map_err(|error| Error::unreadable("bundle", &self.bundle, &error))?;
        let mut bundle = Bundle::open(file).map_err(named)?;
        let (records, values) = bundle.results();
        if self.list {
            let mut text = String::new();
            for (name, length, digest) in bundle.files() {
                text.push_str(&format!("{} {:>10} {name}\n", digest.short(), bytes_text(length)));
            }
            text.push_str(&format!("distinct results: {records}, values: {values}\n"));
            terminal::print(&text)?;
            return Ok(0);
        }
        let folder = self.folder.clone().unwrap_or_else(|| self.bundle.with_extension(""));
        // Everything is read once before anything is written, so that damaged values are noticed.
        bundle.check().map_err(named)?;
        bundle.unpack(&folder).map_err(named)?;
        if self.trust_results {
            let engine = self.engine.open()?;
            bundle.fill(engine.store()).map_err(named)?;
            engine.store().flush()?;
        }
        let graph = folder.join("graph.ron");
        terminal::print(&format!("{}\n", graph.display()))?;
        Ok(0)
    }
}
