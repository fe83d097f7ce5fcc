//! Plans: what a run would do and why. A plan computes nothing that takes time.
//!
//! A node is known if its key is in the store. If it is not, the keys of the nodes downstream are unknown, since
//! they depend on its result. A plan runs kinds that are [`INSTANT`](crate::Kind::INSTANT) (a pose, a rig), so that
//! it shows exactly which nodes an edit affects.

use std::collections::BTreeSet;
use std::path::Path;

use cache::{Change, Digest, Manifest};

use crate::graph::graph::Graph;
use crate::graph::node::Wire;
use crate::record::action::{
    Action, is_usable, last_outputs, last_run, look_up, manifest_before, prepare, read_sources, sizes,
};
use crate::record::pace::Pace;
use crate::record::record::{Output, Record, Spent};
use crate::remote::placement::Placement;
use crate::run::code::{encode, stored_value};
use crate::run::engine::Engine;
use crate::run::event::Forecast;
use crate::run::job::context_of;
use crate::run::previous::Cone;
use crate::text::values::parse_value;
use crate::value::artifact::AnyArtifact;
use crate::value::error::{NodeError, guarded};

/// Planned treatment of a node.
#[derive(Debug, Clone, PartialEq)]
pub enum Fate {
    /// The node is not needed by any target.
    Unwanted,
    /// The result is in the cache.
    Known,
    /// The record is in the cache but the values are gone. The code runs again if another node needs the values.
    Lost,
    /// The code would run, for this reason.
    Runs(Why),
    /// The node depends on the result of the node with this name, which would run.
    Follows(String),
    /// The source files of the node cannot be read.
    Fails(String),
}

/// The reason why a node would run.
#[derive(Debug, Clone, PartialEq)]
pub enum Why {
    /// There is no record of an earlier run of a node with this name in this graph file.
    New,
    /// The key of the node differs from its key in the last run. The list contains the differences.
    Changed(Vec<Change>),
}

/// The plan of one node.
#[derive(Debug, Clone)]
pub struct Planned {
    /// Name of the node.
    pub id: String,
    /// Kind of the node.
    pub kind: &'static str,
    /// Planned treatment of the node.
    pub fate: Fate,
    /// Forecast of the node's time in seconds, from earlier runs of its kind. `None` if there were no such runs or
    /// if the node would not run. Cached parts are not considered, so with them the node takes less time.
    pub forecast: Option<f64>,
    /// The manifest of the node's key, if the key is known.
    pub manifest: Option<Manifest>,
}

/// History of a node, found by the name of the node and the name of its graph file.
#[derive(Debug, Clone, Default)]
pub struct Past {
    /// Time, memory and counts of the node's last run.
    pub spent: Option<Spent>,
    /// Differences between the key of the node and its previous key.
    pub changes: Vec<Change>,
}

impl Forecast {
    /// Summarises a plan.
    pub fn of(plan: &[Planned]) -> Self {
        let wanted = || plan.iter().filter(|node| node.fate != Fate::Unwanted);
        let open = || wanted().filter(|node| node.fate != Fate::Known);
        Self {
            open: open().count(),
            wanted: wanted().count(),
            // `sum` would give -0 for no nodes.
            seconds: open().filter_map(|node| node.forecast).fold(0.0, |sum, seconds| sum + seconds),
            untimed: open().filter(|node| node.forecast.is_none()).count(),
        }
    }
}

impl Engine {
    /// The plan of [`Engine::run`](crate::Engine::run), node by node in the order of the file.
    pub fn plan(&self, graph: &Graph, only: &[usize]) -> Vec<Planned> {
        self.plan_of(graph, only, Outlook::new(self, graph), |_| true)
    }

    /// The plan of the next run into `out`. Nodes that the previous run of this process left up to date count as
    /// known.
    pub(crate) fn plan_next(&self, graph: &Graph, only: &[usize], out: &Path) -> Vec<Planned> {
        let wanted = graph.wanted(only);
        let Some(warm) = &self.warm else { return self.plan(graph, only) };
        let previous = warm.previous();
        let cone =
            previous.as_ref().and_then(|previous| previous.cone(graph, only, &wanted, out, &self.store));
        let (Some(previous), Some(Cone { of, .. })) = (&*previous, cone) else {
            return self.plan(graph, only);
        };
        let mut outlook = Outlook::new(self, graph);
        for (index, slot) in previous.slots.iter().enumerate().filter(|(index, _)| !of[*index]) {
            if graph.nodes[index].kind.reads_files {
                outlook.actions[index].sources.clone_from(&slot.action.sources);
            }
            if graph.consumers(index).iter().any(|&below| of[below]) {
                outlook.records[index].clone_from(&slot.record);
            }
        }
        self.plan_of(graph, only, outlook, |index| of[index])
    }

    fn plan_of(
        &self,
        graph: &Graph,
        only: &[usize],
        mut outlook: Outlook<'_>,
        open: impl Fn(usize) -> bool,
    ) -> Vec<Planned> {
        let wanted = graph.wanted(only);
        let mut planned: Vec<Option<Planned>> = graph.nodes.iter().map(|_| None).collect();
        for &index in graph.order() {
            let fate = match (wanted[index], open(index)) {
                (false, _) => Fate::Unwanted,
                (true, false) => Fate::Known,
                (true, true) => outlook.fate(index),
            };
            planned[index] = Some(outlook.planned(index, fate));
        }
        planned.into_iter().flatten().collect()
    }

    /// The history of a node. `planned` is the plan of this node.
    pub fn past(&self, graph: &Graph, node: usize, planned: &Planned) -> Past {
        let (store, node) = (self.store(), &graph.nodes[node]);
        let spent = last_run(store, graph, node).map(|(spent, _)| spent);
        let change = |now: &Manifest| {
            // The key is the digest of its manifest.
            let before = manifest_before(store, graph, node, &Digest::of(now.as_bytes()))?;
            Some(written(&before, now))
        };
        Past { spent, changes: planned.manifest.as_ref().and_then(change).unwrap_or_default() }
    }

    /// Where a run would compute a node; `None` if the node would not run, or if the engine [sends](Self::sending) no
    /// nodes to workers. `planned` is the plan of this node.
    pub fn placement(&self, graph: &Graph, node: usize, planned: &Planned) -> Option<Placement> {
        let workers = self.workers.as_deref()?;
        let terms = workers.terms()?;
        if matches!(planned.fate, Fate::Unwanted | Fate::Known | Fate::Fails(_)) {
            return None;
        }
        let spec = &graph.nodes[node];
        let wires: BTreeSet<Wire> = spec.inputs.iter().flatten().copied().collect();
        let length = |wire: &Wire| {
            let record = last_outputs(self.store(), graph, &graph.nodes[wire.node])?;
            let digest = record.outputs[wire.port].digest;
            if workers.holds(&digest) { None } else { self.store().blob_length(&digest) }
        };
        let bytes = wires.iter().filter_map(length).sum();
        Some(Placement::of(&spec.kind, spec.sink_path.is_some(), planned.forecast, bytes, &terms))
    }

    /// Time, memory and work counts of a node without a cache, as measured in the last run of the node with this
    /// name in this graph file.
    pub fn spent(&self, graph: &Graph, node: usize) -> Option<Spent> {
        last_outputs(self.store(), graph, &graph.nodes[node]).map(|record| record.spent)
    }

    /// The content digests of a node's outputs in its last run, in the order of its ports.
    pub fn digests(&self, graph: &Graph, node: usize) -> Option<Vec<Digest>> {
        let record = last_outputs(self.store(), graph, &graph.nodes[node])?;
        Some(record.outputs.iter().map(|output| output.digest).collect())
    }
}

/// State of a plan: the facts known about each node. Nodes are visited in topological order.
pub(crate) struct Outlook<'a> {
    engine: &'a Engine,
    graph: &'a Graph,
    /// Records of the nodes whose output digests are known. A record comes from the store, or from running an
    /// instant node.
    pub records: Vec<Option<Record>>,
    pub actions: Vec<Action>,
    /// Values of instant nodes that the plan ran.
    values: Vec<Option<Vec<AnyArtifact>>>,
}

impl<'a> Outlook<'a> {
    pub fn new(engine: &'a Engine, graph: &'a Graph) -> Self {
        Self {
            engine,
            graph,
            records: graph.nodes.iter().map(|_| None).collect(),
            actions: graph.nodes.iter().map(|_| Action::default()).collect(),
            values: graph.nodes.iter().map(|_| None).collect(),
        }
    }

    /// The fate of a node that a target needs.
    pub fn fate(&mut self, index: usize) -> Fate {
        let (graph, store) = (self.graph, self.engine.store());
        let node = &graph.nodes[index];
        if let Some(wire) = node.inputs.iter().flatten().find(|wire| self.records[wire.node].is_none()) {
            return Fate::Follows(graph.nodes[wire.node].id.clone());
        }
        let action = match self.action(index) {
            Ok(action) => action,
            Err(error) => return Fate::Fails(error.to_string()),
        };
        let key = action.digest();
        let record = look_up(store, node, &key).filter(|record| is_usable(graph, index, record, store));
        self.actions[index] = action;
        if let Some(record) = record {
            let gone = |output: &Output| output.stored && !store.has_blob(&output.digest);
            let lost = record.outputs.iter().any(gone);
            self.records[index] = Some(record);
            return if lost { Fate::Lost } else { Fate::Known };
        }
        if node.kind.instant {
            self.find_out(index);
        }
        let manifest = self.actions[index].key.as_ref().map(|key| &key.manifest);
        match (manifest, last_run(store, graph, node)) {
            (Some(new), Some((_, last))) => Fate::Runs(Why::Changed(written(&last, new))),
            _ => Fate::Runs(Why::New),
        }
    }

    fn planned(&self, index: usize, fate: Fate) -> Planned {
        let (graph, store) = (self.graph, self.engine.store());
        let node = &graph.nodes[index];
        let key = self.actions[index].key.as_ref();
        let last = || last_run(store, graph, node).map(|(spent, _)| spent.work);
        let runs = matches!(fate, Fate::Runs(_) | Fate::Follows(_) | Fate::Lost);
        let forecast = runs
            .then(|| self.work(index).or_else(last))
            .flatten()
            .and_then(|work| Pace::of(store, &node.kind).seconds(work))
            .map(|seconds| seconds * new_share(&fate, node.kind.preview.refines));
        let manifest = key.map(|key| key.manifest.clone());
        Planned { id: node.id.clone(), kind: node.kind.name, fate, forecast, manifest }
    }

    /// The work of a node, computed from the sizes of its inputs. If the current size of an input is unknown, its
    /// size in the last run is used.
    fn work(&self, index: usize) -> Option<f64> {
        let node = &self.graph.nodes[index];
        let reads = self.graph.reads(index).iter();
        let known = reads.map(|&above| {
            let last = || last_outputs(self.engine.store(), self.graph, &self.graph.nodes[above]);
            Some((above, self.records[above].clone().or_else(last)?))
        });
        let known: Vec<(usize, Record)> = known.collect::<Option<_>>()?;
        let output = |wire: Wire| -> &Output {
            let (_, record) = known
                .iter()
                .find(|(above, _)| *above == wire.node)
                .expect("a wire starts at a node that is read");
            &record.outputs[wire.port]
        };
        let sizes = sizes(node, &self.actions[index].sources, output);
        node.step.work(&sizes).ok()
    }

    /// The [`Action`] of a node. The outputs of the nodes that it reads must be known.
    fn action(&self, index: usize) -> Result<Action, NodeError> {
        let output = |wire: Wire| -> &Output {
            &self.records[wire.node].as_ref().expect("only nodes with known inputs are looked up").outputs
                [wire.port]
        };
        let sources = read_sources(self.graph, index, self.engine.store())?;
        prepare(
            self.graph,
            index,
            sources,
            output,
            |above| self.actions[above].sources.as_slice(),
            Vec::new(),
        )
    }

    /// Runs an instant node, and the instant nodes that it reads, without storing their results.
    fn find_out(&mut self, index: usize) {
        let mut open = vec![index];
        while let Some(&node) = open.last() {
            let reads = self.graph.reads(node);
            let missing: Vec<usize> =
                reads.iter().copied().filter(|&above| self.values[above].is_none()).collect();
            if self.values[node].is_some() || self.load(node) {
                open.pop();
            } else if !self.graph.nodes[node].kind.instant {
                return;
            } else if !missing.is_empty() {
                open.extend(missing);
            } else if self.run(node).is_some() {
                open.pop();
            } else {
                return;
            }
        }
    }

    /// Loads all values of a node from the store. Returns false if one is missing.
    fn load(&mut self, index: usize) -> bool {
        let Some(record) = &self.records[index] else { return false };
        let ports = self.graph.nodes[index].kind.outputs.iter().zip(&record.outputs);
        let values = ports.map(|(port, output)| {
            let kept = Some(&output.digest).filter(|_| output.stored);
            stored_value(self.engine.store(), &port.artifact, kept?)
        });
        self.values[index] = values.collect();
        self.values[index].is_some()
    }

    fn run(&mut self, index: usize) -> Option<()> {
        let (graph, node) = (self.graph, &self.graph.nodes[index]);
        let value = |wire: &Wire| self.values[wire.node].as_ref()?.get(wire.port).cloned();
        let inputs =
            node.inputs.iter().map(|wires| wires.iter().map(value).collect()).collect::<Option<_>>()?;
        let context = context_of(graph, index, &self.actions[index]);
        let (values, notes) = node.step.run(inputs, &context).ok()?;
        let (outputs, _) = guarded(|| Ok(encode(node, &values))).ok()?;
        self.records[index] = Some(Record { outputs, files: Vec::new(), notes, spent: Spent::default() });
        self.values[index] = Some(values);
        Some(())
    }
}

/// Fraction of a node's work that is new, from 0 to 1. It is less than 1 only if nothing but the parameter
/// named by `refines` has changed.
fn new_share(fate: &Fate, refines: Option<&str>) -> f64 {
    let Fate::Runs(Why::Changed(changes)) = fate else { return 1.0 };
    let ([Change { path, old: Some(old), new: Some(new) }], Some(refines)) = (changes.as_slice(), refines)
    else {
        return 1.0;
    };
    match (old.parse::<f64>(), new.parse::<f64>()) {
        (Ok(old), Ok(new)) if path == refines && new > 0.0 => ((new - old) / new).clamp(0.0, 1.0),
        _ => 1.0,
    }
}

/// The differences between two manifests, with values in the notation of graph files.
fn written(old: &Manifest, new: &Manifest) -> Vec<Change> {
    Manifest::difference(old, new).into_iter().map(as_written).collect()
}

/// Removes the outer quotes from string parameters. Manifests contain them as RON strings.
fn as_written(change: Change) -> Change {
    let plain = |value: String| parse_value::<String>(&value).unwrap_or(value);
    Change { path: change.path, old: change.old.map(plain), new: change.new.map(plain) }
}
