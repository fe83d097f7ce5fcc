//! Tests of every kind, every parameter and every output. They use the registry of kinds and contain no list of
//! names. A new kind is tested as soon as `table/fixture.ron` contains a node of this kind.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod files;
mod fuzz;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

use engine::{
    Digest, Engine, Event, Graph, ParamSpec, Registry, Role, RunOptions, Setting, Source, SourceRoot, State,
};

/// Results of a run of the fixture: for each node, by name, its key and the digests of its outputs.
type Results = BTreeMap<String, (Digest, Vec<Digest>)>;

struct Fixture {
    registry: Registry,
    engine: Engine,
    folder: PathBuf,
}

/// Fixture that all tests share, because its first run is expensive. Only one test at a time uses it, since the
/// engine keeps only the digests of the last run.
static SHARED: LazyLock<Mutex<Fixture>> = LazyLock::new(|| Mutex::new(Fixture::new()));

fn shared() -> MutexGuard<'static, Fixture> {
    SHARED.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Fixture {
    fn new() -> Self {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("table");
        std::fs::create_dir_all(&folder).unwrap();
        let engine = Engine::new(engine::Store::in_memory(), 2, 8 << 30);
        let fixture = Self { registry: nodes::registry(), engine, folder };
        fixture.make_files();
        fixture
    }

    /// Writes the files that the loaders of the fixture read, using the sinks of the crate.
    fn make_files(&self) {
        let text = include_str!("files.ron");
        let graph = self.parse(text, &[]).unwrap_or_else(|e| panic!("{e}"));
        let outcome = self.run(&graph);
        assert!(outcome.1.is_empty(), "{}", outcome.1);
        for (name, bytes) in handmade() {
            let path = self.folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
        for (name, shift) in [("model", 0.0), ("model_b", 0.5)] {
            std::fs::create_dir_all(self.folder.join(name)).unwrap();
            for (file, bytes) in ["cameras", "images", "points3D"].iter().zip(files::colmap_model(shift)) {
                std::fs::write(self.folder.join(format!("{name}/{file}.bin")), bytes).unwrap();
            }
        }
        for (name, text) in [
            ("colmap.sh", files::COLMAP.replace("MODEL", "model")),
            ("colmap-b.sh", files::COLMAP.replace("MODEL", "model_b")),
            ("ocio.sh", files::OCIO.replace("FROM", "a a")),
            ("ocio-b.sh", files::OCIO.replace("FROM", "'\\076' '\\075'")),
            ("stand-in.sh", files::TRAINER.replace("FIRST", "splats.ply")),
            ("stand-in-b.sh", files::TRAINER.replace("FIRST", "b.ply")),
        ] {
            // Written under another name and renamed, since a file that is open for writing cannot be run.
            let (path, new) = (self.folder.join(name), self.folder.join(format!("{name}.new")));
            std::fs::write(&new, text).unwrap();
            #[cfg(unix)]
            std::fs::set_permissions(&new, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
            std::fs::rename(new, path).unwrap();
        }
    }

    fn parse(&self, text: &str, settings: &[Setting]) -> Result<Graph, String> {
        let source = engine::apply(&Source::new("fixture.ron", text), settings);
        Graph::parse(source, &self.registry, SourceRoot::new(&self.folder)).map_err(|e| e.to_string())
    }

    fn run(&self, graph: &Graph) -> (Results, String) {
        self.run_on(&self.engine, graph)
    }

    fn run_on(&self, engine: &Engine, graph: &Graph) -> (Results, String) {
        // Run every node, not only those that a sink needs.
        let only = (0..graph.nodes.len()).collect();
        let options = RunOptions { out: self.folder.clone(), only, ..RunOptions::default() };
        let mut results = Results::new();
        let outcome = engine.run(graph, &options, |event| {
            if let Event::Node { id, key: Some(key), state: State::Ran | State::Cached, .. } = event {
                results.insert(id, (key, Vec::new()));
            }
        });
        for (id, result) in &mut results {
            result.1 = engine.digests(graph, graph.find(id).unwrap()).unwrap();
        }
        (results, outcome.failures.map(|f| f.to_string()).unwrap_or_default())
    }
}

/// Files in formats that no sink writes.
fn handmade() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("mesh.ply", files::MESH_PLY.into()),
        ("cameras.json", files::CAMERAS_JSON.into()),
        ("dataparser_transforms.json", files::DATAPARSER_JSON.into()),
        ("b.json", files::CAMERAS_JSON.into()),
        ("lpips.safetensors", files::lpips_safetensors()),
        ("exposure.safetensors", files::exposure_safetensors()),
        ("splats.ply", files::splats_ply(12)),
        ("b.ply", files::splats_ply(3)),
        ("object.glb", files::object_glb()),
        ("other.ocio", b"ocio_profile_version: 2\n".into()),
        ("points3D.txt", b"1 0.1 0.2 0.5 255 0 0 0.5\n2 0.3 -0.2 0.5 0 255 0 0.5\n".into()),
    ]
}

const FIXTURE: &str = include_str!("fixture.ron");

fn setting(node: &str, spec: &ParamSpec, value: &str) -> Setting {
    Setting { node: node.to_owned(), field: spec.name.to_owned(), value: value.to_owned() }
}

#[test]
fn every_kind_is_documented_and_its_parameters_are_complete() {
    for kind in nodes::registry().iter() {
        assert!(kind.doc.trim().len() > 20, "{} has no doc", kind.name);
        assert!(kind.version > 0 && !kind.outputs.is_empty(), "{}", kind.name);
        let mut names = BTreeSet::new();
        for port in &kind.inputs {
            assert!(names.insert(port.name), "{}.{} twice", kind.name, port.name);
            assert!(!port.doc.is_empty(), "{}.{} has no doc", kind.name, port.name);
        }
        for param in &kind.params {
            let name = format!("{}.{}", kind.name, param.name);
            assert!(names.insert(param.name), "{name} twice");
            assert!(!param.doc.is_empty(), "{name} has no doc");
            assert!(
                param.other.is_some() || param.inert.is_some() || param.role != Role::Value,
                "{name} has no second value"
            );
            assert_ne!(param.other, (param.default)().as_deref(), "{name}: its second value is the default");
        }
    }
}

#[test]
fn fixture_holds_every_kind_and_runs() {
    let fixture = shared();
    let graph = fixture.parse(FIXTURE, &[]).unwrap_or_else(|e| panic!("{e}"));
    let used: BTreeSet<&str> = graph.nodes.iter().map(|node| node.kind.name).collect();
    let missing: Vec<&str> =
        fixture.registry.iter().map(|k| k.name).filter(|name| !used.contains(name)).collect();
    assert!(missing.is_empty(), "no node of {missing:?} in nodes/tests/table/fixture.ron");
    let (_, failures) = fixture.run(&graph);
    assert!(failures.is_empty(), "{failures}");
}

#[test]
fn values_outside_their_range_are_refused() {
    let fixture = shared();
    let graph = fixture.parse(FIXTURE, &[]).unwrap_or_else(|e| panic!("{e}"));
    for node in &graph.nodes {
        for spec in &node.kind.params {
            let Some((low, high)) = spec.range else { continue };
            let number = |text: &str| text.trim().parse::<f64>().is_ok();
            if !(spec.default)().as_deref().or(spec.other).is_some_and(number) {
                continue;
            }
            for wrong in [low - 1.0 - low.abs(), high + 1.0 + high.abs(), f64::NAN, f64::INFINITY] {
                // Whole numbers are refused because they are outside the range, and other numbers because of their
                // form.
                let text = if wrong.fract() == 0.0 && wrong.abs() < 1e18 {
                    format!("{wrong:.0}")
                } else {
                    format!("{wrong}")
                };
                let result = fixture.parse(FIXTURE, &[setting(&node.id, spec, &text)]);
                let message = result.err().unwrap_or_else(|| panic!("{}.{} took {text}", node.id, spec.name));
                assert!(message.contains(spec.name), "{message}");
            }
        }
    }
}

/// Every value of every knob is valid for its node, and each preset sets all knobs to their values for that preset.
#[test]
fn every_value_of_a_knob_is_one_that_its_node_takes() {
    let fixture = shared();
    let graph = fixture.parse(FIXTURE, &[]).unwrap_or_else(|e| panic!("{e}"));
    for node in &graph.nodes {
        for spec in node.kind.params.iter().filter(|spec| spec.knob.is_some()) {
            let values = spec.knob.unwrap().values();
            assert!(!values.is_empty(), "{}.{} has no ladder", node.id, spec.name);
            for value in values {
                let graph = fixture.parse(FIXTURE, &[setting(&node.id, spec, &value)]);
                graph.unwrap_or_else(|e| panic!("{}.{} = {value}: {e}", node.id, spec.name));
            }
        }
    }
    for preset in engine::PRESETS {
        let source = Source::new("fixture.ron", FIXTURE).with_preset(preset, &fixture.registry);
        let root = SourceRoot::new(&fixture.folder);
        let laid = Graph::parse(source, &fixture.registry, root).unwrap_or_else(|e| panic!("{preset}: {e}"));
        for (knob, before) in laid.knobs(&[]).iter().zip(graph.knobs(&[])) {
            let rung = knob.knob.ladder[engine::PRESETS.iter().position(|name| *name == preset).unwrap()];
            // Canonical text may format a number differently.
            let equal = |a: &str, b: &str| a == b || a.parse::<f64>().ok() == b.parse::<f64>().ok();
            let want = if rung.is_empty() { before.value.as_str() } else { rung };
            assert!(equal(&knob.value, want), "{preset}: {}.{} is {}", knob.node, knob.parameter, knob.value);
        }
    }
}

#[test]
fn every_parameter_changes_the_key_and_the_output() {
    let fixture = shared();
    let graph = fixture.parse(FIXTURE, &[]).unwrap_or_else(|e| panic!("{e}"));
    let (before, _) = fixture.run(&graph);
    // A parameter passes if one node of its kind shows it.
    let (mut wrong, mut right) = (BTreeMap::<_, Vec<String>>::new(), BTreeSet::new());
    for node in &graph.nodes {
        for spec in &node.kind.params {
            let Some(other) = spec.other else { continue };
            // A file of another name does not exist; another value of a parameter that may name files does.
            if spec.role != Role::Value && other.contains('"') {
                continue;
            }
            let place = (node.kind.name, spec.name);
            let name = format!("{} {}.{}", node.id, place.0, place.1);
            let mut report = |text: String| wrong.entry(place).or_default().push(text);
            let changed = match fixture.parse(FIXTURE, &[setting(&node.id, spec, other)]) {
                Ok(graph) => graph,
                Err(error) => {
                    report(format!("{name}: its second value {other} is refused: {error}"));
                    continue;
                }
            };
            let only = vec![changed.find(&node.id).unwrap()];
            let options = RunOptions { out: fixture.folder.clone(), only, ..RunOptions::default() };
            let mut key = None;
            let outcome = fixture.engine.run(&changed, &options, |event| {
                if let Event::Node { id, key: Some(k), .. } = event
                    && id == node.id
                {
                    key = Some(k);
                }
            });
            let (old_key, old_outputs) = &before[&node.id];
            if let Some(failures) = outcome.failures {
                report(format!("{name} = {other} fails: {failures}"));
                continue;
            }
            if key.as_ref() == Some(old_key) {
                report(format!("{name} = {other} leaves the key as it is"));
                continue;
            }
            let outputs = fixture.engine.digests(&changed, changed.find(&node.id).unwrap()).unwrap();
            if outputs == *old_outputs && spec.inert.is_none() {
                report(format!("{name} = {other} leaves every output as it is, and does not say why"));
                continue;
            }
            right.insert(place);
        }
    }
    wrong.retain(|place, _| !right.contains(place));
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn decoding_then_encoding_gives_the_same_bytes() {
    let fixture = shared();
    let graph = fixture.parse(FIXTURE, &[]).unwrap_or_else(|e| panic!("{e}"));
    let (results, _) = fixture.run(&graph);
    let mut types = BTreeSet::new();
    for node in &graph.nodes {
        let Some((_, digests)) = results.get(&node.id) else { continue };
        for (port, digest) in node.kind.outputs.iter().zip(digests) {
            // Kinds that keep only digests have nothing to decode.
            let Some(bytes) = fixture.engine.store().get_blob(digest).unwrap() else { continue };
            assert_eq!(port.artifact.round_trip(&bytes).unwrap(), bytes, "{}.{}", node.id, port.name);
            types.insert(port.artifact.name);
            for cut in [0, 1, bytes.len() / 2, bytes.len().saturating_sub(1)] {
                let _ = port.artifact.round_trip(&bytes[..cut]);
            }
        }
    }
    assert!(types.len() >= 6, "only {types:?} are stored");
}

/// Compares each node with `golden.txt`, which has one line per node: its kind, its key and the digests of its
/// outputs. A key depends on the VERSION of the kind and the content of all inputs of the node. If the outputs
/// differ for an equal key, the VERSION should have been increased. A key that is not in the file is not an error:
/// an upstream node or the VERSION has changed.
#[test]
fn equal_keys_give_the_outputs_they_have_always_given() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/table/golden.txt");
    let fixture = shared();
    let graph = fixture.parse(FIXTURE, &[]).unwrap_or_else(|e| panic!("{e}"));
    let (results, _) = fixture.run(&graph);
    let now: Vec<[String; 3]> = graph
        .nodes
        .iter()
        .filter_map(|node| {
            let (key, outputs) = results.get(&node.id)?;
            // Half of a digest suffices, and keeps the lines short.
            let half = |digest: &Digest| digest.to_string()[..32].to_owned();
            let outputs: Vec<String> = outputs.iter().map(half).collect();
            Some([node.kind.name.to_owned(), half(key), outputs.join(" ")])
        })
        .collect();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        let lines: String = now.iter().map(|line| line.join(" ") + "\n").collect();
        return std::fs::write(path, lines).unwrap();
    }
    let golden = std::fs::read_to_string(path).unwrap();
    let golden: Vec<(&str, &str, &str)> = golden
        .lines()
        .filter_map(|line| {
            let (kind, rest) = line.split_once(' ')?;
            rest.split_once(' ').map(|(key, outputs)| (kind, key, outputs))
        })
        .collect();
    let mut wrong = Vec::new();
    for [kind, key, outputs] in &now {
        if !golden.iter().any(|line| line.0 == kind) {
            wrong.push(format!("`{kind}` has no line in golden.txt: run with UPDATE_GOLDEN=1"));
        }
        if golden.iter().any(|line| line.1 == key && line.2 != outputs) {
            wrong.push(format!("`{kind}`: output changed, VERSION did not; raise it, then UPDATE_GOLDEN=1"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Every node of the fixture is computed from an action folder by an engine without a cache, as a worker on another
/// machine does it. A second engine takes the outputs and then finds all results, with the digests of the run in
/// this process.
#[test]
fn every_kind_gives_the_same_bytes_from_an_action_folder() {
    let fixture = shared();
    let graph = fixture.parse(FIXTURE, &[]).unwrap_or_else(|e| panic!("{e}"));
    let (here, failures) = fixture.run(&graph);
    assert!(failures.is_empty(), "{failures}");
    let worker = Engine::new(engine::Store::unavailable("a worker keeps nothing".to_owned()), 2, 8 << 30);
    let taker = Engine::new(engine::Store::in_memory(), 2, 8 << 30);
    let place = tempfile::tempdir().unwrap();
    let (folder, out) = (place.path().join("action"), place.path().join("out"));
    let cancel = Default::default();
    for (index, node) in graph.nodes.iter().enumerate() {
        let failed = |error: engine::ActionError| -> ! { panic!("{}: {error}", node.id) };
        if node.kind.runs_programs {
            let refused = fixture.engine.write_action(&graph, index, &folder);
            assert!(matches!(refused, Err(engine::ActionError::Program { .. })), "{}", node.id);
            continue;
        }
        let key = fixture.engine.write_action(&graph, index, &folder).unwrap_or_else(|e| failed(e));
        assert_eq!(key, here[&node.id].0, "{}", node.id);
        let done = worker.run_action(&fixture.registry, &folder, &out, &cancel, |_| {});
        let done = done.unwrap_or_else(|e| failed(e));
        assert_eq!((done.key, done.kind), (key, node.kind.name));
        taker.take_outputs(&fixture.registry, &folder, &out).unwrap_or_else(|e| failed(e));
        std::fs::remove_dir_all(&folder).unwrap();
        std::fs::remove_dir_all(&out).unwrap();
    }
    let only = (0..graph.nodes.len()).collect();
    let options = RunOptions { out: place.path().to_owned(), only, ..RunOptions::default() };
    let programs = graph.nodes.iter().filter(|node| node.kind.runs_programs).count();
    assert_eq!(taker.run(&graph, &options, |_| {}).totals.ran, programs, "every other result was taken");
    let (there, failures) = fixture.run_on(&taker, &graph);
    assert!(failures.is_empty(), "{failures}");
    assert_eq!(there, here);
}
