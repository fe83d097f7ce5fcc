//! What a running node may ask of the engine.

use crate::value::counts::Effort;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use cache::{Digest, Lease};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::kind::param_type::{ParamType, canonical};
use crate::kind::port::Wired;
use crate::value::artifact::{AnyArtifact, Artifact, decode_all, encode_to_vec};
use crate::value::counts::Counts;
use crate::value::cpu;
use crate::value::error::NodeError;
use crate::value::root::InputFile;
use crate::value::root::{SourceFile, SourceRoot};

/// Which axis of the world points up. Worlds are right-handed. Written `"+y"`, `"-y"` or `"+z"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Up {
    /// `+y`, as in glTF.
    PlusY,
    /// `-y`, as COLMAP often gives.
    MinusY,
    /// `+z`, as in Blender.
    PlusZ,
}

impl Up {
    /// How a graph file writes it.
    pub const fn name(self) -> &'static str {
        match self {
            Up::PlusY => "+y",
            Up::MinusY => "-y",
            Up::PlusZ => "+z",
        }
    }
}

impl From<Up> for String {
    fn from(up: Up) -> Self {
        up.name().to_owned()
    }
}

impl TryFrom<String> for Up {
    type Error = String;
    fn try_from(name: String) -> Result<Self, String> {
        let known = [Up::PlusY, Up::MinusY, Up::PlusZ];
        known.into_iter().find(|up| up.name() == name).ok_or_else(|| format!("no axis `{name}`"))
    }
}

impl ParamType for Up {
    fn describe() -> String {
        "\"+y\" | \"-y\" | \"+z\"".to_owned()
    }
}

/// The `scene` block of a graph: what every node shares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene {
    /// Which axis points up.
    pub up: Up,
    /// How many metres one world unit is.
    pub metres_per_unit: f64,
    /// Seed of every random number in the graph.
    pub seed: u64,
    /// Whether work is done that checks show to change no byte; see [`Context::exhaustive`].
    pub exhaustive: bool,
}

/// A part of the context. A kind declares those it reads, and only those enter its keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ContextField {
    /// [`Scene::up`].
    Up,
    /// [`Scene::metres_per_unit`].
    MetresPerUnit,
    /// [`Scene::seed`].
    Seed,
    /// [`Scene::exhaustive`].
    Exhaustive,
    /// The names of the outputs that the wires come from; see [`Context::wired`].
    Wired,
    /// The values of axes at which the nodes above stand; see [`Context::points`].
    Points,
    /// The canonical graph above this node; see [`Context::recipe`].
    Recipe,
}

impl ContextField {
    pub(crate) const ALL: &'static [Self] = &[
        Self::Up,
        Self::MetresPerUnit,
        Self::Seed,
        Self::Exhaustive,
        Self::Wired,
        Self::Points,
        Self::Recipe,
    ];
}

/// Axes, each with the value at which a node stands, in RON: `[("yaw", "15.0")]`.
pub type Point = Vec<(String, String)>;

/// Names one part of a node's work, an action of its own with its own key.
#[derive(Debug, Clone, Copy)]
pub struct Part<'a> {
    /// Name in the event stream: `r0`.
    pub name: &'a str,
    /// Raised whenever the part's code changes its output.
    pub version: u32,
    /// The input ports whose content the part depends on.
    pub inputs: &'a [&'static str],
}

/// Keeps the results of parts; the scheduler's side of [`Context::part`].
pub(crate) trait PartStore: Send + Sync {
    /// The stored bytes of a part, and what it once took.
    fn load(&self, part: Part<'_>, extra: &str) -> Option<(Vec<u8>, Effort)>;
    /// The right to compute a part, or an error that has the node asked again once whoever has it is done. It
    /// does not wait: this thread may have the right itself, further up in the same stack of borrowed work.
    fn claim(&self, part: Part<'_>, extra: &str) -> Result<Option<Lease>, NodeError>;
    fn save(&self, part: Part<'_>, extra: &str, encoded: &[u8], spent: Effort) -> Result<(), NodeError>;
    /// A part in memory, if it is still there.
    fn recall(&self, part: Part<'_>, extra: &str) -> Option<AnyArtifact>;
    /// Keeps a part of so many bytes in memory.
    fn keep(&self, part: Part<'_>, extra: &str, value: AnyArtifact, bytes: u64);
}

/// A declared source, read and digested when the key was made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ReadSource {
    pub file: SourceFile,
    pub digest: Digest,
    /// Length of the file.
    pub bytes: u64,
}

/// What a running node may ask of the engine: context fields, files, tiles on the shared threads, parts,
/// progress, cancellation and counts.
pub struct Context {
    pub(crate) scene: Scene,
    pub(crate) reads: &'static [ContextField],
    pub(crate) recipe: Option<Arc<str>>,
    pub(crate) wired: Wired,
    pub(crate) points: Vec<(&'static str, Vec<Point>)>,
    pub(crate) root: SourceRoot,
    pub(crate) sources: Vec<ReadSource>,
    pub(crate) cancel: Arc<AtomicBool>,
    /// The node was told that the run is to stop, so its result may be half done.
    pub(crate) told: AtomicBool,
    pub(crate) progress: Box<dyn Fn(f32) + Send + Sync>,
    pub(crate) parts: Option<Box<dyn PartStore>>,
    pub(crate) counts: Mutex<BTreeMap<&'static str, u64>>,
    /// Nanoseconds that threads spent on it.
    pub(crate) cpu: AtomicU64,
    /// What parts that were known once took.
    pub(crate) known: Mutex<Effort>,
}

impl Context {
    /// A context outside of any run: no cache, no cancellation, every field readable. For tests and
    /// benches of kinds; tiles run on the caller's rayon pool.
    pub fn detached(scene: Scene, folder: impl Into<PathBuf>) -> Self {
        Self {
            scene,
            reads: ContextField::ALL,
            recipe: None,
            wired: Wired::default(),
            points: Vec::new(),
            root: SourceRoot::new(folder),
            sources: Vec::new(),
            cancel: Arc::default(),
            told: AtomicBool::new(false),
            progress: Box::new(|_| {}),
            parts: None,
            counts: Mutex::default(),
            cpu: AtomicU64::default(),
            known: Mutex::default(),
        }
    }

    fn declared(&self, field: ContextField) {
        assert!(self.reads.contains(&field), "the kind reads {field:?} but does not declare it in READS");
    }

    /// Which axis points up. The kind must declare [`ContextField::Up`].
    pub fn up(&self) -> Up {
        self.declared(ContextField::Up);
        self.scene.up
    }

    /// Metres a world unit. The kind must declare [`ContextField::MetresPerUnit`].
    pub fn metres_per_unit(&self) -> f64 {
        self.declared(ContextField::MetresPerUnit);
        self.scene.metres_per_unit
    }

    /// Seed of every random number. The kind must declare [`ContextField::Seed`].
    pub fn seed(&self) -> u64 {
        self.declared(ContextField::Seed);
        self.scene.seed
    }

    /// Whether to do all work, also where a check shows that it changes no byte, so that what such checks save can be
    /// measured. The kind must declare [`ContextField::Exhaustive`].
    pub fn exhaustive(&self) -> bool {
        self.declared(ContextField::Exhaustive);
        self.scene.exhaustive
    }

    /// The canonical graph above this node, for the metadata of written pictures: nodes renamed in
    /// order, every parameter written, sources by digest. The kind must declare [`ContextField::Recipe`].
    pub fn recipe(&self) -> Option<&str> {
        self.declared(ContextField::Recipe);
        self.recipe.as_deref()
    }

    /// For each wire of an input, the name of the output it comes from: `["colour", "depth"]`. The kind
    /// must declare [`ContextField::Wired`]. Empty in a detached context.
    pub fn wired(&self, input: &str) -> &[&'static str] {
        self.declared(ContextField::Wired);
        self.wired.of(input)
    }

    /// For each wire of an input, the axes that its node runs along with its values there:
    /// `[("yaw", "15.0")]`. The kind must declare [`ContextField::Points`]. Empty in a detached context.
    pub fn points(&self, input: &str) -> &[Point] {
        self.declared(ContextField::Points);
        self.points.iter().find(|(port, _)| *port == input).map_or(&[], |(_, points)| points)
    }

    /// True once the run was asked to stop.
    pub fn cancelled(&self) -> bool {
        let cancelled = self.cancel.load(Ordering::Relaxed);
        if cancelled {
            self.told.store(true, Ordering::Relaxed);
        }
        cancelled
    }

    /// Asks to stop, as the end of a run does: for tests of kinds.
    pub fn stop(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }

    /// The same context, in which the run is asked to stop as soon as so much of the work is told: for tests of kinds.
    pub fn stopping_at(self, fraction: f32) -> Self {
        let cancel = self.cancel.clone();
        let progress = move |done| {
            if done >= fraction {
                cancel.store(true, Ordering::Relaxed);
            }
        };
        Self { progress: Box::new(progress), ..self }
    }

    /// An error once the run was asked to stop; for loops that have no tiles.
    pub fn check(&self) -> Result<(), NodeError> {
        if self.cancelled() { Err(NodeError::cancelled()) } else { Ok(()) }
    }

    /// Tells how far the node is, from 0 to 1.
    pub fn progress(&self, done: f32) {
        (self.progress)(done.clamp(0.0, 1.0));
    }

    /// Runs `f` for every index below `n` on the shared threads and gives the results in index order,
    /// so what is summed over them does not depend on the number of threads.
    pub fn for_each_tile<T: Send>(
        &self,
        n: usize,
        f: impl Fn(usize) -> T + Send + Sync,
    ) -> Result<Vec<T>, NodeError> {
        // One slot a tile, so that the pool's loop is compiled once and not for every kind's closure.
        let slots: Vec<Mutex<Option<T>>> = (0..n).map(|_| Mutex::new(None)).collect();
        self.each(n, &|index| {
            let made = f(index);
            *slots[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(made);
        })?;
        let made =
            slots.into_iter().filter_map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner));
        Ok(made.collect())
    }

    fn each(&self, n: usize, tile: &(dyn Fn(usize) + Sync)) -> Result<(), NodeError> {
        // One by one: tiles may differ much in work, and a thread that is done takes over half of what another has left.
        (0..n).into_par_iter().with_max_len(1).try_for_each(|index| {
            self.check()?;
            self.on_cpu(|| tile(index));
            Ok(())
        })
    }

    /// Runs code of the node, and counts the CPU time that this thread spends on it.
    pub(crate) fn on_cpu<T>(&self, code: impl FnOnce() -> T) -> T {
        let (value, spent) = cpu::measured(code);
        self.cpu.fetch_add(spent.as_nanos() as u64, Ordering::Relaxed);
        value
    }

    /// CPU time of all threads for the node so far.
    pub(crate) fn cpu_seconds(&self) -> f64 {
        self.cpu.load(Ordering::Relaxed) as f64 * 1e-9
    }

    /// Adds to a deterministic count of work, such as `rays` or `blends`.
    pub fn count(&self, name: &'static str, n: u64) {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        *counts.entry(name).or_default() += n;
    }

    /// The counts so far.
    pub fn counts(&self) -> BTreeMap<&'static str, u64> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Computes a part of the node's work, or takes it from the cache. Its key is made of the kind, the
    /// part's name and version, the content of the named inputs and `extra`, which must hold every
    /// parameter and number that `value` reads. What `value` counts is kept beside it, so that the node is
    /// known to stand for all of its work whatever of it was known; so one part at a time. Where another node or
    /// process computes the same part just now, the error, passed on as it is, has this node asked again later.
    pub fn part<A: Artifact>(
        &self,
        part: Part<'_>,
        extra: &impl Serialize,
        value: impl FnOnce() -> Result<A, NodeError>,
    ) -> Result<Arc<A>, NodeError> {
        let Some(store) = &self.parts else { return value().map(Arc::new) };
        let extra = canonical(extra)?;
        let load = || {
            let (stored, spent) = store.load(part, &extra)?;
            let known = decode_all::<A>(&stored).ok()?;
            self.known.lock().unwrap_or_else(PoisonError::into_inner).add(&spent);
            Some(Arc::new(known))
        };
        if let Some(known) = load() {
            return Ok(known);
        }
        let _lease = store.claim(part, &extra)?;
        // Whoever had it before may have left its result.
        if let Some(known) = load() {
            return Ok(known);
        }
        let (start, cpu, before) = (std::time::Instant::now(), self.cpu_seconds(), self.counts());
        let made = self.on_cpu(value)?;
        let (seconds, cpu_seconds) = (start.elapsed().as_secs_f64(), self.cpu_seconds() - cpu);
        let mut spent = Effort { seconds, cpu_seconds, counts: Counts::new() };
        for (name, n) in self.counts() {
            let n = n - before.get(name).copied().unwrap_or(0);
            if n > 0 {
                spent.counts.insert(name.to_owned(), n);
            }
        }
        store.save(part, &extra, &encode_to_vec(&made), spent)?;
        Ok(Arc::new(made))
    }

    /// What several nodes want of the same inputs and is sooner made again than read, such as a tree of triangles: a part
    /// that is never stored but stays in memory for the next node, or the next run of a program that watches, while there is
    /// room for it. Whoever does not find it makes it, so nobody waits. Its code counts nothing.
    ///
    /// # Errors
    /// When `extra` has no canonical form.
    pub fn in_memory<T: Send + Sync + 'static>(
        &self,
        part: Part<'_>,
        extra: &impl Serialize,
        bytes: fn(&T) -> u64,
        make: impl FnOnce() -> T,
    ) -> Result<Arc<T>, NodeError> {
        let Some(store) = &self.parts else { return Ok(Arc::new(make())) };
        let extra = canonical(extra)?;
        if let Some(known) = store.recall(part, &extra).and_then(|known| known.downcast().ok()) {
            return Ok(known);
        }
        let made = Arc::new(make());
        store.keep(part, &extra, made.clone(), bytes(&made));
        Ok(made)
    }

    /// Where the file that a parameter names lies on this machine; for a folder whose files are sources.
    pub fn source(&self, file: &InputFile) -> SourceFile {
        self.root.file(file)
    }

    /// The bytes of a source file. Reading a file that the kind's `sources` did not list is our bug; a
    /// file that changed since its digest was taken is an error that asks for another run.
    pub fn read(&self, file: &InputFile) -> Result<Vec<u8>, NodeError> {
        self.read_source(&self.root.file(file))
    }

    /// The bytes of a source file that another source names, such as a glTF buffer.
    pub fn read_beside(&self, file: &InputFile, name: &str) -> Result<Vec<u8>, NodeError> {
        self.read_source(&self.root.beside(&self.root.file(file), name))
    }

    fn read_source(&self, wanted: &SourceFile) -> Result<Vec<u8>, NodeError> {
        let failed = |e| NodeError::new(format!("cannot read `{}`: {e}", wanted.path.display()));
        // A pipe or a device may have no end.
        if !std::fs::metadata(&wanted.path).map_err(failed)?.is_file() {
            return Err(NodeError::new(format!("`{}` is not a regular file", wanted.path.display())));
        }
        let bytes = std::fs::read(&wanted.path).map_err(failed)?;
        if self.parts.is_some() {
            let declared = self.sources.iter().find(|source| source.file == *wanted);
            let declared = declared.unwrap_or_else(|| {
                panic!("the kind reads `{}` but does not list it in sources", wanted.name)
            });
            if Digest::of(&bytes) != declared.digest {
                let what = format!("`{}` changed while the graph was running", wanted.name);
                return Err(NodeError::new(what).hint("run again"));
            }
        }
        Ok(bytes)
    }
}
