//! Verifies a bundle: recomputes some of its nodes and compares the results.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use cache::{Digest, Options, Store, TempFolder};

use crate::graph::graph::Graph;
use crate::kind::port::PortSpec;
use crate::kind::registry::Registry;
use crate::plan::lock::Lock;
use crate::plan::plan::{Fate, Outlook};
use crate::record::record::Record;
use crate::run::code::stored_value;
use crate::run::engine::Engine;
use crate::run::event::Event;
use crate::run::options::RunOptions;
use crate::share::bundle::container::{Bundle, BundleError};
use crate::share::bundle::names::{GRAPH, LOCK};
use crate::share::bundle::unpack::cause;
use crate::text::diag::Diagnostics;
use crate::text::source::Source;
use crate::value::artifact::Difference;
use crate::value::root::SourceRoot;

/// Options of a verification.
pub struct VerifyOptions<'a> {
    /// Number of nodes to recompute.
    pub sample: usize,
    /// Seed of the random choice of nodes.
    pub seed: u64,
    /// Number of threads.
    pub jobs: usize,
    /// Memory budget in bytes.
    pub memory: u64,
    /// Folder for temporary files.
    pub folder: &'a Path,
    /// Flag that the caller sets to cancel the verification.
    pub cancel: Arc<AtomicBool>,
}

/// The outcome for a recomputed node.
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// All outputs are equal to the outputs in the bundle.
    Equal,
    /// An output differs.
    Differs {
        /// Name of the output.
        output: String,
        /// Difference between the two values, in terms that suit their type. `None` if the bundle does not contain
        /// the value.
        difference: Option<Difference>,
    },
    /// The inputs of the node differ from those in the bundle, so its outputs cannot be compared.
    OtherInputs,
    /// The node runs an external program, which a verification does not run again. Its results were taken from the
    /// bundle without a check.
    NotReproducible,
    /// The node did not run.
    Failed,
}

/// The outcome of a verification.
#[derive(Debug)]
pub struct Verified {
    /// The nodes that run programs, and then the recomputed nodes, each in the order of the graph.
    pub nodes: Vec<(String, Verdict)>,
    /// Number of nodes with a known result, from which the recomputed nodes were chosen.
    pub known: usize,
    /// Kinds, source files and results that differ from the lock.
    pub differences: Vec<String>,
    /// Failures of nodes.
    pub failures: Option<Diagnostics>,
}

impl Verified {
    /// True if all compared outputs are equal.
    pub fn is_good(&self) -> bool {
        let is_good = |verdict: &Verdict| matches!(verdict, Verdict::Equal | Verdict::NotReproducible);
        self.differences.is_empty() && self.nodes.iter().all(|(_, verdict)| is_good(verdict))
    }
}

/// Reads a whole bundle, recomputes some of its nodes and compares the results. The results of the other nodes are
/// taken from the bundle without a check. These include the results of all nodes that run programs, each of which has
/// the verdict [`Verdict::NotReproducible`].
///
/// # Errors
/// If the bundle is invalid or its graph cannot run.
pub fn verify<R: Read + Seek>(
    bundle: &mut Bundle<R>,
    registry: &Registry,
    options: &VerifyOptions<'_>,
    mut emit: impl FnMut(Event),
) -> Result<Verified, BundleError> {
    let refused = |error: &dyn std::fmt::Display| BundleError::Refused(error.to_string());
    bundle.check()?;
    let failed = |source| BundleError::Io { what: "cannot create a temporary folder".to_owned(), source };
    let place = TempFolder::create_in(options.folder).map_err(|error| BundleError::Refused(cause(error)))?;
    let folder = place.path().join("graph");
    bundle.unpack(&folder)?;
    let lock = Lock::parse(&Source::new(LOCK, bundle.lock_text()?)).map_err(|e| refused(&e))?;
    let root = SourceRoot::confined(&folder, &[]).map_err(failed)?.stating_programs(lock.programs());
    let graph =
        Graph::parse(Source::packed(GRAPH, bundle.graph_text()?), registry, root).map_err(|e| refused(&e))?;
    let open = |name: &str| -> Result<Engine, BundleError> {
        let store = Store::open(&place.path().join(name), Options::default()).map_err(|e| refused(&e))?;
        Ok(Engine::new(store, options.jobs, options.memory))
    };

    // The results claimed by the bundle, by the keys of this program.
    let claimed = open("claimed")?;
    bundle.fill(claimed.store())?;
    let mut outlook = Outlook::new(&claimed, &graph);
    let mut known: BTreeMap<usize, (Digest, Record)> = BTreeMap::new();
    for &index in graph.order() {
        let fate = outlook.fate(index);
        let is_known = matches!(fate, Fate::Known | Fate::Lost);
        if let (true, Some(record)) = (is_known, &outlook.records[index]) {
            known.insert(index, (outlook.actions[index].digest(), record.clone()));
        }
    }
    let now = claimed.lock(&graph, &(0..graph.nodes.len()).collect::<Vec<_>>()).map_err(|e| refused(&e))?;
    let mut differences = lock.differences(&now).before;
    // Kinds and source files are equal, but the lock has a result without a record in the bundle.
    if differences.is_empty() {
        let missing = lock.results.keys().filter(|id| !now.results.contains_key(*id));
        let text = |id| format!("the lock has a result of `{id}`, but the bundle has no record of it");
        differences.extend(missing.map(text));
    }
    differences.extend(lock.differences(&now).results);

    let runs_programs = |index: &usize| graph.nodes[*index].kind.runs_programs;
    let mut nodes: Vec<(String, Verdict)> = Vec::new();
    for index in known.keys().filter(|index| runs_programs(index)) {
        nodes.push((graph.nodes[*index].id.clone(), Verdict::NotReproducible));
    }
    let chosen = chosen(&graph, known.keys().copied().filter(|index| !runs_programs(index)), options);
    let chosen_keys: BTreeSet<[u8; 32]> = chosen.iter().map(|index| *known[index].0.as_bytes()).collect();

    // A store with all results except theirs. Their values are left out as well, since they may be wrong.
    let recomputed = open("recomputed")?;
    let kept = bundle.values().into_iter().map(|(digest, _)| digest).collect();
    for (key, content) in bundle.records() {
        if !chosen_keys.contains(key.as_bytes()) {
            bundle.put_record(recomputed.store(), &key, content, &kept)?;
        }
    }
    for (digest, content) in bundle.values() {
        let bytes = bundle.read(content)?;
        recomputed.store().put_blob_as(&digest, &bytes).map_err(|e| refused(&e))?;
    }
    if chosen.is_empty() {
        return Ok(Verified { nodes, known: known.len(), differences, failures: None });
    }
    let only: Vec<usize> = chosen.iter().copied().collect();
    let (out, cancel) = (place.path().join("out"), options.cancel.clone());
    let run = RunOptions { out, only, cancel, ..RunOptions::default() };
    let outcome = recomputed.run(&graph, &run, &mut emit);

    let mut made = Outlook::new(&recomputed, &graph);
    for &index in graph.order() {
        let fate = made.fate(index);
        if !chosen.contains(&index) {
            continue;
        }
        let (key, record) = &known[&index];
        let node = &graph.nodes[index];
        let same_key = made.actions[index].key.as_ref().is_some_and(|now| now.digest == *key);
        let verdict = match (fate, &made.records[index]) {
            (Fate::Known | Fate::Lost, Some(now)) if same_key => {
                verdict(&node.kind.outputs, [(&claimed, record), (&recomputed, now)])
            }
            (Fate::Known | Fate::Lost, Some(_)) => Verdict::OtherInputs,
            _ => Verdict::Failed,
        };
        nodes.push((node.id.clone(), verdict));
    }
    Ok(Verified { nodes, known: known.len(), differences, failures: outcome.failures })
}

/// Compares two results of a node for the same key: the result in the bundle and the recomputed result. Each is
/// given with the engine whose store contains its values.
fn verdict(ports: &[PortSpec], [claimed, made]: [(&Engine, &Record); 2]) -> Verdict {
    let mut pairs = ports.iter().zip(claimed.1.outputs.iter().zip(&made.1.outputs));
    let Some((port, (then, now))) = pairs.find(|(_, (then, now))| then.digest != now.digest) else {
        return Verdict::Equal;
    };
    let value = |engine: &Engine, digest| stored_value(engine.store(), &port.artifact, digest);
    let pair = value(claimed.0, &then.digest).zip(value(made.0, &now.digest));
    let difference = pair.map(|(then, now)| port.artifact.difference(&then, &now));
    Verdict::Differs { output: port.name.to_owned(), difference }
}

/// Indices of the nodes to recompute. These are the nodes for which the hash of the seed and the node name is
/// lowest.
fn chosen(graph: &Graph, known: impl Iterator<Item = usize>, options: &VerifyOptions<'_>) -> BTreeSet<usize> {
    let rank = |index: usize| {
        *Digest::of(format!("{} {}", options.seed, graph.nodes[index].id).as_bytes()).as_bytes()
    };
    let mut all: Vec<usize> = known.collect();
    all.sort_by_key(|&index| rank(index));
    all.into_iter().take(options.sample).collect()
}
