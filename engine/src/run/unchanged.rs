//! Remembers across processes that a run found everything up to date. If nothing has changed since, the next run
//! reports the same events without parsing the graph or making keys.
//!
//! A run depends on the program, the text of the graph, the kinds in it, the source files, and the output files.
//! The text and the kinds are compared by digest, and the source files are listed again. The program and all files
//! are compared by stamps: any change to a file changes its stamp. If anything differs or is uncertain, an ordinary
//! run takes place.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use cache::{Digest, FileStamp, Store};

use crate::graph::graph::Graph;
use crate::kind::registry::{KindEntry, Registry};
use crate::record::action::history_name;
use crate::record::record;
use crate::record::record::Record;
use crate::run::event::{Event, State, Totals};
use crate::run::options::Outcome;
use crate::run::sink;
use crate::run::slot::{Life, Slot};
use crate::text::source::Source;
use crate::value::codec::{Corrupt, Decoder, Encoder};
use crate::value::cpu;
use crate::value::root::SourceRoot;

/// Format of the stored bytes. Its number is raised when the layout changes.
const FORMAT: &str = "lightharmony unchanged 2";

/// Reports what a run of all sinks would report, if the cache in `folder` remembers a run that found everything up
/// to date and nothing has changed since. Otherwise reports nothing and returns `None`; the caller must then run
/// the graph.
pub fn run_unchanged(
    folder: &Path,
    source: &Source,
    registry: &Registry,
    root: &SourceRoot,
    out: &Path,
    mut emit: impl FnMut(Event),
) -> Option<Outcome> {
    let bytes = cache::last_run(folder, &name(source, root))?;
    let (events, totals) = read(&bytes, source, registry, root, out).ok().flatten()?;
    events.into_iter().for_each(&mut emit);
    emit(Event::Done(totals.clone()));
    Some(Outcome { totals, failures: None })
}

/// Stores the outcome of a run that found everything up to date. Nothing is stored for an untrusted graph, since
/// every run of such a graph must check the output folder for links. Nothing is stored either if a file is so
/// recent that it may change without a new stamp.
pub(crate) fn keep(store: &Store, graph: &Graph, out: &Path, slots: &[Slot]) {
    if let Some(bytes) = written(store, graph, out, slots) {
        store.last_run_put(&name(&graph.source, &graph.root), &bytes);
    }
}

fn name(source: &Source, root: &SourceRoot) -> String {
    format!("unchanged\n{}", history_name(source, root))
}

/// Digest of everything that a run depends on, except kinds and files.
fn premise(source: &Source, root: &SourceRoot, out: &Path) -> Option<Digest> {
    let mut of = Encoder::default();
    of.str(FORMAT);
    // Another build may check graphs by other rules, find other source files, or report something else.
    of.raw(&FileStamp::of(&std::env::current_exe().ok()?).ok()?.to_bytes());
    of.str(crate::record::key::FORMAT);
    of.str(crate::record::recipe::HEAD);
    // The use of results is recorded once a day by an ordinary run.
    of.u64(cache::today());
    of.u8s(Digest::of(source.text.as_bytes()).as_bytes());
    of.u8s(root.folder().as_os_str().as_encoded_bytes());
    of.u8s(out.as_os_str().as_encoded_bytes());
    of.u8s(std::path::absolute(out).ok()?.as_os_str().as_encoded_bytes());
    (!root.is_confined()).then(|| Digest::of(&of.finish()))
}

/// Digest of a kind, including compiled-in data.
fn kind_digest(kind: &KindEntry) -> Digest {
    let mut of = Encoder::default();
    of.u32(kind.version);
    of.str(kind.profile);
    of.raw(Digest::of(kind.data).as_bytes());
    Digest::of(&of.finish())
}

/// The stamp of the file at `path`. `None` if the store has no record that a file with this stamp has the digest
/// `digest`.
fn trusted(store: &Store, path: &Path, digest: &Digest) -> Option<[u8; 40]> {
    let stamp = FileStamp::of(path).ok()?;
    (store.memo_get(path, &stamp)? == *digest).then(|| stamp.to_bytes())
}

fn written(store: &Store, graph: &Graph, out: &Path, slots: &[Slot]) -> Option<Vec<u8>> {
    let mut to = Encoder::default();
    to.raw(premise(&graph.source, &graph.root, out)?.as_bytes());
    let done: Vec<usize> =
        graph.order().iter().copied().filter(|&node| slots[node].life == Life::Done).collect();
    let kinds: BTreeMap<&str, &KindEntry> =
        done.iter().map(|&node| &*graph.nodes[node].kind).map(|kind| (kind.name, kind)).collect();
    to.u32(kinds.len() as u32);
    for (name, kind) in &kinds {
        to.str(name);
        to.raw(kind_digest(kind).as_bytes());
    }
    let numbers: BTreeMap<&str, u32> = kinds.keys().copied().zip(0..).collect();
    let reading: Vec<usize> =
        done.iter().copied().filter(|&node| graph.nodes[node].kind.reads_files).collect();
    to.u32(reading.len() as u32);
    for index in reading {
        let node = &graph.nodes[index];
        to.u32(numbers[node.kind.name]);
        to.u8s(&node.texts());
        let sources = &slots[index].action.sources;
        to.u32(sources.len() as u32);
        for source in sources {
            to.str(&source.file.name);
            to.raw(&trusted(store, &source.file.path, &source.digest)?);
        }
    }
    to.u32(done.len() as u32);
    for index in done {
        let (node, slot) = (&graph.nodes[index], &slots[index]);
        let Record { files, notes, .. } = slot.record.as_ref()?;
        to.str(&node.id);
        to.u32(numbers[node.kind.name]);
        to.raw(slot.key?.as_bytes());
        to.bool(slot.degraded);
        record::write_notes(&mut to, notes);
        let targets = match &node.sink_path {
            Some(template) => sink::targets(out, template, files).ok()?,
            None => Vec::new(),
        };
        to.u32(targets.len() as u32);
        for (path, digest) in targets {
            to.str(path.to_str()?);
            to.raw(&trusted(store, &path, &digest)?);
        }
    }
    Some(to.finish())
}

/// The events to report, except `Done`, and the totals; `None` if anything changed.
fn read(
    bytes: &[u8],
    source: &Source,
    registry: &Registry,
    root: &SourceRoot,
    out: &Path,
) -> Result<Option<(Vec<Event>, Totals)>, Corrupt> {
    let (start, start_cpu) = (std::time::Instant::now(), cpu::of_process());
    let mut from = Decoder::new(bytes);
    let was = Digest::from_bytes(from.array()?);
    if premise(source, root, out) != Some(was) {
        return Ok(None);
    }
    let mut kinds = Vec::new();
    for _ in 0..from.count(8 + 32)? {
        match registry.get(&from.str()?) {
            Some(kind) if from.array()? == *kind_digest(kind).as_bytes() => kinds.push(kind),
            _ => return Ok(None),
        }
    }
    let unknown = || Corrupt("the number of a kind is unknown".to_owned());
    let unmoved = |path: &Path, was: [u8; 40]| FileStamp::of(path).is_ok_and(|is| is.to_bytes() == was);
    for _ in 0..from.count(4 + 8 + 4)? {
        let kind = kinds.get(from.u32()? as usize).ok_or_else(unknown)?;
        let Some(step) = kind.step_of(from.raw()?) else { return Ok(None) };
        let Ok(sources) = step.sources(root) else { return Ok(None) };
        if from.count(8 + 40)? != sources.len() {
            return Ok(None);
        }
        for source in sources {
            if from.raw()? != source.name.as_bytes() || !unmoved(&source.path, from.array()?) {
                return Ok(None);
            }
        }
    }
    let mut totals = Totals::default();
    let count = from.count(8 + 4 + 32 + 1 + 8 + 4)?;
    let mut events = Vec::with_capacity(count + 1);
    for _ in 0..count {
        let id = from.str()?;
        let kind = kinds.get(from.u32()? as usize).ok_or_else(unknown)?.name;
        let key = Some(Digest::from_bytes(from.array()?));
        let degraded = from.bool()?;
        let notes = record::read_notes(&mut from)?.iter().cloned().collect();
        for _ in 0..from.count(8 + 40)? {
            let path = PathBuf::from(from.str()?);
            if !unmoved(&path, from.array()?) {
                return Ok(None);
            }
            events.push(Event::File { id: id.clone(), path, written: false, preview: false });
        }
        totals.add(State::Cached);
        totals.degraded += usize::from(degraded);
        let (state, counts, error) = (State::Cached, BTreeMap::new(), None);
        let (seconds, cpu_seconds) = (0.0, 0.0);
        events.push(Event::Node {
            id,
            kind,
            state,
            key,
            seconds,
            cpu_seconds,
            counts,
            notes,
            degraded,
            error,
        });
    }
    from.end()?;
    totals.seconds = start.elapsed().as_secs_f64();
    totals.cpu_seconds = (cpu::of_process() - start_cpu).as_secs_f64();
    Ok(Some((events, totals)))
}
