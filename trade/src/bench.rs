//! Runs a graph with given settings of its knobs, and measures the cost of each run and the errors of the resulting
//! pictures.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use engine::{
    Artifact, Counts, Digest, Engine, Event, Graph, Node, NodeError, Note, PRESETS, Planned, Registry,
    RunOptions, Source, Spent, Wire, overlay_text,
};
use nodes::kinds::compare::Space;
use scene::types::{Images, Report};

use crate::deadline::Deadline;
use crate::error::Error;
use crate::judge::{FlipMaps, Output, Truth, holds_data, is_bright, outputs};
use crate::metric::Metric;
use crate::off::Off;
use crate::search::Steps;
use crate::tunables::{Assignment, Tunable, same_nodes, tunables};
use crate::work::work_of;

/// The cost that a node has without a cache, as measured when the node was last run.
#[derive(Debug, Clone)]
pub struct NodeCost {
    /// Name of the node.
    pub id: String,
    /// Name of the node's kind.
    pub kind: &'static str,
    /// Work of the node, in rays.
    pub work: f64,
    /// Wall time that the node's code took, in seconds.
    pub seconds: f64,
    /// CPU time that the node's code took, in seconds.
    pub cpu_seconds: f64,
    /// Deterministic counts of the operations that the node performed.
    pub counts: Counts,
    /// Notes of the node.
    pub notes: Vec<Note>,
    /// True if the node has a separate instance for each value of an axis.
    pub varies: bool,
    /// Key of the node. Nodes with equal keys share one action.
    pub key: Option<Digest>,
}

impl NodeCost {
    /// The cost of a node, given what its last run spent.
    pub fn of(node: &Node, spent: Spent, notes: Vec<Note>, key: Option<Digest>) -> Self {
        Self {
            id: node.id.clone(),
            kind: node.kind.name,
            work: work_of(&spent.counts),
            seconds: spent.seconds,
            cpu_seconds: spent.cpu_seconds,
            counts: spent.counts,
            notes,
            varies: !node.point.is_empty(),
            key,
        }
    }
}

/// Measurements of the graph at one assignment.
pub struct Point {
    /// The setting of each knob.
    pub assignment: Assignment,
    /// Sum of the work of the nodes, in rays.
    pub work: f64,
    /// Sum of the wall times of the nodes, in seconds.
    pub seconds: f64,
    /// Sum of the CPU times of the nodes, in seconds.
    pub cpu_seconds: f64,
    /// All nodes on which the pictures depend, in the order of the graph.
    pub nodes: Vec<NodeCost>,
    /// Errors of the pictures relative to the reference.
    pub off: Vec<Off>,
}

impl Point {
    /// Number of actions in the run. Nodes with equal keys count as one action.
    pub fn actions(&self) -> usize {
        self.nodes.iter().filter_map(|node| node.key).collect::<BTreeSet<_>>().len()
    }
}

/// Callback for the events of runs. Its arguments are the name of the setting, the number of settings measured
/// before, and the event.
pub type Observer<'e> = Box<dyn FnMut(&str, usize, &Event) + 'e>;

/// A graph that is measured at different settings of its knobs.
pub struct Bench<'e> {
    engine: &'e Engine,
    registry: Registry,
    base: Graph,
    /// Name of the graph. The history of the user's own runs of the graph is stored under this name.
    name: String,
    outputs: Vec<Output>,
    targets: Vec<usize>,
    /// The knobs of the graph, and other fields that are set by the graph's own presets.
    pub tunables: Vec<Tunable>,
    /// Names of the pictures that are not scored.
    pub unjudged: Vec<String>,
    /// Remarks for the user, for example about pictures that are left out.
    pub remarks: Vec<String>,
    /// Number of remarks that were already shown to the user.
    reported: usize,
    observer: Option<Observer<'e>>,
    cancel: Arc<AtomicBool>,
    /// Time at which measuring ends; `None` for no limit.
    deadline: Option<Instant>,
    truth: Option<Truth>,
    /// The required metric. If it cannot be computed for a picture, the picture is not included in the error, and
    /// the reason is reported.
    metric: Option<Metric>,
    /// Measured settings. The first point is the reference.
    pub points: Vec<Point>,
}

/// The nodes whose outputs are the pictures, each node once.
fn targets(outputs: &[Output]) -> Vec<usize> {
    let nodes: BTreeSet<usize> = outputs.iter().map(|output| output.wire.node).collect();
    nodes.into_iter().collect()
}

/// Reasons why a setting could not be measured.
pub enum Miss {
    /// The user interrupted the run.
    Stopped,
    /// The time for measuring ran out.
    Late,
    /// The graph cannot run at this assignment.
    Failed(String),
}

impl<'e> Bench<'e> {
    /// Creates a bench for the pictures of the nodes `only`. If `only` is empty, the pictures of all targets of the
    /// graph are used.
    pub fn new(
        engine: &'e Engine,
        graph: &Graph,
        only: &[usize],
        cancel: Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        // The name differs from that of the graph, so that these runs do not count as its last run.
        let source = Source::new(format!("{} (measured)", graph.source.name), &*graph.source.text);
        let registry = nodes::registry();
        let base = Graph::parse(source, &registry, graph.root.clone()).map_err(Error::Graph)?;
        let asked = if only.is_empty() { base.targets() } else { only.to_vec() };
        let (outputs, layers) = outputs(&base, &asked);
        if outputs.is_empty() {
            return Err(Error::NoPicture);
        }
        let turned = |output: &Output| {
            let tunables = tunables(&base, &[output.wire.node], &registry)?;
            Ok::<bool, Error>(tunables.iter().any(|tunable| tunable.values.len() > 1))
        };
        let reached = outputs.iter().map(turned).collect::<Result<Vec<bool>, Error>>()?;
        let (mut left, mut kept) = (Vec::new(), Vec::new());
        for (output, reached) in outputs.into_iter().zip(reached) {
            (if reached { &mut kept } else { &mut left }).push(output);
        }
        let unjudged: Vec<String> = left.into_iter().map(|output| output.name).collect();
        if kept.is_empty() {
            return Err(Error::NoKnob(unjudged.join("`, `")));
        }
        let unreached = |name: &String| format!("no knob affects `{name}`, so this picture is left out");
        let mut remarks: Vec<String> = layers.into_iter().chain(unjudged.iter().map(unreached)).collect();
        let outputs = kept;
        let targets = targets(&outputs);
        let tunables = tunables(&base, &targets, &registry)?;
        remarks.extend(tunables.iter().filter_map(Tunable::finer_than_the_reference));
        let (truth, points) = (None, Vec::new());
        Ok(Self {
            engine,
            registry,
            base,
            name: graph.source.name.clone(),
            outputs,
            targets,
            tunables,
            unjudged,
            remarks,
            reported: 0,
            observer: None,
            cancel,
            deadline: None,
            truth,
            metric: None,
            points,
        })
    }

    /// Sets a callback that receives the events of all later runs.
    pub fn observe(&mut self, observer: Observer<'e>) {
        self.observer = Some(observer);
    }

    /// Sets the time at which measuring ends. A run that is active at that time is stopped, and its finished
    /// results stay in the cache.
    pub fn end_at(&mut self, time: Instant) {
        self.deadline = Some(time);
    }

    /// The graph with its own settings.
    pub(crate) fn base(&self) -> &Graph {
        &self.base
    }

    /// The nodes whose outputs are the pictures.
    pub(crate) fn targets(&self) -> &[usize] {
        &self.targets
    }

    /// The plan of a run at a setting. It is based on the history of the user's own runs of the graph. `None` if
    /// the graph has mistakes at this setting.
    pub(crate) fn plan(&self, assignment: &Assignment) -> Option<Vec<Planned>> {
        let source = Source::new(self.name.clone(), &*self.base.source.text);
        let source = source.overlaid("knobs", &self.overlay(assignment));
        let graph = Graph::parse(source, &self.registry, self.base.root.clone()).ok()?;
        Some(self.engine.plan(&graph, &self.targets))
    }

    /// Sets the required metric. If it cannot be computed for a picture, the picture is not included in the error,
    /// and the reason is reported.
    pub fn judge_by(&mut self, metric: &Metric) {
        self.metric = Some(metric.clone());
    }

    /// Leaves out pictures whose size is set by a knob. To find them, the preset `reference` is compared with
    /// `draft`, the preset farthest from it. Afterwards, all measured points are discarded. Both presets are
    /// measured again later, and failures are reported then. This function must be called before a search.
    /// Otherwise, the search would lower knobs that affect only pictures that are not scored, since this increases
    /// no measured error.
    pub fn leave_out_resized(&mut self) -> Result<(), Error> {
        if self.outputs.len() < 2 {
            return Ok(());
        }
        for level in [3, 0] {
            if self.measure(&self.preset(level)).is_err() {
                break;
            }
        }
        (self.truth, self.points) = (None, Vec::new());
        if !self.outputs.is_empty() {
            self.targets = targets(&self.outputs);
            self.tunables = tunables(&self.base, &self.targets, &self.registry)?;
        }
        Ok(())
    }

    /// Adds a remark, unless it was added before.
    fn remark(&mut self, text: String) {
        if !self.remarks.contains(&text) {
            self.remarks.push(text);
        }
    }

    /// The range of each tunable.
    pub fn steps(&self) -> Vec<Steps> {
        self.tunables
            .iter()
            .map(|tunable| Steps { values: tunable.values.len(), step: tunable.step, ordered: tunable.knob })
            .collect()
    }

    /// The assignment of the graph's own settings.
    pub fn now(&self) -> Assignment {
        self.tunables.iter().map(|tunable| tunable.now).collect()
    }

    /// The assignment of a preset. `level` is the index of the preset in [`PRESETS`].
    pub fn preset(&self, level: usize) -> Assignment {
        self.tunables.iter().map(|tunable| tunable.presets[level]).collect()
    }

    /// The overlay that sets each tunable to its value in an assignment.
    pub fn overlay(&self, assignment: &Assignment) -> String {
        let field = |(tunable, &at): (&'_ Tunable, &usize)| {
            let value = tunable.values.get(at).map(String::as_str).unwrap_or_default();
            (tunable.node.clone(), tunable.parameter, value.to_owned())
        };
        let fields: Vec<_> = self.tunables.iter().zip(assignment).map(field).collect();
        overlay_text(
            fields.iter().map(|(node, parameter, value)| (node.as_str(), *parameter, value.as_str())),
        )
    }

    /// Name of an assignment: the name of the preset with these settings, or the list of differences from the
    /// graph's own settings.
    pub fn name(&self, assignment: &Assignment) -> String {
        if let Some(level) = (0..PRESETS.len()).rev().find(|&level| self.preset(level) == *assignment) {
            return PRESETS[level].to_owned();
        }
        let changed: Vec<String> = self
            .tunables
            .iter()
            .zip(assignment)
            .filter(|(tunable, at)| tunable.now != **at)
            .map(|(tunable, at)| format!("{}.{}={}", tunable.node, tunable.parameter, tunable.values[*at]))
            .collect();
        if changed.is_empty() { "current settings".to_owned() } else { changed.join(" ") }
    }

    /// Parses the graph with an assignment applied to it.
    fn graph(&self, assignment: &Assignment) -> Result<Graph, Miss> {
        let source = self.base.source.clone().overlaid("knobs", &self.overlay(assignment));
        let graph = Graph::parse(source, &self.registry, self.base.root.clone())
            .map_err(|mistakes| Miss::Failed(mistakes.to_string()))?;
        same_nodes(&self.base, &graph).map_err(Miss::Failed)?;
        Ok(graph)
    }

    /// Measures an assignment, unless it was measured before. Returns the index of its point. The first measured
    /// point is the reference for all others.
    pub fn measure(&mut self, assignment: &Assignment) -> Result<usize, Miss> {
        if let Some(known) = self.points.iter().position(|point| point.assignment == *assignment) {
            return Ok(known);
        }
        let graph = self.graph(assignment)?;
        let mut reported: BTreeMap<String, (Vec<Note>, Option<Digest>)> = BTreeMap::new();
        let options =
            RunOptions { only: self.targets.clone(), cancel: self.cancel.clone(), ..RunOptions::default() };
        if self.deadline.is_some_and(|deadline| deadline <= Instant::now()) {
            return Err(Miss::Late);
        }
        let deadline = self.deadline.map(|deadline| Deadline::at(deadline, self.cancel.clone()));
        let (name, before) = (self.name(assignment), self.points.len());
        let observer = &mut self.observer;
        let outcome = self.engine.run(&graph, &options, |event| {
            if let Some(observer) = observer {
                observer(&name, before, &event);
            }
            if let Event::Node { id, notes, key, .. } = event {
                reported.insert(id, (notes, key));
            }
        });
        if deadline.is_some_and(Deadline::end) {
            self.cancel.store(false, Ordering::Relaxed);
            return Err(Miss::Late);
        }
        if outcome.totals.stopped || self.cancel.load(Ordering::Relaxed) {
            return Err(Miss::Stopped);
        }
        if let Some(failures) = outcome.failures {
            return Err(Miss::Failed(failures.to_string()));
        }
        let wanted = graph.above(&self.targets);
        let (mut nodes, mut keys) = (Vec::new(), BTreeSet::new());
        for (index, node) in graph.nodes.iter().enumerate().filter(|(index, _)| wanted[*index]) {
            let (notes, key) = reported.remove(&node.id).unwrap_or_default();
            // Equal instances of a node count once.
            let first = key.is_none_or(|key| keys.insert(key));
            let spent = self.engine.spent(&graph, index).filter(|_| first).unwrap_or_default();
            nodes.push(NodeCost::of(node, spent, notes, key));
        }
        let mut pictures = self.pictures(&graph)?;
        let off = self.off(&graph, &mut pictures)?;
        let sum = |of: fn(&NodeCost) -> f64| nodes.iter().fold(0.0, |sum, node| sum + of(node));
        let (work, seconds, cpu_seconds) = (sum(|n| n.work), sum(|n| n.seconds), sum(|n| n.cpu_seconds));
        self.points.push(Point { assignment: assignment.clone(), work, seconds, cpu_seconds, nodes, off });
        Ok(self.points.len() - 1)
    }

    /// Computes the errors of pictures relative to the reference. The pictures of the first call become the
    /// reference. Pictures whose size is set by a knob are not scored. If there are colour pictures, pictures with
    /// data other than colours, such as depth, are not scored either, since other metrics apply to them.
    fn off(&mut self, graph: &Graph, pictures: &mut Vec<Arc<Images>>) -> Result<Vec<Off>, Miss> {
        if self.truth.is_none() {
            let data: Vec<bool> = pictures.iter().map(|images| holds_data(images)).collect();
            if !data.iter().all(|data| *data) {
                self.leave_out(pictures, &data, "contains data, while other pictures contain colours");
            }
            let value = |wire| self.engine.value::<Images>(graph, wire).map(Arc::new);
            self.truth = Some(Truth::of(&self.outputs, pictures, value));
            self.mark_uncomputed()?;
            let reported = |of: &dyn Fn(&Output, &Images) -> bool, text: &str| {
                let held = self.outputs.iter().zip(&*pictures).filter(|(output, images)| of(output, images));
                let names: Vec<String> = held.map(|(output, _)| format!("`{}`", output.name)).collect();
                (!names.is_empty()).then(|| format!("{text}: {}", names.join(", ")))
            };
            let linear = |output: &Output, _: &Images| output.space == Space::Linear;
            let cut = |output: &Output, images: &Images| output.space == Space::Display && is_bright(images);
            let remarks = [
                reported(&cut, "in these pictures, light far above white is scored as white"),
                reported(
                    &linear,
                    "these pictures are scored in linear light, with HDR-FLIP, since they are written only to OpenEXR files",
                ),
            ];
            remarks.into_iter().flatten().for_each(|text| self.remark(text));
        }
        let fits =
            |truth: &Truth| pictures.iter().enumerate().map(|(at, images)| !truth.fits(at, images)).collect();
        let resized: Vec<bool> = self.truth.as_ref().map(fits).unwrap_or_default();
        self.leave_out(pictures, &resized, "has a size that depends on the settings");
        if self.outputs.is_empty() {
            let why = "a knob sets the size of every picture, so there is nothing to compare";
            return Err(Miss::Failed(why.to_owned()));
        }
        let Some(truth) = &self.truth else { return Ok(Vec::new()) };
        truth.off(&self.outputs, pictures).map_err(|error| Miss::Failed(error.to_string()))
    }

    /// Marks pictures for which the metric cannot be computed. For example, HDR-FLIP cannot be computed for a
    /// picture half of which is black. Marked pictures are not included in the error, but other metrics are still
    /// reported for them.
    fn mark_uncomputed(&mut self) -> Result<(), Miss> {
        let Some((truth, metric)) = self.truth.as_ref().zip(self.metric.clone()) else { return Ok(()) };
        let why =
            truth.uncomputed(&self.outputs, &metric).map_err(|error| Miss::Failed(error.to_string()))?;
        let way_out = "choose rmse, psnr, mae or relmse with `--metric` or `--max-error`; these can be computed for every picture";
        if let [Some(first), rest @ ..] = why.as_slice()
            && rest.iter().all(Option::is_some)
        {
            let text = format!("{} cannot be computed for any of the pictures ({first})", metric.name);
            return Err(Miss::Failed(format!("{text}; {way_out}")));
        }
        let mut reported = Vec::new();
        for (output, why) in self.outputs.iter_mut().zip(why) {
            if let Some(why) = &why {
                reported.push(format!(
                    "`{}` is written only to OpenEXR files and is therefore scored in linear light; {} cannot be computed for this picture ({why}), so the picture is not included in the error",
                    output.name, metric.name
                ));
            }
            output.uncomputed = why;
        }
        if !reported.is_empty() {
            reported.push(way_out.to_owned());
        }
        reported.into_iter().for_each(|text| self.remark(text));
        Ok(())
    }

    /// Stops judging the pictures for which `which` is true, and adds a remark with the reason `why` for each of
    /// them.
    fn leave_out(&mut self, pictures: &mut Vec<Arc<Images>>, which: &[bool], why: &str) {
        for at in (0..which.len()).rev().filter(|at| which[*at]) {
            let Output { name, .. } = self.outputs.remove(at);
            pictures.remove(at);
            if let Some(truth) = &mut self.truth {
                truth.remove(at);
            }
            self.points.iter_mut().for_each(|point| point.off.retain(|row| row.output != name));
            self.remark(format!("`{name}` {why}, so this picture is left out"));
            self.unjudged.push(name);
        }
    }

    /// Returns the remarks that have not been reported yet.
    pub fn new_remarks(&mut self) -> &[String] {
        let reported = std::mem::replace(&mut self.reported, self.remarks.len());
        &self.remarks[reported..]
    }

    /// The pictures to score, as computed by the last run of `graph`.
    fn pictures(&self, graph: &Graph) -> Result<Vec<Arc<Images>>, Miss> {
        let value = |output: &Output| {
            let images = self.engine.value::<Images>(graph, output.wire).map(Arc::new);
            images.ok_or_else(|| {
                Miss::Failed(format!("the picture of `{}` cannot be read again from the cache", output.name))
            })
        };
        self.outputs.iter().map(value).collect()
    }

    /// The pictures of a measured point, each with the name of its output.
    pub fn pictures_at(&self, point: usize) -> Result<Vec<(String, Arc<Images>)>, Miss> {
        let graph = self.graph(&self.points[point].assignment)?;
        let options =
            RunOptions { only: self.targets.clone(), cancel: self.cancel.clone(), ..RunOptions::default() };
        // The results are cached. The run makes them the last results of the graph, which can be found by name.
        if self.engine.run(&graph, &options, |_| ()).totals.stopped {
            return Err(Miss::Stopped);
        }
        let names = self.outputs.iter().map(|output| output.name.clone());
        Ok(names.zip(self.pictures(&graph)?).collect())
    }

    /// The reports that nodes output at a measured point. Each has a name that consists of the names of the node
    /// and of the output.
    pub fn reports_at(&self, point: usize) -> Vec<(String, Report)> {
        let Ok(graph) = self.graph(&self.points[point].assignment) else { return Vec::new() };
        let wanted = graph.above(&self.targets);
        let mut reports = Vec::new();
        for (index, node) in graph.nodes.iter().enumerate().filter(|(index, _)| wanted[*index]) {
            for (port, spec) in node.kind.outputs.iter().enumerate() {
                if spec.artifact.name == Report::TYPE
                    && let Some(report) = self.engine.value::<Report>(&graph, Wire { node: index, port })
                {
                    reports.push((format!("{}.{}", node.id, spec.name), report));
                }
            }
        }
        reports
    }

    /// For each output, the FLIP difference of each pixel between the picture in `pictures` and the reference, or
    /// the error that prevented the comparison.
    pub fn flip_maps(&self, pictures: &[(String, Arc<Images>)]) -> Vec<Result<FlipMaps, NodeError>> {
        self.truth.as_ref().map(|truth| truth.flip_maps(&self.outputs, pictures)).unwrap_or_default()
    }

    /// The names of the nodes with a tunable that has more than one value, in the order of the graph file.
    pub fn nodes_with_knobs(&self) -> Vec<String> {
        let mut seen = BTreeSet::new();
        let names = self
            .tunables
            .iter()
            .filter(|tunable| tunable.values.len() > 1)
            .map(|tunable| tunable.node.clone());
        names.filter(|name| seen.insert(name.clone())).collect()
    }
}
