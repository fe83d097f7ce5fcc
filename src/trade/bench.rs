//! Runs a graph at given settings of its knobs, and measures what that costs and how far its pictures are off.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use engine::{
    Artifact, Context, Counts, Digest, Engine, Event, Graph, Kind, Note, PRESETS, Registry, RunOptions,
    Source, Wire, overlay_text,
};
use nodes::compare::{Compare, In, Space};
use nodes::composite::{self, Composite};
use nodes::layers::linear;
use nodes::metrics::PIXELS_PER_DEGREE;
use nodes::types::{Cell, Data, Image, Images, NamedImage, Picture, Report};

use super::work::work_of;
use crate::session::Error;

/// One knob of the graph with the values it may take, from the least work to the least error.
pub struct Dial {
    pub node: String,
    pub parameter: &'static str,
    pub values: Vec<String>,
    /// Which of them the graph has, and each preset.
    pub now: usize,
    pub presets: [usize; 4],
}

/// For each dial the index of its value.
pub type Position = Vec<usize>;

/// What a node stands for, whatever of it was known.
#[derive(Debug, Clone)]
pub struct NodeCost {
    pub id: String,
    pub kind: &'static str,
    /// In rays.
    pub work: f64,
    /// Wall time of its code when it ran.
    pub seconds: f64,
    pub counts: Counts,
    pub notes: Vec<Note>,
    /// Whether it is there once for each point of axes.
    pub varies: bool,
    /// Equal keys are one and the same action.
    pub key: Option<Digest>,
}

/// How far one view of a picture is off, in one region.
#[derive(Debug, Clone)]
pub struct Off {
    pub output: String,
    pub view: String,
    pub region: String,
    /// What was judged: `image`, or a baseline.
    pub judged: String,
    pub pixels: u64,
    /// By column of `compare`.
    pub values: BTreeMap<String, f64>,
}

/// The graph at one position.
pub struct Point {
    pub position: Position,
    pub work: f64,
    /// Sum of the wall times of the nodes' code.
    pub seconds: f64,
    pub nodes: Vec<NodeCost>,
    pub off: Vec<Off>,
}

/// A picture to judge, and where the background stands that an object was put into, and the object.
struct Output {
    name: String,
    wire: Wire,
    background: Option<Wire>,
    object: Option<Wire>,
}

/// Pictures of the reference, and for those with an object put in what to see that beside.
struct Truth {
    pictures: Vec<Arc<Images>>,
    inserted: Vec<Option<Inserted>>,
}

/// What an object changes in a picture, and the two pictures that miss all of it or its shadow.
#[derive(Clone)]
struct Inserted {
    touched: Arc<Images>,
    nothing: Arc<Images>,
    no_shadow: Option<Arc<Images>>,
}

/// A graph whose knobs can be turned.
pub struct Bench<'e> {
    engine: &'e Engine,
    registry: Registry,
    base: Graph,
    outputs: Vec<Output>,
    targets: Vec<usize>,
    pub dials: Vec<Dial>,
    /// Pictures that are not judged, each with a sentence that says why.
    pub unjudged: Vec<(String, String)>,
    cancel: Arc<AtomicBool>,
    truth: Option<Truth>,
    pub points: Vec<Point>,
}

/// Why there is no point.
pub enum Miss {
    /// The run was asked to stop.
    Stopped,
    /// The graph cannot run at this position.
    Failed(String),
}

impl<'e> Bench<'e> {
    /// A bench for the pictures of some nodes, of all targets where none is named.
    pub fn new(
        engine: &'e Engine,
        graph: &Graph,
        only: &[usize],
        cancel: Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        // A name of its own, so that what is measured here is not taken for the last run of the graph.
        let source = Source::new(format!("{} (measured)", graph.source.name), &*graph.source.text);
        let registry = nodes::registry();
        let base = Graph::parse(source, &registry, graph.root.clone()).map_err(Error::Graph)?;
        let asked = if only.is_empty() { base.targets() } else { only.to_vec() };
        let outputs = outputs(&base, &asked);
        if outputs.is_empty() {
            return Err(Error::NoPicture);
        }
        let turned = |output: &Output| {
            let dials = dials(&base, &[output.wire.node], &registry)?;
            Ok::<bool, Error>(dials.iter().any(|dial| dial.values.len() > 1))
        };
        let reached = outputs.iter().map(turned).collect::<Result<Vec<bool>, Error>>()?;
        let (mut left, mut kept) = (Vec::new(), Vec::new());
        for (output, reached) in outputs.into_iter().zip(reached) {
            (if reached { &mut kept } else { &mut left }).push(output);
        }
        let names = left.into_iter().map(|output| output.name);
        if kept.is_empty() {
            return Err(Error::NoKnob(names.collect::<Vec<_>>().join("`, `")));
        }
        let unreached = |name: String| {
            let why = format!("no knob reaches `{name}`, so it is left out");
            (name, why)
        };
        let (outputs, unjudged) = (kept, names.map(unreached).collect());
        let mut targets: Vec<usize> = outputs.iter().map(|output| output.wire.node).collect();
        targets.sort_unstable();
        targets.dedup();
        let dials = dials(&base, &targets, &registry)?;
        let (truth, points) = (None, Vec::new());
        Ok(Self { engine, registry, base, outputs, targets, dials, unjudged, cancel, truth, points })
    }

    /// The position of the graph as it is.
    pub fn now(&self) -> Position {
        self.dials.iter().map(|dial| dial.now).collect()
    }

    /// That of a preset, by its index in [`PRESETS`].
    pub fn preset(&self, rung: usize) -> Position {
        self.dials.iter().map(|dial| dial.presets[rung]).collect()
    }

    /// The overlay that sets a position.
    pub fn overlay(&self, position: &Position) -> String {
        let field = |(dial, &at): (&'_ Dial, &usize)| {
            let value = dial.values.get(at).map(String::as_str).unwrap_or_default();
            (dial.node.clone(), dial.parameter, value.to_owned())
        };
        let fields: Vec<_> = self.dials.iter().zip(position).map(field).collect();
        overlay_text(
            fields.iter().map(|(node, parameter, value)| (node.as_str(), *parameter, value.as_str())),
        )
    }

    /// What a position is called: that of a preset, or what differs from the graph.
    pub fn name(&self, position: &Position) -> String {
        if let Some(rung) = (0..PRESETS.len()).rev().find(|&rung| self.preset(rung) == *position) {
            return PRESETS[rung].to_owned();
        }
        let changed: Vec<String> = self
            .dials
            .iter()
            .zip(position)
            .filter(|(dial, at)| dial.now != **at)
            .map(|(dial, at)| format!("{}.{}={}", dial.node, dial.parameter, dial.values[*at]))
            .collect();
        if changed.is_empty() { "as it is".to_owned() } else { changed.join(" ") }
    }

    /// The graph at a position.
    fn graph(&self, position: &Position) -> Result<Graph, Miss> {
        let source = self.base.source.clone().overlaid("knobs", &self.overlay(position));
        Graph::parse(source, &self.registry, self.base.root.clone())
            .map_err(|mistakes| Miss::Failed(mistakes.to_string()))
    }

    /// The point of a position: known, or measured now. The first one measured is what others are compared with.
    pub fn measure(&mut self, position: &Position) -> Result<usize, Miss> {
        if let Some(known) = self.points.iter().position(|point| point.position == *position) {
            return Ok(known);
        }
        let graph = self.graph(position)?;
        let mut told: BTreeMap<String, (Vec<Note>, Option<Digest>)> = BTreeMap::new();
        let options =
            RunOptions { only: self.targets.clone(), cancel: self.cancel.clone(), ..RunOptions::default() };
        let outcome = self.engine.run(&graph, &options, |event| {
            if let Event::Node { id, notes, key, .. } = event {
                told.insert(id, (notes, key));
            }
        });
        if outcome.totals.stopped || self.cancel.load(Ordering::Relaxed) {
            return Err(Miss::Stopped);
        }
        if let Some(failures) = outcome.failures {
            return Err(Miss::Failed(failures.to_string()));
        }
        let wanted = graph.above(&self.targets);
        let (mut nodes, mut keys) = (Vec::new(), BTreeSet::new());
        for (index, node) in graph.nodes.iter().enumerate().filter(|(index, _)| wanted[*index]) {
            let (notes, key) = told.remove(&node.id).unwrap_or_default();
            // What several instances of a node are is done once.
            let first = key.is_none_or(|key| keys.insert(key));
            let spent = self.engine.spent(&graph, index).filter(|_| first).unwrap_or_default();
            nodes.push(NodeCost {
                id: node.id.clone(),
                kind: node.kind.name,
                work: work_of(&spent.counts),
                seconds: spent.seconds,
                counts: spent.counts,
                notes,
                varies: !node.point.is_empty(),
                key,
            });
        }
        let mut pictures = self.pictures(&graph)?;
        if self.truth.is_none() {
            self.leave_out_data(&mut pictures);
            self.truth = Some(self.truth_of(&graph, &pictures));
        }
        let off = self.off(&pictures).map_err(|error| Miss::Failed(error.to_string()))?;
        let (work, seconds) = nodes.iter().fold((0.0, 0.0), |(w, s), n| (w + n.work, s + n.seconds));
        self.points.push(Point { position: position.clone(), work, seconds, nodes, off });
        Ok(self.points.len() - 1)
    }

    /// Beside pictures of colours those of data are not judged, such as a depth: other measures hold for them.
    fn leave_out_data(&mut self, pictures: &mut Vec<Arc<Images>>) {
        let holds_data =
            |images: &Arc<Images>| images.0.iter().any(|view| matches!(view.picture, Picture::Data(_)));
        if pictures.iter().all(holds_data) {
            return;
        }
        let mut data = pictures.iter().map(holds_data).collect::<Vec<_>>().into_iter();
        let unjudged = &mut self.unjudged;
        self.outputs.retain(|output| {
            let colours = data.next() == Some(false);
            if !colours {
                let why =
                    format!("`{}` holds data, where others hold colours, so it is left out", output.name);
                unjudged.push((output.name.clone(), why));
            }
            colours
        });
        pictures.retain(|images| !holds_data(images));
    }

    /// The pictures of the last run of a graph.
    fn pictures(&self, graph: &Graph) -> Result<Vec<Arc<Images>>, Miss> {
        let value = |output: &Output| {
            let images = self.engine.value::<Images>(graph, output.wire).map(Arc::new);
            images.ok_or_else(|| {
                Miss::Failed(format!("the picture of `{}` cannot be had again from the cache", output.name))
            })
        };
        self.outputs.iter().map(value).collect()
    }

    /// Pictures at a position that was measured, by output.
    pub fn pictures_at(&self, point: usize) -> Result<Vec<(String, Arc<Images>)>, Miss> {
        let graph = self.graph(&self.points[point].position)?;
        let options =
            RunOptions { only: self.targets.clone(), cancel: self.cancel.clone(), ..RunOptions::default() };
        // Known, but for the names under which the last results of the graph are found.
        if self.engine.run(&graph, &options, |_| ()).totals.stopped {
            return Err(Miss::Stopped);
        }
        let names = self.outputs.iter().map(|output| output.name.clone());
        Ok(names.zip(self.pictures(&graph)?).collect())
    }

    /// The reports that nodes of a point gave, by node and output.
    pub fn reports_at(&self, point: usize) -> Vec<(String, Report)> {
        let Ok(graph) = self.graph(&self.points[point].position) else { return Vec::new() };
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

    fn truth_of(&self, graph: &Graph, pictures: &[Arc<Images>]) -> Truth {
        let inserted = |(output, picture): (&Output, &Arc<Images>)| {
            let value = |wire: Wire| self.engine.value::<Images>(graph, wire).map(Arc::new);
            let nothing = value(output.background?)?;
            let no_shadow = output.object.and_then(value).and_then(|object| shadowless(&nothing, object));
            Some(Inserted { touched: touched(picture, &nothing)?, nothing, no_shadow })
        };
        let inserted = self.outputs.iter().zip(pictures).map(inserted).collect();
        Truth { pictures: pictures.to_vec(), inserted }
    }

    /// How far pictures are off the reference, by output, view and region.
    fn off(&self, pictures: &[Arc<Images>]) -> Result<Vec<Off>, engine::NodeError> {
        let Some(truth) = &self.truth else { return Ok(Vec::new()) };
        let mut all = Vec::new();
        for (index, (output, picture)) in self.outputs.iter().zip(pictures).enumerate() {
            let (out, _) = compare(picture, &truth.pictures[index], truth.inserted[index].clone())?;
            for table in &out.tables {
                all.extend(table.rows.iter().filter_map(|row| off_of(&output.name, &table.columns, row)));
            }
        }
        Ok(all)
    }

    /// FLIP of each pixel between pictures and those of the reference, by output.
    pub fn flip_maps(&self, pictures: &[(String, Arc<Images>)]) -> Vec<Arc<Images>> {
        let Some(truth) = &self.truth else { return Vec::new() };
        let map = |((_, picture), truth): (&(String, Arc<Images>), &Arc<Images>)| {
            compare(picture, truth, None).map(|(_, flip)| flip).unwrap_or_default()
        };
        pictures.iter().zip(&truth.pictures).map(map).collect()
    }

    /// The names of the nodes that have a dial with more than one value, in the order of the file.
    pub fn turned_nodes(&self) -> Vec<String> {
        let mut seen = BTreeSet::new();
        let names = self.dials.iter().filter(|dial| dial.values.len() > 1).map(|dial| dial.node.clone());
        names.filter(|name| seen.insert(name.clone())).collect()
    }
}

/// `compare` as a library: its report and the map of FLIP.
fn compare(
    image: &Arc<Images>,
    reference: &Arc<Images>,
    inserted: Option<Inserted>,
) -> Result<(Report, Arc<Images>), engine::NodeError> {
    let (regions, background, no_shadow) = match inserted {
        Some(Inserted { touched, nothing, no_shadow }) => (vec![touched], Some(nothing), no_shadow),
        None => (Vec::new(), None, None),
    };
    let names = regions.iter().map(|_| "touched".to_owned()).collect();
    let params = Compare {
        space: Space::Display,
        quantise: true,
        names,
        gain: 1.0,
        pixels_per_degree: PIXELS_PER_DEGREE,
        lpips: None,
        scores: Vec::new(),
        lpips_scaled: true,
    };
    let inputs =
        In { image: image.clone(), reference: reference.clone(), mask: None, regions, background, no_shadow };
    let (out, _) = Compare::run(&params, inputs, &detached())?;
    Ok((Arc::unwrap_or_clone(out.report), out.flip))
}

fn detached() -> Context {
    Context::detached(engine::Scene { up: engine::Up::PlusZ, metres_per_unit: 1.0, seed: 0 }, ".")
}

/// The object over a background that it leaves as it is; none where the two do not fit.
fn shadowless(background: &Arc<Images>, object: Arc<Images>) -> Option<Arc<Images>> {
    let background = background.clone();
    let layers = composite::In { background, object, shadow: None, added: None, front: None, variance: None };
    let made = Composite::run(&Composite { backdrop: Some([0.0; 3]) }, layers, &detached());
    made.ok().map(|(out, _)| out.image)
}

fn off_of(output: &str, columns: &[String], row: &[Cell]) -> Option<Off> {
    let [Cell::Text(view), Cell::Text(judged), Cell::Text(region), Cell::Count(pixels), ..] = row else {
        return None;
    };
    let number = |(column, cell): (&String, &Cell)| match cell {
        Cell::Number(value) => Some((column.clone(), *value)),
        Cell::Text(text) if text == "inf" => Some((column.clone(), f64::INFINITY)),
        Cell::Text(text) if text == "-inf" => Some((column.clone(), f64::NEG_INFINITY)),
        _ => None,
    };
    let values = columns.iter().zip(row).skip(4).filter_map(number).collect();
    let [output, view, judged, region] = [output, view, judged, region].map(str::to_owned);
    Some(Off { output, view, region, judged, pixels: *pixels, values })
}

/// Where a picture differs from its background by more than one and a half codes of 8 bits in linear light near
/// white, or by a hundredth of the light: what an inserted object covers, shades or lights.
fn touched(picture: &Images, background: &Images) -> Option<Arc<Images>> {
    let mut masks = Vec::new();
    for view in &picture.0 {
        let behind = if background.0.len() == 1 {
            background.0.first().map(|b| &b.picture)
        } else {
            background.view(&view.name)
        };
        let (a, b) = (linear(&view.picture, "image").ok()?, linear(behind?, "background").ok()?);
        if (a.width, a.height) != (b.width, b.height) {
            return None;
        }
        let differs = |(p, q): (&[f32], &[f32])| {
            let far = |(p, q): (&f32, &f32)| (p - q).abs() > 0.002 + 0.01 * q.abs();
            f32::from(p.iter().zip(q).take(3).any(far))
        };
        let pixels = a.samples.chunks_exact(a.channels).zip(b.samples.chunks_exact(b.channels));
        let mask = Image::<Data>::from_samples(a.width, a.height, 1, pixels.map(differs).collect());
        masks.push(NamedImage { name: view.name.clone(), picture: Picture::Data(mask) });
    }
    Some(Arc::new(Images(masks)))
}

/// The pictures that come to the targets, each once, under the name of the node that makes them.
fn outputs(graph: &Graph, asked: &[usize]) -> Vec<Output> {
    let is_picture =
        |wire: &Wire| graph.nodes[wire.node].kind.outputs[wire.port].artifact.name == Images::TYPE;
    let mut wires: Vec<Wire> = Vec::new();
    for &target in asked {
        let node = &graph.nodes[target];
        if node.sink_path.is_some() {
            // Layers are for later work, each in numbers of its own; the picture is what is judged.
            let picture = node.kind.inputs.iter().zip(&node.inputs).filter(|(port, _)| port.name == "image");
            wires.extend(picture.flat_map(|(_, wires)| wires).filter(|wire| is_picture(wire)));
        } else {
            let first = Wire { node: target, port: 0 };
            wires.extend(Some(first).filter(|_| !node.kind.outputs.is_empty()).filter(is_picture));
        }
    }
    wires.sort_unstable();
    wires.dedup();
    let output = |wire: Wire| {
        let node = &graph.nodes[wire.node];
        let port = node.kind.outputs[wire.port].name;
        let name = if wire.port == 0 { node.id.clone() } else { format!("{}.{port}", node.id) };
        let read = |name: &str| {
            let mut ports = node.kind.inputs.iter().zip(&node.inputs);
            ports.find(|(port, _)| port.name == name).and_then(|(_, wires)| wires.first().copied())
        };
        Output { name, wire, background: read("background"), object: read("object") }
    };
    wires.into_iter().map(output).collect()
}

/// A graph at each of its presets.
pub fn presets(graph: &Graph, registry: &Registry) -> Result<[Graph; 4], Error> {
    let preset = |name: &str| {
        let source = graph.source.clone().with_preset(name, registry);
        Graph::parse(source, registry, graph.root.clone()).map_err(Error::Graph)
    };
    let [draft, preview, finer, reference] = PRESETS.map(preset);
    Ok([draft?, preview?, finer?, reference?])
}

/// The knobs above some nodes with their values, and what else the graph's own presets set there: a reference
/// may say that a threshold or a crop should be another one. What varies along an axis stays as it is.
fn dials(graph: &Graph, targets: &[usize], registry: &Registry) -> Result<Vec<Dial>, Error> {
    let laid = presets(graph, registry)?;
    let knobs = laid.each_ref().map(|graph| graph.knobs(targets));
    let mut dials: Vec<Dial> = Vec::new();
    for knob in graph.knobs(targets).into_iter().filter(|knob| !knob.varies) {
        let of = |rung: usize| {
            let known = knobs[rung].iter().find(|k| k.node == knob.node && k.parameter == knob.parameter);
            known.map_or(knob.value.as_str(), |k| k.value.as_str())
        };
        let mut values = knob.knob.values();
        for value in [knob.value.as_str(), of(0), of(1), of(2), of(3)] {
            insert(&mut values, value);
        }
        let at = |value: &str| values.iter().position(|known| equal(known, value)).unwrap_or(0);
        let (now, presets) = (at(&knob.value), [0, 1, 2, 3].map(|rung| at(of(rung))));
        dials.push(Dial { node: knob.node.clone(), parameter: knob.parameter, now, presets, values });
    }
    for (rung, form) in laid.iter().enumerate() {
        for (node, parameter, [here, there]) in graph.fields_otherwise(form, targets) {
            let known = dials.iter().position(|dial| dial.node == node && dial.parameter == parameter);
            let at = known.unwrap_or_else(|| {
                dials.push(Dial { node, parameter, now: 0, presets: [0; 4], values: vec![here] });
                dials.len() - 1
            });
            let dial = &mut dials[at];
            if !dial.values.contains(&there) {
                dial.values.push(there.clone());
            }
            dial.presets[rung] = dial.values.iter().position(|known| *known == there).unwrap_or(0);
        }
    }
    Ok(dials)
}

/// Canonical text may write a number otherwise than a ladder does.
fn equal(a: &str, b: &str) -> bool {
    a == b || a.parse::<f64>().is_ok_and(|a| b.parse() == Ok(a))
}

/// Puts a value where it belongs by size, which falls along some ladders; in front where it is no number.
fn insert(values: &mut Vec<String>, value: &str) {
    if values.iter().any(|known| equal(known, value)) {
        return;
    }
    let number = |text: &str| text.parse::<f64>().ok();
    let ends = values.first().and_then(|v| number(v)).zip(values.last().and_then(|v| number(v)));
    let place = match (number(value), ends) {
        (Some(new), Some((first, last))) if first != last => {
            let before = |known: f64| if first < last { known < new } else { known > new };
            values.iter().take_while(|known| number(known).is_some_and(before)).count()
        }
        _ => 0,
    };
    values.insert(place, value.to_owned());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_put_where_they_belong_on_rising_and_falling_ladders() {
        let with = |ladder: &[&str], value: &str| {
            let mut values: Vec<String> = ladder.iter().map(|v| (*v).to_owned()).collect();
            insert(&mut values, value);
            values.join(" ")
        };
        assert_eq!(with(&["4", "16", "64"], "32"), "4 16 32 64");
        assert_eq!(with(&["4", "16", "64"], "16.0"), "4 16 64");
        assert_eq!(with(&["4", "16", "64"], "100"), "4 16 64 100");
        assert_eq!(with(&["0.03", "0.01", "0.0"], "0.02"), "0.03 0.02 0.01 0.0");
        assert_eq!(with(&["0.0"], "1.0"), "1.0 0.0", "a filter that only the reference turns off");
        assert_eq!(with(&["F32", "F64"], "F16"), "F16 F32 F64");
    }
}
