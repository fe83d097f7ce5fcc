//! `cache`: maintenance of the cache. The results of runs never depend on it.

use std::path::{Path, PathBuf};

use ::cache::{Digest, Limits, Options, Store};
use clap::{Args, Subcommand};
use engine::{Engine, Fate, blobs_of, bytes_text};

use crate::session::{Error, GraphArgs, Loaded, cache_folder, size, time};
use crate::terminal;
use crate::terminal::print;

/// Maintains the cache: prints its contents, finds damage, limits its size.
#[derive(Debug, Args)]
pub struct Cache {
    #[command(subcommand)]
    verb: Verb,
    /// Folder of the cache [env: LIGHTHARMONY_CACHE; default: the user's cache folder]
    #[arg(long, global = true, value_name = "DIR")]
    cache: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Print the contents of the cache
    Stat,
    /// Read everything and report damage, without changing anything; exit code 1 if something is damaged
    Verify,
    /// Move damaged results aside now, so that they are recomputed; a run does this only with damaged results that
    /// it finds
    Repair,
    /// Remove the least recently used results; waits until no run is active
    Gc(Gc),
    /// Protect the known results of a graph from `gc`
    Pin(Pin),
    /// Copy all results, or only the results of a graph, to another cache
    Copy(Copy),
}

#[derive(Debug, Args)]
struct Gc {
    /// Maximum size of the cache, such as 10G; 0 empties it
    #[arg(long, value_name = "SIZE")]
    max_size: Option<String>,
    /// Maximum time since a result was last used, such as 30d, 12h or 5m
    #[arg(long, value_name = "TIME")]
    max_age: Option<String>,
    /// Only print what would be removed
    #[arg(long)]
    dry_run: bool,
    /// Maximum time to wait for an active run
    #[arg(long, value_name = "TIME", default_value = "1m")]
    wait: String,
}

#[derive(Debug, Args)]
#[command(mut_arg("graph", |graph| graph.required(false)))]
struct Pin {
    #[command(flatten)]
    graph: Option<GraphArgs>,
    /// Remove the pin of this graph
    #[arg(long)]
    remove: bool,
}

#[derive(Debug, Args)]
#[command(mut_arg("graph", |graph| graph.required(false)))]
struct Copy {
    #[command(flatten)]
    graph: Option<GraphArgs>,
    /// Folder of the other cache
    #[arg(long, value_name = "DIR")]
    to: PathBuf,
}

impl Cache {
    /// Runs the command and returns the exit code.
    pub fn run(self) -> Result<u8, Error> {
        let folder = cache_folder(self.cache.as_deref())?;
        if matches!(self.verb, Verb::Gc(_)) && !folder.exists() {
            // A nightly job on a new machine finds nothing to remove, which is not an error.
            print(&format!("there is no cache in `{}` yet: nothing to remove\n", folder.display()))?;
            return Ok(0);
        }
        if !folder.is_dir() {
            return Err(Error::usage(format!("there is no cache in `{}`", folder.display())));
        }
        let looks = matches!(&self.verb, Verb::Stat | Verb::Verify | Verb::Gc(Gc { dry_run: true, .. }));
        let store = Store::open(&folder, Options { read_only: looks, ..Options::default() })?;
        if let Some(why) = store.why_read_only().filter(|_| !looks) {
            print(&format!("the cache cannot be written ({why}), so nothing was changed\n"))?;
            return Ok(1);
        }
        match self.verb {
            Verb::Stat => stat(&store, &folder),
            Verb::Verify => check(&store, false),
            Verb::Repair => check(&store, true),
            Verb::Gc(gc) => gc.run(&store),
            Verb::Pin(pin) => pin.run(store),
            Verb::Copy(copy) => copy.run(store),
        }
    }
}

fn stat(store: &Store, folder: &Path) -> Result<u8, Error> {
    let stat = store.stat()?;
    let rows = [
        ("folder", folder.display().to_string()),
        ("size", bytes_text(stat.bytes)),
        ("results", stat.records.to_string()),
        (
            "values",
            format!(
                "large, in separate files: {} ({}); small, in a log: {}",
                stat.large_blobs,
                bytes_text(stat.large_bytes),
                stat.small_blobs
            ),
        ),
        ("logs", format!("{} (unused: {})", bytes_text(stat.log_bytes), bytes_text(stat.dead_bytes))),
        ("files", format!("input files with a remembered digest: {}", stat.memos)),
        ("aside", bytes_text(stat.quarantine_bytes)),
    ];
    let mut text: String = rows.iter().map(|(name, value)| format!("{name:<8} {value}\n")).collect();
    for (name, records) in store.pins() {
        text.push_str(&format!("{:<8} {name} (results: {records})\n", "pin"));
    }
    print(&text)?;
    Ok(0)
}

fn check(store: &Store, repair: bool) -> Result<u8, Error> {
    let found = store.check(repair, &blobs_of, &mut |_| true)?;
    let mut text =
        format!("results: {}, values: {} ({})\n", found.records, found.blobs, bytes_text(found.bytes));
    if found.damaged_bytes > 0 {
        text.push_str(&format!("damaged: {} in the logs\n", bytes_text(found.damaged_bytes)));
    }
    found.bad.iter().for_each(|digest| text.push_str(&format!("damaged: value {digest}\n")));
    found.incomplete.iter().for_each(|key| text.push_str(&format!("incomplete: result {key}\n")));
    text.push_str(match (found.is_whole(), repair) {
        (true, _) => "nothing is damaged\n",
        (false, true) => "the damaged results were moved aside; the next run that needs them recomputes them\n",
        (false, false) => {
            "a run that needs a damaged result recomputes it; `lightharmony cache repair` moves all damaged results aside now\n"
        }
    });
    print(&text)?;
    Ok(u8::from(!found.is_whole() && !repair))
}

impl Gc {
    fn run(self, store: &Store) -> Result<u8, Error> {
        let limits = Limits {
            max_size: self.max_size.as_deref().map(size).transpose()?,
            max_age: self.max_age.as_deref().map(time).transpose()?,
            dry_run: self.dry_run,
        };
        let gone = store.collect(&limits, &blobs_of, time(&self.wait)?)?;
        let done = if self.dry_run { "would be removed" } else { "removed" };
        let mut text = format!(
            "{done}: results {}, values {}; size {} before, {} after\n",
            gone.records,
            gone.blobs,
            bytes_text(gone.before),
            bytes_text(gone.after)
        );
        if gone.pinned > 0 {
            text.push_str(&format!("pinned results, which are kept: {}\n", gone.pinned));
        }
        print(&text)?;
        let too_much = limits.max_size.is_some_and(|most| gone.after > most && most > 0);
        if too_much {
            terminal::error("the pinned results, which are kept, exceed the limit");
        }
        Ok(u8::from(too_much))
    }
}

/// The keys of the known results of a graph, the number of nodes that its targets need, and the engine.
fn known(graph: &GraphArgs, store: Store) -> Result<(Vec<Digest>, usize, Engine), Error> {
    let Loaded { graph, only, .. } = graph.load()?;
    let engine = Engine::new(store, 1, 0);
    let plan = engine.plan(&graph, &only);
    let wanted = plan.iter().filter(|node| node.fate != Fate::Unwanted).count();
    let known = plan.iter().filter(|node| node.fate == Fate::Known);
    // The key is the digest of the manifest.
    let keys: Vec<Digest> =
        known.filter_map(|node| node.manifest.as_ref()).map(|m| Digest::of(m.as_bytes())).collect();
    Ok((keys, wanted, engine))
}

impl Pin {
    fn run(self, store: Store) -> Result<u8, Error> {
        let Some(graph) = self.graph else {
            let pins = store.pins();
            let lines: String =
                pins.iter().map(|(name, records)| format!("{name} (results: {records})\n")).collect();
            print(if lines.is_empty() { "nothing is pinned\n" } else { &lines })?;
            return Ok(0);
        };
        let name = std::path::absolute(&graph.graph)?.display().to_string();
        if self.remove {
            let was = store.unpin(&name)?;
            print(&format!("{name} {}\n", if was { "is no longer pinned" } else { "was not pinned" }))?;
            return Ok(u8::from(!was));
        }
        let (keys, wanted, engine) = known(&graph, store)?;
        let before = engine.store().pins().into_iter().find(|(pin, _)| *pin == name);
        engine.store().pin(&name, &keys)?;
        let before = before.map(|(_, records)| format!(", results of the replaced pin: {records}"));
        let before = before.unwrap_or_default();
        print(&format!("pinned {name} (known results: {}, nodes: {wanted}{before})\n", keys.len()))?;
        Ok(0)
    }
}

impl Copy {
    fn run(self, store: Store) -> Result<u8, Error> {
        let other = Store::open(&self.to, Options::default())?;
        let copied = match &self.graph {
            None => store.copy_to(&other, None, &blobs_of, &mut |_| true)?,
            Some(graph) => {
                let (keys, _, engine) = known(graph, store)?;
                engine.store().copy_to(&other, Some(&keys), &blobs_of, &mut |_| true)?
            }
        };
        print(&format!("copied to {} (results: {copied})\n", self.to.display()))?;
        Ok(0)
    }
}
