//! The table of kinds under test, and its tests.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use engine::{
    Digest, Engine, Event, Graph, Keep, KindEntry, ParamSpec, Registry, Role, RunOptions, Setting, Source,
    SourceRoot, State, Store,
};

/// Memory limit of the engines, in bytes.
const MEMORY: u64 = 8 << 30;

/// Results of a run: for each node, by name, its key and the digests of its outputs.
pub(crate) type Results = BTreeMap<String, (Digest, Vec<Digest>)>;

/// A table of kinds under test, with a fixture.
///
/// Only one thread at a time may use a table, since the engine keeps only the digests of the last run.
pub struct Table {
    registry: Registry,
    /// Names of the kinds under test; empty for all kinds of the registry.
    names: Vec<&'static str>,
    fixture: String,
    folder: PathBuf,
    engine: Engine,
}

impl Table {
    /// A table of all kinds of a registry. `fixture` is the text of a graph. Its paths are relative to `folder`, which
    /// is also the output folder of its sinks.
    pub fn new(registry: Registry, fixture: impl Into<String>, folder: impl Into<PathBuf>) -> Self {
        let engine = Engine::new(Store::in_memory(), 2, MEMORY);
        Self { registry, names: Vec::new(), fixture: fixture.into(), folder: folder.into(), engine }
    }

    /// Restricts the tests to the kinds with these names. The fixture may also use other kinds of the registry, which
    /// are not tested.
    #[must_use]
    pub fn only(mut self, names: &[&'static str]) -> Self {
        self.names = names.to_vec();
        self
    }

    /// Runs a graph in the folder of the table, to make the files that the fixture reads.
    ///
    /// # Errors
    /// The mistakes of the graph, or the failures of its nodes, as text.
    pub fn make_files(&self, text: &str) -> Result<(), String> {
        let root = SourceRoot::new(&self.folder);
        let graph = Graph::parse(Source::new("files.ron", text), &self.registry, root);
        match self.run(&self.engine, &graph.map_err(|mistakes| mistakes.to_string())?) {
            (_, Some(failures)) => Err(failures),
            (_, None) => Ok(()),
        }
    }

    /// The problems that all tests find, except the comparison with stored digests.
    pub fn problems(&self) -> Vec<String> {
        let tests = [
            Self::undocumented,
            Self::missing,
            Self::accepted_beyond_ranges,
            Self::wrong_knobs,
            Self::parameters_without_effect,
            Self::wrong_encodings,
            Self::differences_in_actions,
        ];
        tests.iter().flat_map(|test| test(self)).collect()
    }

    /// Kinds, ports and parameters without documentation or with a repeated name, and parameters without a second value
    /// for tests (`other`).
    pub fn undocumented(&self) -> Vec<String> {
        let mut problems = Vec::new();
        for kind in self.registry.iter().filter(|kind| self.tests(kind)) {
            if kind.doc.trim().len() <= 20 {
                problems.push(format!("`{}` has no documentation", kind.name));
            }
            if kind.version == 0 || kind.outputs.is_empty() {
                problems.push(format!("`{}` has the version 0, or no outputs", kind.name));
            }
            let mut names = BTreeSet::new();
            for port in &kind.inputs {
                if !names.insert(port.name) || port.doc.is_empty() {
                    problems
                        .push(format!("`{}.{}` occurs twice, or has no documentation", kind.name, port.name));
                }
            }
            for param in &kind.params {
                let name = format!("`{}.{}`", kind.name, param.name);
                if !names.insert(param.name) || param.doc.is_empty() {
                    problems.push(format!("{name} occurs twice, or has no documentation"));
                }
                if param.other.is_none() && param.inert.is_none() && param.role == Role::Value {
                    problems.push(format!("{name} has no second value"));
                }
                if param.other.is_some() && param.other == (param.default)().as_deref() {
                    problems.push(format!("the second value of {name} is its default"));
                }
            }
        }
        problems
    }

    /// Kinds without a node in the fixture, and nodes of the fixture that fail.
    pub fn missing(&self) -> Vec<String> {
        let graph = match self.parse(&[]) {
            Ok(graph) => graph,
            Err(problem) => return vec![problem],
        };
        let used: BTreeSet<&str> = graph.nodes.iter().map(|node| node.kind.name).collect();
        let unused = self
            .registry
            .iter()
            .filter(|kind| self.tests(kind) && !used.contains(kind.name))
            .map(|kind| kind.name);
        let mut problems: Vec<String> =
            unused.map(|name| format!("the fixture has no node of the kind `{name}`")).collect();
        problems.extend(self.run(&self.engine, &graph).1);
        problems
    }

    /// Numbers outside their range, NaN and infinities that a node of the fixture accepts.
    pub fn accepted_beyond_ranges(&self) -> Vec<String> {
        self.on_fixture(|graph, problems| {
            for (node, spec) in self.parameters(graph) {
                let Some((low, high)) = spec.range else { continue };
                let number = |text: &str| text.trim().parse::<f64>().is_ok();
                if !(spec.default)().as_deref().or(spec.other).is_some_and(number) {
                    continue;
                }
                for wrong in [low - 1.0 - low.abs(), high + 1.0 + high.abs(), f64::NAN, f64::INFINITY] {
                    // Whole numbers are refused because they are outside the range, and other numbers because of
                    // their form.
                    let whole = wrong.fract() == 0.0 && wrong.abs() < 1e18;
                    let text = if whole { format!("{wrong:.0}") } else { format!("{wrong}") };
                    match self.parse(&[setting(node, spec, &text)]) {
                        Ok(_) => problems.push(format!("`{node}.{}` accepts {text}", spec.name)),
                        Err(message) if !message.contains(spec.name) => {
                            problems.push(format!(
                                "the error for `{node}.{}` = {text} lacks its name: {message}",
                                spec.name
                            ));
                        }
                        Err(_) => {}
                    }
                }
            }
        })
    }

    /// Values of knobs that their node refuses, and presets that do not set a knob to its value for this preset.
    pub fn wrong_knobs(&self) -> Vec<String> {
        self.on_fixture(|graph, problems| {
            for (node, spec) in self.parameters(graph) {
                let Some(knob) = &spec.knob else { continue };
                let values = knob.values();
                if values.is_empty() {
                    problems.push(format!("`{node}.{}` is a knob without values", spec.name));
                }
                for value in values {
                    if let Err(message) = self.parse(&[setting(node, spec, &value)]) {
                        problems.push(format!("`{node}.{}` = {value}: {message}", spec.name));
                    }
                }
            }
            for (step, preset) in engine::PRESETS.iter().enumerate() {
                let source =
                    Source::new("fixture.ron", self.fixture.as_str()).with_preset(preset, &self.registry);
                let set = match Graph::parse(source, &self.registry, SourceRoot::new(&self.folder)) {
                    Ok(set) => set,
                    Err(mistakes) => {
                        problems.push(format!("{preset}: {mistakes}"));
                        continue;
                    }
                };
                for (knob, before) in set.knobs(&[]).iter().zip(graph.knobs(&[])) {
                    let value = knob.knob.ladder[step];
                    // Canonical text may format a number differently.
                    let equal = |a: &str, b: &str| a == b || a.parse::<f64>().ok() == b.parse::<f64>().ok();
                    let want = if value.is_empty() { before.value.as_str() } else { value };
                    if !equal(&knob.value, want) {
                        let (node, name) = (&knob.node, &knob.parameter);
                        problems.push(format!("{preset}: `{node}.{name}` is {}, not {want}", knob.value));
                    }
                }
            }
        })
    }

    /// Parameters whose second value is refused, fails, leaves the key unchanged, or leaves every output unchanged
    /// without a stated reason (`inert`). A parameter passes if one node of its kind shows an effect.
    pub fn parameters_without_effect(&self) -> Vec<String> {
        self.on_fixture(|graph, problems| {
            let (before, _) = self.run(&self.engine, graph);
            let (mut wrong, mut right) = (BTreeMap::<_, Vec<String>>::new(), BTreeSet::new());
            for node in graph.nodes.iter().filter(|node| self.tests(&node.kind)) {
                for spec in &node.kind.params {
                    let Some(other) = spec.other else { continue };
                    // A file of another name does not exist; another value of a parameter that may name files does.
                    if spec.role != Role::Value && other.contains('"') {
                        continue;
                    }
                    let place = (node.kind.name, spec.name);
                    match self.effect(&before, &node.id, spec, other) {
                        Ok(()) => _ = right.insert(place),
                        Err(text) => {
                            let text = format!("{} {}.{} = {other}: {text}", node.id, place.0, place.1);
                            wrong.entry(place).or_default().push(text);
                        }
                    }
                }
            }
            wrong.retain(|place, _| !right.contains(place));
            problems.extend(wrong.into_values().flatten());
        })
    }

    fn effect(&self, before: &Results, id: &str, spec: &ParamSpec, other: &str) -> Result<(), String> {
        let changed = self.parse(&[setting(id, spec, other)])?;
        let index = changed.find(id).ok_or("the node has another name")?;
        let options = RunOptions { out: self.folder.clone(), only: vec![index], ..RunOptions::default() };
        let mut key = None;
        let outcome = self.engine.run(&changed, &options, |event| match event {
            Event::Node { id: ended, key: Some(found), .. } if ended == id => key = Some(found),
            _ => {}
        });
        if let Some(failures) = outcome.failures {
            return Err(format!("fails: {failures}"));
        }
        let (old_key, old_outputs) = before.get(id).ok_or("the node has no result")?;
        if key.as_ref() == Some(old_key) {
            return Err("leaves the key unchanged".to_owned());
        }
        if spec.inert.is_none() && self.engine.digests(&changed, index).as_ref() == Some(old_outputs) {
            return Err("leaves every output unchanged, and does not state why".to_owned());
        }
        Ok(())
    }

    /// Values that differ after they were decoded and encoded, and types of outputs without a stored value to test. Also
    /// decodes cut values, which must not panic.
    pub fn wrong_encodings(&self) -> Vec<String> {
        self.on_fixture(|graph, problems| {
            let (results, _) = self.run(&self.engine, graph);
            let (mut types, mut tested) = (BTreeSet::new(), BTreeSet::new());
            for node in graph.nodes.iter().filter(|node| self.tests(&node.kind)) {
                let Some((_, digests)) = results.get(&node.id) else { continue };
                for (port, digest) in node.kind.outputs.iter().zip(digests) {
                    // Kinds that keep only digests have nothing to decode.
                    if node.kind.store == Keep::Always {
                        types.insert(port.artifact.name);
                    }
                    let Ok(Some(bytes)) = self.engine.store().get_blob(digest) else { continue };
                    tested.insert(port.artifact.name);
                    match port.artifact.round_trip(&bytes) {
                        Ok(again) if again == bytes => {}
                        Ok(_) => problems.push(format!("`{}.{}` is encoded differently", node.id, port.name)),
                        Err(error) => problems.push(format!("`{}.{}`: {error}", node.id, port.name)),
                    }
                    for cut in [0, 1, bytes.len() / 2, bytes.len().saturating_sub(1)] {
                        let _ = port.artifact.round_trip(&bytes[..cut]);
                    }
                }
            }
            let missing = types.difference(&tested);
            problems.extend(missing.map(|name| format!("no value of the type `{name}` is stored")));
        })
    }

    /// Nodes that another process would compute differently: every node is computed from an action folder by an engine
    /// without a cache, as on another machine. A second engine takes the outputs and must then find all results, with
    /// the digests of the run in this process.
    pub fn differences_in_actions(&self) -> Vec<String> {
        self.on_fixture(|graph, problems| {
            let (here, failures) = self.run(&self.engine, graph);
            problems.extend(failures);
            let worker = Engine::new(Store::unavailable("a worker keeps nothing".to_owned()), 2, MEMORY);
            let taker = Engine::new(Store::in_memory(), 2, MEMORY);
            let place = match tempfile::tempdir() {
                Ok(place) => place,
                Err(error) => return problems.push(format!("no temporary folder: {error}")),
            };
            // Nodes that run programs are computed nowhere else.
            let portable = |node: &engine::Node| !node.kind.runs_programs;
            for (index, node) in graph.nodes.iter().enumerate().filter(|(_, node)| portable(node)) {
                let [folder, out] =
                    ["action", "out"].map(|name| place.path().join(format!("{index}-{name}")));
                let done = self.engine.write_action(graph, index, &folder).and_then(|key| {
                    let done =
                        worker.run_action(&self.registry, &folder, &out, &Default::default(), |_| {})?;
                    taker.take_outputs(&self.registry, &folder, &out)?;
                    Ok(here.get(&node.id).is_some_and(|(known, _)| *known == key) && done.key == key)
                });
                match done {
                    Ok(true) => {}
                    Ok(false) => problems.push(format!("`{}` has another key in an action", node.id)),
                    Err(error) => problems.push(format!("`{}`: {error}", node.id)),
                }
            }
            let only = (0..graph.nodes.len()).collect();
            let options = RunOptions { out: place.path().to_owned(), only, ..RunOptions::default() };
            let ran = taker.run(graph, &options, |_| {}).totals.ran;
            let programs = graph.nodes.iter().filter(|node| !portable(node)).count();
            if ran > programs {
                problems.push(format!("nodes whose outputs were not taken: {}", ran - programs));
            }
            let (there, _) = self.run(&taker, graph);
            let differs = here.iter().filter(|(id, result)| there.get(*id) != Some(result));
            problems.extend(differs.map(|(id, _)| format!("`{id}` has other outputs in an action")));
        })
    }

    /// Compares each node with a file that has one line per node: its kind, its key and the digests of its outputs. If
    /// the environment variable `UPDATE_GOLDEN` is set, writes the file instead.
    ///
    /// A key depends on the version of the kind and the content of all inputs of the node. If the outputs differ for an
    /// equal key, the version should have been increased. A key that is not in the file is not a problem: an upstream
    /// node or the version has changed.
    pub fn outputs_that_changed(&self, file: &Path) -> Vec<String> {
        self.on_fixture(|graph, problems| {
            let (results, _) = self.run(&self.engine, graph);
            let nodes = graph.nodes.iter().filter(|node| self.tests(&node.kind));
            let results = nodes.filter_map(|node| Some((node.kind.name, results.get(&node.id)?)));
            problems.extend(crate::golden::compare(file, results));
        })
    }

    /// True if the tests apply to this kind.
    fn tests(&self, kind: &KindEntry) -> bool {
        self.names.is_empty() || self.names.contains(&kind.name)
    }

    fn parse(&self, settings: &[Setting]) -> Result<Graph, String> {
        let source = engine::apply(&Source::new("fixture.ron", self.fixture.as_str()), settings);
        Graph::parse(source, &self.registry, SourceRoot::new(&self.folder))
            .map_err(|mistakes| mistakes.to_string())
    }

    /// Calls `test` with the graph of the fixture. Returns the problems that it adds, or the mistakes of the graph.
    fn on_fixture(&self, test: impl FnOnce(&Graph, &mut Vec<String>)) -> Vec<String> {
        let mut problems = Vec::new();
        match self.parse(&[]) {
            Ok(graph) => test(&graph, &mut problems),
            Err(mistakes) => problems.push(mistakes),
        }
        problems
    }

    /// The parameters under test, each with the name of its node.
    fn parameters<'g>(&self, graph: &'g Graph) -> impl Iterator<Item = (&'g str, &'g ParamSpec)> {
        let nodes = graph.nodes.iter().filter(|node| self.tests(&node.kind));
        nodes.flat_map(|node| node.kind.params.iter().map(|spec| (node.id.as_str(), spec)))
    }

    /// Runs every node of a graph, not only those that a sink needs. Returns the results, and the failures as text.
    fn run(&self, engine: &Engine, graph: &Graph) -> (Results, Option<String>) {
        let only = (0..graph.nodes.len()).collect();
        let options = RunOptions { out: self.folder.clone(), only, ..RunOptions::default() };
        let mut keys = Vec::new();
        let outcome = engine.run(graph, &options, |event| {
            if let Event::Node { id, key: Some(key), state: State::Ran | State::Cached, .. } = event {
                keys.push((id, key));
            }
        });
        let result = |(id, key): (String, Digest)| {
            let outputs = engine.digests(graph, graph.find(&id)?)?;
            Some((id, (key, outputs)))
        };
        (keys.into_iter().filter_map(result).collect(), outcome.failures.map(|failures| failures.to_string()))
    }
}

fn setting(node: &str, spec: &ParamSpec, value: &str) -> Setting {
    Setting { node: node.to_owned(), field: spec.name.to_owned(), value: value.to_owned() }
}
