//! The state of the watched graph, as a page shows it.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Instant;

use engine::{Digest, Event, Graph, Mistake, Note, State as Ended, StoredOutput, Wire};
use serde::Serialize;
use serde_json::{Value, json};

use crate::editor::SharedGraph;
use crate::history::now;
use crate::values::SHOWN;

/// Progress of a node.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum NodeStatus {
    /// The node has not run since the page was started.
    #[default]
    Unknown,
    /// The code of the node runs.
    Running,
    /// The code ran.
    Ran,
    /// The result came from the cache.
    Cached,
    /// The code failed.
    Failed,
    /// The node was skipped.
    Skipped,
}

impl From<Ended> for NodeStatus {
    fn from(state: Ended) -> Self {
        match state {
            Ended::Ran => Self::Ran,
            Ended::Cached => Self::Cached,
            Ended::Failed => Self::Failed,
            Ended::Skipped => Self::Skipped,
        }
    }
}

/// State of a node.
#[derive(Debug, Clone, Default, Serialize)]
pub struct NodeState {
    status: NodeStatus,
    /// Progress from 0 to 1 while the code runs.
    fraction: f32,
    /// Wall time of the code in seconds.
    seconds: f64,
    /// CPU time of the code in seconds.
    cpu_seconds: f64,
    /// Forecast of the wall time in seconds.
    forecast: Option<f64>,
    /// True if the result is a preview.
    preview: bool,
    degraded: bool,
    error: Option<String>,
    notes: Vec<Note>,
    outputs: Vec<Output>,
    #[serde(skip)]
    started: Option<Instant>,
    /// Key of a result whose record is not in the store yet.
    #[serde(skip)]
    pending: Option<Digest>,
    /// Key of the last result.
    #[serde(skip)]
    key: Option<Digest>,
}

/// The pictures that the targets of the graph read, after a preview or at the end of a run.
#[derive(Debug, Clone, Serialize)]
pub struct Refinement {
    /// The parameter that limits the preview, its limit, its value in the graph, and the side of the blocks of
    /// pixels that the preview computes; `None` for the result.
    pass: Option<Value>,
    /// Time since the start of the run in seconds.
    seconds: f64,
    /// Type and digest of each picture, by node and output.
    values: BTreeMap<String, (String, String)>,
}

/// Value of an output.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Output {
    port: &'static str,
    #[serde(rename = "type")]
    type_name: &'static str,
    digest: String,
    stored: bool,
}

/// State of the graph and of its run.
#[derive(Default)]
pub struct State {
    /// The last graph that had no mistakes.
    pub graph: Option<SharedGraph>,
    /// Indices of the targets of this graph; empty for the default targets.
    pub only: Vec<usize>,
    /// Text of the graph file when it was read last; empty if it could not be read.
    pub text: String,
    /// Digest of this text.
    pub digest: String,
    /// Mistakes of this text, or of the run.
    pub mistakes: Vec<Mistake>,
    /// The reason why the graph cannot be read.
    pub problem: Option<String>,
    nodes: BTreeMap<String, NodeState>,
    running: bool,
    pass: Option<Value>,
    /// Start of the current run, with its previews.
    began: Option<Instant>,
    refinements: Vec<Refinement>,
    forecast: Option<Value>,
    done: Option<Value>,
    files: BTreeMap<String, Value>,
    warnings: Vec<String>,
    /// Digest and type of earlier values of outputs, the oldest first. They are kept because a page may still
    /// request a value that was replaced a moment ago.
    recent: VecDeque<(String, &'static str)>,
}

/// Maximum number of earlier values that pages may request.
const MOST_RECENT: usize = 1000;
/// Maximum number of previews of one run that are kept.
const MOST_REFINEMENTS: usize = 64;
/// Maximum number of pictures of each preview that are kept.
const MOST_PICTURES: usize = 256;
/// Maximum number of warnings that are kept.
const MOST_WARNINGS: usize = 20;

impl State {
    /// The state as JSON.
    pub fn json(&self) -> Value {
        json!({
            "digest": self.digest,
            "mistakes": self.mistakes,
            "problem": self.problem,
            "nodes": self.nodes,
            "running": self.running,
            "pass": self.pass,
            "plan": self.forecast,
            "done": self.done,
            "files": self.files,
            "warnings": self.warnings,
            "refinements": self.refinements,
        })
    }

    /// Keeps only the states of nodes that the graph still has.
    pub fn retain(&mut self, graph: &Graph) {
        self.nodes.retain(|id, _| graph.find(id).is_some());
        let known: Vec<&str> = graph.nodes.iter().map(|node| node.id.as_str()).collect();
        self.files.retain(|_, file| file["id"].as_str().is_some_and(|id| known.contains(&id)));
    }

    /// Updates the state from an event of the watch. `outputs` returns the outputs of a result by its key. Returns
    /// the JSON of the event with the new state of its node.
    pub fn update(
        &mut self,
        event: &Event,
        outputs: impl Fn(&str, &Digest) -> Option<Vec<StoredOutput>>,
    ) -> Option<Value> {
        let mut extra = None;
        match event {
            Event::Start { id, forecast, .. } => {
                let node = self.nodes.entry(id.clone()).or_default();
                node.status = NodeStatus::Running;
                (node.fraction, node.forecast, node.error) = (0.0, *forecast, None);
                node.started = Some(Instant::now());
                self.running = true;
                extra = Some(id);
            }
            Event::Progress { id, fraction } => {
                let node = self.nodes.entry(id.clone()).or_default();
                (node.status, node.fraction) = (NodeStatus::Running, *fraction);
            }
            Event::Node { id, state, key, seconds, cpu_seconds, notes, degraded, error, .. } => {
                let preview = self.pass.is_some();
                let node = self.nodes.entry(id.clone()).or_default();
                let known = key.and_then(|key| outputs(id, &key));
                if known.is_some() {
                    replaced(&mut self.recent, &node.outputs);
                }
                let pending = key.filter(|_| known.is_none() && matches!(state, Ended::Ran | Ended::Cached));
                *node = NodeState {
                    status: (*state).into(),
                    seconds: *seconds,
                    cpu_seconds: *cpu_seconds,
                    forecast: node.forecast,
                    preview,
                    degraded: *degraded,
                    error: error.clone(),
                    notes: notes.clone(),
                    // Without a new result, the last one stays visible.
                    outputs: known.map_or_else(|| std::mem::take(&mut node.outputs), listed),
                    pending,
                    key: *key,
                    ..NodeState::default()
                };
                extra = Some(id);
            }
            Event::File { id, path, preview, .. } => {
                let file = json!({"id": id, "preview": preview, "stale": false});
                self.files.insert(path.display().to_string(), file);
            }
            Event::Stale { path } => {
                if let Some(file) = self.files.get_mut(&path.display().to_string()) {
                    file["stale"] = true.into();
                }
            }
            Event::Warning { text, .. } => {
                self.warnings.push(text.clone());
                let surplus = self.warnings.len().saturating_sub(MOST_WARNINGS);
                self.warnings.drain(..surplus);
            }
            Event::Plan(forecast) => {
                self.forecast = serde_json::to_value(forecast).ok();
                self.running = true;
                (self.began, self.refinements) = (Some(Instant::now()), Vec::new());
            }
            Event::Pass { parameter, level, of, coarse } => {
                self.pass = Some(json!({"parameter": parameter, "level": level, "of": of, "coarse": coarse}));
                self.running = true;
            }
            Event::Done(totals) => {
                if self.pass.is_none() && !totals.stopped {
                    // Nodes that are the same in the preview are not reported again.
                    self.nodes.values_mut().for_each(|node| node.preview = false);
                }
                self.done = serde_json::to_value(totals).ok();
                if let Some(done) = &mut self.done {
                    done["at"] = now().into();
                    done["preview"] = self.pass.is_some().into();
                }
                if !totals.stopped {
                    self.refined();
                }
                self.pass = None;
            }
            Event::Mistakes { list, text } => {
                self.mistakes.clone_from(list);
                self.problem = list.is_empty().then(|| plain(text));
            }
            Event::Idle { .. } => {
                (self.running, self.pass, self.forecast) = (false, None, None);
                for node in self.nodes.values_mut().filter(|node| node.status == NodeStatus::Running) {
                    // Its run was cancelled.
                    node.status = NodeStatus::Skipped;
                }
            }
            // Parts, stages and spans are too many for a page.
            Event::Part { .. } | Event::Stage { .. } | Event::Span { .. } => return None,
            Event::Remake { .. } | Event::Same => {}
        }
        let mut json = serde_json::to_value(event).ok()?;
        if let Event::Mistakes { text, .. } = event {
            json["text"] = plain(text).into();
        }
        if matches!(event, Event::Done(_)) {
            json["refinements"] = serde_json::to_value(&self.refinements).ok()?;
        }
        if let Some(node) = extra.and_then(|id| self.nodes.get(id)) {
            json["node"] = serde_json::to_value(node).ok()?;
        }
        Some(json)
    }

    /// Records the pictures of a preview or of the result.
    fn refined(&mut self) {
        let Some(began) = self.began else { return };
        let made = self.made();
        let values = self.shown().into_iter().filter(|(name, _)| made.contains(name)).take(MOST_PICTURES);
        let refinement = Refinement {
            pass: self.pass.clone(),
            seconds: began.elapsed().as_secs_f64(),
            values: values.collect(),
        };
        if self.refinements.len() < MOST_REFINEMENTS {
            self.refinements.push(refinement);
        }
    }

    /// Names of the outputs that the targets of the graph read.
    fn made(&self) -> BTreeSet<String> {
        let Some(graph) = &self.graph else { return BTreeSet::new() };
        let targets = if self.only.is_empty() { graph.targets() } else { self.only.clone() };
        let wires = targets.into_iter().flat_map(|target| graph.nodes[target].inputs.iter().flatten());
        let name = |wire: &Wire| {
            let node = &graph.nodes[wire.node];
            format!("{}.{}", node.id, node.kind.outputs[wire.port].name)
        };
        wires.map(name).collect()
    }

    /// The notes and the key of the last result of a node.
    pub fn facts(&self, id: &str) -> (Vec<Note>, Option<Digest>) {
        self.nodes.get(id).map(|node| (node.notes.clone(), node.key)).unwrap_or_default()
    }

    /// Looks again for the outputs of results that were not yet in the store. Returns an event for each node whose
    /// outputs are found.
    pub fn settle(&mut self, outputs: impl Fn(&str, &Digest) -> Option<Vec<StoredOutput>>) -> Vec<Value> {
        let mut events = Vec::new();
        for (id, node) in &mut self.nodes {
            if let Some(found) = node.pending.and_then(|key| outputs(id, &key)) {
                replaced(&mut self.recent, &node.outputs);
                (node.outputs, node.pending) = (listed(found), None);
                events.push(json!({"event": "values", "id": id, "node": node}));
            }
        }
        events
    }

    /// True if the outputs of some results are not known yet.
    pub fn is_pending(&self) -> bool {
        self.nodes.values().any(|node| node.pending.is_some())
    }

    /// Type and digest of each value that can be shown, by node and output.
    pub fn shown(&self) -> BTreeMap<String, (String, String)> {
        let shown = |(id, node): (&String, &NodeState)| {
            let outputs =
                node.outputs.iter().filter(|output| output.stored && SHOWN.contains(&output.type_name));
            let id = id.clone();
            outputs
                .map(|out| (format!("{id}.{}", out.port), (out.type_name.to_owned(), out.digest.clone())))
                .collect::<Vec<_>>()
        };
        self.nodes.iter().flat_map(shown).collect()
    }

    /// The current values of these types, each as node, index of the output and digest.
    pub fn outputs(&self, types: &[&str]) -> Vec<(String, usize, String)> {
        let of = |(id, node): (&String, &NodeState)| {
            let outputs = node.outputs.iter().enumerate();
            let fitting = outputs.filter(|(_, output)| types.contains(&output.type_name));
            fitting.map(|(port, output)| (id.clone(), port, output.digest.clone())).collect::<Vec<_>>()
        };
        self.nodes.iter().flat_map(of).collect()
    }

    /// The node, the index of the output and the type of a current value.
    pub fn find(&self, digest: &str) -> Option<(String, usize, &'static str)> {
        self.nodes.iter().find_map(|(id, node)| {
            let port = node.outputs.iter().position(|output| output.digest == digest)?;
            Some((id.clone(), port, node.outputs[port].type_name))
        })
    }

    /// The type of an earlier value with this digest.
    pub fn recent(&self, digest: &str) -> Option<&'static str> {
        self.recent.iter().rev().find(|(known, _)| known == digest).map(|(_, type_name)| *type_name)
    }

    /// True if the current run computes a preview.
    pub fn is_preview(&self) -> bool {
        self.pass.is_some()
    }
}

/// Adds values that are no longer current to the earlier values.
fn replaced(recent: &mut VecDeque<(String, &'static str)>, outputs: &[Output]) {
    recent.extend(outputs.iter().map(|output| (output.digest.clone(), output.type_name)));
    let surplus = recent.len().saturating_sub(MOST_RECENT);
    recent.drain(..surplus);
}

fn listed(outputs: Vec<StoredOutput>) -> Vec<Output> {
    let output = |StoredOutput { port, type_name, digest, stored }| Output {
        port,
        type_name,
        digest: digest.to_string(),
        stored,
    };
    outputs.into_iter().map(output).collect()
}

/// Removes the colour codes of terminals from a text.
pub fn plain(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('\u{1b}') {
        out.push_str(&rest[..at]);
        let code = &rest[at + 1..];
        rest = match code.strip_prefix('[').and_then(|code| code.find(|c: char| c.is_ascii_alphabetic())) {
            Some(end) => &code[end + 2..],
            None => code,
        };
    }
    out + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_of_terminals_are_removed() {
        assert_eq!(plain("\u{1b}[1m\u{1b}[38;5;9merror\u{1b}[0m: x\u{1b}"), "error: x");
    }

    #[test]
    fn a_preview_lasts_until_its_end() {
        let mut state = State::default();
        let outputs = |_: &str, _: &Digest| None;
        let pass = Event::Pass { parameter: "samples".to_owned(), level: 1, of: 8, coarse: 2 };
        assert!(state.update(&pass, outputs).is_some() && state.is_preview());
        let start = Event::Start { id: "a".to_owned(), kind: "add", forecast: Some(2.0) };
        let json = state.update(&start, outputs).unwrap_or_default();
        assert_eq!((&json["node"]["status"], &json["node"]["forecast"]), (&"running".into(), &2.0.into()));
        state.update(&Event::Done(engine::Totals::default()), outputs);
        assert!(!state.is_preview() && state.json()["done"]["preview"] == true);
        state.update(&Event::Idle { files: 1 }, outputs);
        assert_eq!(state.json()["nodes"]["a"]["status"], "skipped", "it was cancelled");
    }
}
