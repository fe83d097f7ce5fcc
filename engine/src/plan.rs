//! Plans: what a run would do and why, without running anything.

use cache::{Change, Digest, Manifest};

use crate::action::{Action, last_outputs, last_run, look_up, prepare, read_sources};
use crate::error::NodeError;
use crate::graph::{Graph, Wire};
use crate::record::{Output, Record};
use crate::schedule::Engine;
use crate::syntax::parse_value;

/// What a run would do with a node.
#[derive(Debug, Clone, PartialEq)]
pub enum Fate {
    /// No target stands below it.
    Unwanted,
    /// Its result is known.
    Known,
    /// Its result is known but no longer kept; its code runs again if a reader needs it.
    Lost,
    /// Its code would run.
    Runs(Why),
    /// Whether it runs depends on what the named node above it gives; that one would run.
    Follows(String),
    /// Its sources cannot be read.
    Fails(String),
}

/// Why a node would run.
#[derive(Debug, Clone, PartialEq)]
pub enum Why {
    /// A node of this name never ran in this graph file, or nothing of it is kept.
    New,
    /// What its key is made of differs from the last run.
    Changed(Vec<Change>),
}

/// What a run would do with one node.
#[derive(Debug, Clone)]
pub struct Planned {
    /// Name of the node.
    pub id: String,
    /// Its kind.
    pub kind: &'static str,
    /// What would happen.
    pub fate: Fate,
    /// Seconds that its code took last time.
    pub forecast: Option<f64>,
    /// What its key is made of, where it is known: (path, value).
    pub manifest: Option<Manifest>,
}

/// A plan in one line.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Forecast {
    /// Nodes that may run. Fewer do where a result comes out equal.
    pub open: usize,
    /// Nodes that are wanted.
    pub wanted: usize,
    /// What those that may run took the last time, together.
    pub seconds: f64,
    /// Of them, those that never ran.
    pub untimed: usize,
}

impl Forecast {
    /// Sums a plan up.
    pub fn of(plan: &[Planned]) -> Self {
        let wanted = || plan.iter().filter(|node| node.fate != Fate::Unwanted);
        let open = || wanted().filter(|node| node.fate != Fate::Known);
        Self {
            open: open().count(),
            wanted: wanted().count(),
            seconds: open().filter_map(|node| node.forecast).sum(),
            untimed: open().filter(|node| node.forecast.is_none()).count(),
        }
    }
}

impl Engine {
    /// What [`Engine::run`] would do, node by node in the order of the file.
    pub fn plan(&self, graph: &Graph, only: &[usize]) -> Vec<Planned> {
        let targets = if only.is_empty() { graph.targets() } else { only.to_vec() };
        let wanted = graph.above(&targets);
        let mut records: Vec<Option<Record>> = graph.nodes.iter().map(|_| None).collect();
        let mut actions: Vec<Action> = graph.nodes.iter().map(|_| Action::default()).collect();
        let mut planned: Vec<Option<Planned>> = graph.nodes.iter().map(|_| None).collect();
        for &index in graph.order() {
            let node = &graph.nodes[index];
            let last = last_run(self.store(), graph, node);
            let forecast = last.as_ref().map(|(seconds, _)| *seconds);
            let unknown = node.inputs.iter().flatten().find(|wire| records[wire.node].is_none());
            let fate = if !wanted[index] {
                Fate::Unwanted
            } else if let Some(wire) = unknown {
                Fate::Follows(graph.nodes[wire.node].id.clone())
            } else {
                match self.known(graph, index, &records, &actions) {
                    Err(error) => Fate::Fails(error.to_string()),
                    Ok((action, record)) => {
                        let known = record.is_some();
                        let gone = |output: &Output| output.stored && !self.store().has_blob(&output.digest);
                        let lost = record.as_ref().is_some_and(|record| record.outputs.iter().any(gone));
                        records[index] = record;
                        actions[index] = action;
                        let manifest = actions[index].key.as_ref().map(|key| &key.manifest);
                        match (known, manifest, last) {
                            (true, ..) if lost => Fate::Lost,
                            (true, ..) => Fate::Known,
                            (false, Some(new), Some((_, last))) => {
                                let changes = Manifest::difference(&last, new);
                                Fate::Runs(Why::Changed(changes.into_iter().map(as_written).collect()))
                            }
                            _ => Fate::Runs(Why::New),
                        }
                    }
                }
            };
            let manifest = actions[index].key.as_ref().map(|key| key.manifest.clone());
            planned[index] =
                Some(Planned { id: node.id.clone(), kind: node.kind.name, fate, forecast, manifest });
        }
        planned.into_iter().flatten().collect()
    }

    /// The content digests of a node's outputs as of its last run, in the order of its ports.
    pub fn digests(&self, graph: &Graph, node: usize) -> Option<Vec<Digest>> {
        let record = last_outputs(self.store(), graph, &graph.nodes[node])?;
        Some(record.outputs.iter().map(|output| output.digest).collect())
    }

    fn known(
        &self,
        graph: &Graph,
        index: usize,
        records: &[Option<Record>],
        actions: &[Action],
    ) -> Result<(Action, Option<Record>), NodeError> {
        let output = |wire: Wire| -> &Output {
            &records[wire.node].as_ref().expect("only nodes with known inputs are looked up").outputs
                [wire.port]
        };
        let sources = read_sources(graph, index, self.store())?;
        let action = prepare(graph, index, sources, output, |above| actions[above].sources.as_slice())?;
        let record = look_up(self.store(), &graph.nodes[index], &action.digest());
        Ok((action, record))
    }
}

/// Keys hold parameters as text in RON; shown as they would be written in a graph file.
fn as_written(change: Change) -> Change {
    let plain = |value: String| parse_value::<String>(&value).unwrap_or(value);
    Change { path: change.path, old: change.old.map(plain), new: change.new.map(plain) }
}
