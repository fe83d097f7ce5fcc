//! The context of a running node: scene, files, threads, parts, progress, cancellation.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use cache::Digest;
use serde::Serialize;

use crate::kind::param_type::canonical;
use crate::kind::part::{Part, PartStore};
use crate::kind::port::Wired;
use crate::kind::scene::{Point, Scene, Up};
use crate::kind::tiles::{Threads, run_tiles};
use crate::value::artifact::{Artifact, decode_all, encode_to_vec};
use crate::value::counts::{Counts, Effort};
use crate::value::cpu;
use crate::value::error::NodeError;
use crate::value::root::{InputFile, SourceFile, SourceRoot};

/// Fields of the context. A kind declares the fields that it reads, and only these enter its keys.
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
    /// The names of the outputs connected to the inputs; see [`Context::wired`].
    Wired,
    /// The axis values of the nodes that the inputs come from; see [`Context::points`].
    Points,
    /// The canonical graph upstream of this node; see [`Context::recipe`].
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

/// A source file whose digest is part of the key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ReadSource {
    pub file: SourceFile,
    pub digest: Digest,
    /// Length of the file in bytes.
    pub bytes: u64,
}

/// Services of the engine for a running node: context fields, source files, tiles on several threads, parts,
/// progress, cancellation and work counters.
///
/// The documentation of [`Kind`](crate::Kind) has an example.
pub struct Context {
    pub(crate) scene: Scene,
    pub(crate) reads: &'static [ContextField],
    pub(crate) recipe: Option<Arc<str>>,
    pub(crate) wired: Wired,
    pub(crate) points: Vec<(&'static str, Vec<Point>)>,
    pub(crate) root: SourceRoot,
    pub(crate) sources: Vec<ReadSource>,
    pub(crate) cancel: Arc<AtomicBool>,
    /// True if the node has seen that the run is cancelled. Its result may then be incomplete.
    pub(crate) saw_cancel: AtomicBool,
    pub(crate) progress: Box<dyn Fn(f32) + Send + Sync>,
    pub(crate) parts: Option<Box<dyn PartStore>>,
    /// The threads of the run. If `None`, tiles run on the rayon pool of the caller.
    pub(crate) threads: Option<Arc<Threads>>,
    pub(crate) counts: Mutex<BTreeMap<&'static str, u64>>,
    /// CPU time of the node in nanoseconds, on all threads.
    pub(crate) cpu: AtomicU64,
    /// Time and counts of the parts that were taken from the cache.
    pub(crate) known: Mutex<Effort>,
}

impl Context {
    /// A context that belongs to no run, for tests and benchmarks of kinds. It has no cache and no cancellation,
    /// and all fields can be read. Tiles run on the rayon pool of the caller.
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
            saw_cancel: AtomicBool::new(false),
            progress: Box::new(|_| {}),
            parts: None,
            threads: None,
            counts: Mutex::default(),
            cpu: AtomicU64::default(),
            known: Mutex::default(),
        }
    }

    fn declared(&self, field: ContextField) {
        assert!(self.reads.contains(&field), "the kind reads `{field:?}` but does not declare it in `READS`");
    }

    /// The axis that points up. The kind must declare [`ContextField::Up`].
    pub fn up(&self) -> Up {
        self.declared(ContextField::Up);
        self.scene.up
    }

    /// Metres per world unit. The kind must declare [`ContextField::MetresPerUnit`].
    pub fn metres_per_unit(&self) -> f64 {
        self.declared(ContextField::MetresPerUnit);
        self.scene.metres_per_unit
    }

    /// Seed of all random numbers. The kind must declare [`ContextField::Seed`].
    pub fn seed(&self) -> u64 {
        self.declared(ContextField::Seed);
        self.scene.seed
    }

    /// True if the node must do all its work, even where a check shows that the work has no effect on the output.
    /// This makes it possible to measure what such checks save. The kind must declare [`ContextField::Exhaustive`].
    pub fn exhaustive(&self) -> bool {
        self.declared(ContextField::Exhaustive);
        self.scene.exhaustive
    }

    /// The canonical graph upstream of this node, for the metadata of written pictures. Its nodes are numbered in
    /// order, all parameters are written out, and sources are named by digest. The kind must declare
    /// [`ContextField::Recipe`].
    pub fn recipe(&self) -> Option<&str> {
        self.declared(ContextField::Recipe);
        self.recipe.as_deref()
    }

    /// For each wire of an input, the name of the output that the wire comes from: `["colour", "depth"]`. The kind
    /// must declare [`ContextField::Wired`]. Empty in a detached context.
    pub fn wired(&self, input: &str) -> &[&'static str] {
        self.declared(ContextField::Wired);
        self.wired.of(input)
    }

    /// For each wire of an input, the axis values of the node that the wire comes from, such as `[("yaw",
    /// "15.0")]`. The kind must declare [`ContextField::Points`]. Empty in a detached context.
    pub fn points(&self, input: &str) -> &[Point] {
        self.declared(ContextField::Points);
        self.points.iter().find(|(port, _)| *port == input).map_or(&[], |(_, points)| points)
    }

    /// True if the run was cancelled.
    pub fn cancelled(&self) -> bool {
        let cancelled = self.cancel.load(Ordering::Relaxed);
        if cancelled {
            self.saw_cancel.store(true, Ordering::Relaxed);
        }
        cancelled
    }

    /// Cancels the run. For tests of kinds.
    pub fn stop(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }

    /// Makes the context cancel the run once progress reaches `fraction`. For tests of kinds.
    pub fn stopping_at(self, fraction: f32) -> Self {
        let cancel = self.cancel.clone();
        let progress = move |done| {
            if done >= fraction {
                cancel.store(true, Ordering::Relaxed);
            }
        };
        Self { progress: Box::new(progress), ..self }
    }

    /// Makes the context accept these files as the sources that the kind listed. For tests of kinds.
    pub fn having_listed(mut self, files: &[SourceFile]) -> Self {
        let read = |file: &SourceFile| {
            let content = std::fs::read(&file.path).unwrap_or_default();
            ReadSource { file: file.clone(), digest: Digest::of(&content), bytes: content.len() as u64 }
        };
        self.sources = files.iter().map(read).collect();
        self
    }

    /// Returns an error if the run was cancelled. Loops that do not use tiles should call this regularly.
    pub fn check(&self) -> Result<(), NodeError> {
        if self.cancelled() { Err(NodeError::cancelled()) } else { Ok(()) }
    }

    /// Reports the progress of the node, from 0 to 1.
    pub fn progress(&self, done: f32) {
        (self.progress)(done.clamp(0.0, 1.0));
    }

    /// Runs `f` for every index below `n` on several threads. The results are in index order, so that sums over
    /// them do not depend on the number of threads.
    pub fn for_each_tile<T: Send>(
        &self,
        n: usize,
        f: impl Fn(usize) -> T + Send + Sync,
    ) -> Result<Vec<T>, NodeError> {
        // One slot per tile, so that the loop is compiled once and not for the closure of every kind.
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
        run_tiles(self.threads.as_deref(), n, &|| self.cancelled(), &|index| self.on_cpu(|| tile(index)))
    }

    /// Runs code of the node and adds the CPU time that it took on this thread to the node's CPU time.
    pub(crate) fn on_cpu<T>(&self, code: impl FnOnce() -> T) -> T {
        let (value, spent) = cpu::measured(code);
        self.cpu.fetch_add(spent.as_nanos() as u64, Ordering::Relaxed);
        value
    }

    /// CPU time of the node so far, on all threads.
    pub(crate) fn cpu_seconds(&self) -> f64 {
        self.cpu.load(Ordering::Relaxed) as f64 * 1e-9
    }

    /// Adds `n` to the work counter `name`, such as `rays` or `blends`. Counts must be deterministic.
    pub fn count(&self, name: &'static str, n: u64) {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        *counts.entry(name).or_default() += n;
    }

    /// The counts so far.
    pub fn counts(&self) -> BTreeMap<&'static str, u64> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Computes a part of the node's work, or takes it from the cache. The key of the part consists of the kind,
    /// the name and version of the part, the content of the named inputs and `extra`, which must contain every
    /// parameter and number that `value` reads. The work that `value` counts is stored with the part, so that the
    /// counts of a node cover all of its work even if parts came from the cache. Compute one part at a time. If
    /// another node or process is computing the part, this returns an error, which the kind must return too; the
    /// node is then tried again later.
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
        // The previous holder of the lease may have stored the result.
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

    /// Computes a part that is kept in memory and never stored, or takes it from memory. This is for values that
    /// are faster to compute than to read, such as a tree of triangles. The value serves other nodes with the same
    /// inputs and, in `watch`, later runs, until it is evicted. If two nodes need the value at the same time, both
    /// compute it, so that neither waits. `make` must not call [`count`](Self::count).
    ///
    /// # Errors
    /// If `make` fails, or if `extra` has no canonical form.
    pub fn in_memory<T: Send + Sync + 'static>(
        &self,
        part: Part<'_>,
        extra: &impl Serialize,
        bytes: fn(&T) -> u64,
        make: impl FnOnce() -> Result<T, NodeError>,
    ) -> Result<Arc<T>, NodeError> {
        let Some(store) = &self.parts else { return make().map(Arc::new) };
        let extra = canonical(extra)?;
        if let Some(known) = store.recall(part, &extra).and_then(|known| known.downcast().ok()) {
            return Ok(known);
        }
        let made = Arc::new(make()?);
        store.keep(part, &extra, made.clone(), bytes(&made));
        Ok(made)
    }

    /// The root that resolves the names of source files.
    pub fn root(&self) -> &SourceRoot {
        &self.root
    }

    /// The source file or folder that a parameter names.
    pub fn source(&self, file: &InputFile) -> SourceFile {
        self.root.file(file)
    }

    /// Returns an error that advises to run again if these files differ from the files that `sources` listed. For
    /// kinds that list a folder in `sources` and again in `run`. In a detached context any files are accepted,
    /// since there is no earlier list.
    pub fn check_listed(&self, files: &[SourceFile]) -> Result<(), NodeError> {
        if self.parts.is_none() && self.sources.is_empty() {
            return Ok(());
        }
        let (now, listed): (BTreeSet<&str>, BTreeSet<&str>) = (
            files.iter().map(|file| file.name.as_str()).collect(),
            self.sources.iter().map(|source| source.file.name.as_str()).collect(),
        );
        let Some(name) = now.symmetric_difference(&listed).next() else { return Ok(()) };
        Err(NodeError::new(format!("`{name}` changed while the graph was running")).hint("run again"))
    }

    /// The bytes of a source file. Returns an error if the file changed since its digest was taken.
    ///
    /// # Panics
    /// If the kind's `sources` did not list the file.
    pub fn read(&self, file: &InputFile) -> Result<Vec<u8>, NodeError> {
        self.read_source(&self.root.file(file))
    }

    /// The bytes of the file `name` to which the source file `file` refers, such as a glTF buffer.
    pub fn read_sibling(&self, file: &InputFile, name: &str) -> Result<Vec<u8>, NodeError> {
        self.read_source(&self.root.sibling(&self.root.file(file), name))
    }

    fn read_source(&self, wanted: &SourceFile) -> Result<Vec<u8>, NodeError> {
        let failed = |e| NodeError::new(format!("cannot read `{}`: {e}", wanted.path.display()));
        // A pipe or a device may never end.
        if !std::fs::metadata(&wanted.path).map_err(failed)?.is_file() {
            return Err(NodeError::new(format!("`{}` is not a regular file", wanted.path.display())));
        }
        let bytes = std::fs::read(&wanted.path).map_err(failed)?;
        if self.parts.is_some() {
            let declared = self.sources.iter().find(|source| source.file == *wanted);
            let declared = declared.unwrap_or_else(|| {
                panic!("the kind reads `{}` but does not list it in `sources`", wanted.name)
            });
            if Digest::of(&bytes) != declared.digest {
                let what = format!("`{}` changed while the graph was running", wanted.name);
                return Err(NodeError::new(what).hint("run again"));
            }
        }
        Ok(bytes)
    }
}
