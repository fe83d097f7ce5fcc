//! A compiled graph equals the graph of its text in every respect.

use std::fs;

use engine::{Diagnostics, Engine, Graph, RunOptions, Source, SourceRoot, Store};

use crate::lab::{Lab, graph_text};

/// Every kind of field, in a text long enough that compiling pays.
fn text() -> String {
    let nodes = "in: LoadNumber(path: \"a.txt\"), r: Ramp(value: \"in\", count: 3000), s: Sum(numbers: \"r\"), \
        m: Series(value: \"s\", samples: 40), t: Add(terms: [\"s\", \"m\", \"in\"], bias: -0.0), \
        u: Scale(value: \"t\", by: 1e-3), save: WriteNumber(number: [\"u\", \"m\"], path: \"deep/save.txt\"),";
    graph_text(&format!("// {}\n{nodes}", "long ".repeat(4000)))
}

fn cached(lab: &Lab, store: &Store, text: &str) -> Result<Graph, Diagnostics> {
    Graph::parse_cached(Source::new("graph.ron", text), &lab.registry, SourceRoot::new(lab.path("")), store)
}

/// Runs on an empty store: keys, files, and what failed.
fn run(lab: &Lab, graph: &Graph) -> (Vec<(String, String)>, String) {
    let engine = Engine::new(Store::in_memory(), 2, 1 << 30);
    let options = RunOptions { out: lab.path("out"), ..RunOptions::default() };
    let mut keys = Vec::new();
    let outcome = engine.run(graph, &options, |event| {
        if let engine::Event::Node { id, key, notes, .. } = event {
            keys.push((id, format!("{key:?} {notes:?}")));
        }
    });
    keys.sort();
    (keys, outcome.failures.map(|failures| failures.render(false)).unwrap_or_default())
}

#[test]
fn runs_as_the_text_does() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    let engine = lab.engine();
    let (text, store) = (text(), engine.store());
    let parsed = lab.parse(&text).unwrap();
    let records = store.record_keys().unwrap().len();
    let first = cached(&lab, store, &text).unwrap();
    assert_eq!(store.record_keys().unwrap().len(), records + 1, "it was compiled");
    let second = cached(&lab, store, &text).unwrap();
    let shape = |graph: &Graph| -> Vec<_> {
        let node = |index: usize| {
            let node = &graph.nodes[index];
            let kind = node.kind.name;
            let wires = (node.inputs.clone(), graph.reads(index).to_vec(), graph.consumers(index).to_vec());
            (node.id.clone(), kind, wires, node.sink_path.clone())
        };
        (0..graph.nodes.len()).map(node).collect()
    };
    assert_eq!((shape(&first), shape(&second)), (shape(&parsed), shape(&parsed)));
    assert_eq!((parsed.order(), parsed.scene), (second.order(), second.scene));
    let expected = run(&lab, &parsed);
    let file = lab.out("deep/save.txt");
    fs::remove_dir_all(lab.path("out")).unwrap();
    assert_eq!(run(&lab, &second), expected);
    assert_eq!(lab.out("deep/save.txt"), file);
    assert_eq!(expected.1, "");
}

#[test]
fn failures_still_point_into_the_text() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "not a number");
    let engine = lab.engine();
    let graphs = [(); 2].map(|()| cached(&lab, engine.store(), &text()).unwrap());
    let [parsed, compiled] = graphs.map(|graph| run(&lab, &graph).1);
    assert!(parsed.contains("a.txt"), "{parsed}");
    assert_eq!(parsed, compiled);
}

#[test]
fn is_made_again_when_anything_it_depends_on_changes() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    let engine = lab.engine();
    let (text, store) = (text(), engine.store());
    let compiled = || store.record_keys().unwrap().len();
    cached(&lab, store, &text).unwrap();
    assert_eq!(compiled(), 1);
    cached(&lab, store, &text.replace("count: 3000", "count: 3001")).unwrap();
    assert_eq!(compiled(), 2, "another text");
    let gone = lab.path("a.txt");
    fs::remove_file(&gone).unwrap();
    let mistakes = cached(&lab, store, &text).map(drop).unwrap_err().render(false);
    assert!(mistakes.contains("`a.txt` does not exist"), "{mistakes}");
    assert!(mistakes.contains("ask whoever counted"), "its kind says where to get it: {mistakes}");
    fs::write(gone, "4").unwrap();
    cached(&lab, store, &text).unwrap();
    // A wrong text is never kept.
    let wrong = text.replace("samples", "sample");
    for _ in 0..2 {
        assert!(cached(&lab, store, &wrong).is_err());
    }
    assert_eq!(compiled(), 2);
}

#[test]
fn damage_to_it_costs_only_time() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    let text = text();
    let expected = run(&lab, &cached(&lab, lab.engine().store(), &text).unwrap());
    for (number, name) in lab.cache_files().into_iter().enumerate() {
        let good = fs::read(&name).unwrap();
        for at in (0..good.len()).step_by(1 + good.len() / 20) {
            let mut bad = good.clone();
            bad[at] ^= 1 << (at % 8);
            fs::write(&name, bad).unwrap();
            let graph = cached(&lab, lab.engine().store(), &text).unwrap();
            assert_eq!(run(&lab, &graph), expected, "file {number} byte {at}");
        }
        fs::write(&name, good).unwrap();
    }
}

/// The files in which the cache keeps the last runs of a lab's graphs.
fn last_runs(lab: &Lab) -> Vec<std::path::PathBuf> {
    let folder = lab.cache().join("v1/last");
    lab.cache_files().into_iter().filter(|path| path.starts_with(&folder)).collect()
}

#[test]
fn what_the_last_run_looked_up_is_found_by_key_or_not_at_all() {
    let lab = Lab::on_disk();
    lab.write("a.txt", "3");
    let nodes = |by: f64| {
        format!(
            "in: LoadNumber(path: \"a.txt\"), s: Scale(value: \"in\", by: {by:?}), t: Round(value: \"s\"), \
             w: WriteNumber(number: \"t\", path: \"w.txt\")"
        )
    };
    assert_eq!(lab.run(&nodes(2.0)).ran(), "in s t w");
    assert_eq!(last_runs(&lab).len(), 1, "one for the graph file");
    // It alone suffices to find that nothing has to run ..
    let paths = ["records.log", "records.index"].map(|name| lab.cache().join("v1").join(name));
    let kept = paths.clone().map(|path| fs::read(path).ok());
    paths.iter().for_each(|path| drop(fs::remove_file(path)));
    assert_eq!(lab.run(&nodes(2.0)).ran(), "");
    for (path, bytes) in paths.iter().zip(&kept) {
        bytes.iter().for_each(|bytes| fs::write(path, bytes).unwrap());
    }
    // .. and a change is noticed: an edit, another content of a file.
    assert_eq!(lab.run(&nodes(2.1)).ran(), "s t", "rounding stops it");
    lab.write("a.txt", "30");
    assert_eq!(lab.run(&nodes(2.1)).ran(), "in s t w");
    lab.write("a.txt", "3");
    assert_eq!(lab.run(&nodes(2.0)).ran(), "", "known by records, though not by the last run");
    assert_eq!(lab.out("w.txt"), "6.0\n");
    // A damaged file costs time only.
    for cut in [1, 40, 100] {
        let path = &last_runs(&lab)[0];
        let bytes = fs::read(path).unwrap();
        fs::write(path, &bytes[..bytes.len() - cut]).unwrap();
        assert_eq!(lab.run(&nodes(2.0)).ran(), "");
    }
    // Collected results are not found in it.
    let limits = cache::Limits { max_size: Some(0), ..cache::Limits::default() };
    lab.engine().store().collect(&limits, &engine::blobs_of, std::time::Duration::from_secs(60)).unwrap();
    assert_eq!(last_runs(&lab).len(), 0);
    assert_eq!(lab.run(&nodes(2.0)).ran(), "in s t w");
}
