//! Tests of actions: a node that another process computes, and its outputs.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use cache::{Digest, Store};
use engine::{ActionDone, ActionError, Engine, Event, Graph, Level};

use crate::lab::{Lab, graph_text};

/// An engine without a cache, as in a worker.
fn worker() -> Engine {
    Engine::new(Store::unavailable("a worker keeps nothing".to_owned()), 2, 1 << 30)
}

fn compute(lab: &Lab, folder: &Path, out: &Path) -> Result<ActionDone, ActionError> {
    worker().run_action(&lab.registry, folder, out, &Arc::new(AtomicBool::new(false)), |_| {})
}

/// A lab in which the inputs of the last node of a graph are known, with the action folder of that node.
struct Bench {
    lab: Lab,
    graph: Graph,
    node: usize,
    key: Digest,
}

impl Bench {
    fn new(nodes: &str, files: &[(&str, &str)]) -> Self {
        let lab = Lab::on_disk();
        for (name, text) in files {
            let path = lab.path(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        let graph = lab.parse(&graph_text(nodes)).unwrap_or_else(|error| panic!("{error}"));
        let node = graph.nodes.len() - 1;
        let above: Vec<String> =
            graph.reads(node).iter().map(|above| graph.nodes[*above].id.clone()).collect();
        if !above.is_empty() {
            let only: Vec<&str> = above.iter().map(String::as_str).collect();
            assert_eq!(lab.run_only(&graph_text(nodes), &only).exit_code(), 0);
        }
        let key = lab.engine().write_action(&graph, node, &lab.path("action")).unwrap();
        Self { lab, graph, node, key }
    }

    fn folder(&self) -> PathBuf {
        self.lab.path("action")
    }

    fn run(&self) -> Result<ActionDone, ActionError> {
        compute(&self.lab, &self.folder(), &self.lab.path("outputs"))
    }

    fn take(&self) -> Result<ActionDone, ActionError> {
        self.lab.engine().take_outputs(&self.lab.registry, &self.folder(), &self.lab.path("outputs"))
    }

    /// Runs the action, takes its outputs, and checks that a run finds the result.
    fn there_and_back(&self) {
        assert_eq!(self.run().unwrap_or_else(|error| panic!("{error}")).key, self.key);
        self.take().unwrap_or_else(|error| panic!("{error}"));
        let id = self.graph.nodes[self.node].id.as_str();
        let log = self.lab.run_only(&self.graph.source.text, &[id]);
        assert!(log.cached().split(' ').any(|cached| cached == id), "{}", log.ran());
    }
}

#[test]
fn a_node_computed_elsewhere_is_found_by_the_next_run() {
    for nodes in [
        "a: Number(value: 2), b: Number(value: 3), c: Add(terms: [\"a\", \"b\", \"a\"])",
        "a: Number(value: 2), b: Scale(value: \"a\", by: 1.5)",
        "a: Number(value: 2), b: Series(value: \"a\", samples: 64)",
        "a: Seeded()",
        "a: UpAxis()",
        "a: Number(), b: WriteNumber(number: \"a\", path: \"out.txt\")",
        "a: Number(), b: WriteRecipe(number: \"a\", path: \"out.txt\")",
    ] {
        Bench::new(nodes, &[]).there_and_back();
    }
    for (nodes, files) in [
        ("a: LoadNumber(path: \"in/a.txt\")", &[("in/a.txt", "7")][..]),
        ("a: LoadNumber(path: \"in/../a.txt\")", &[("a.txt", "7"), ("in/b.txt", "8")]),
        ("a: LoadNumber(path: \"in/a.txt\"), b: Scale(value: \"a\", by: 2)", &[("in/a.txt", "7")]),
        (
            "a: LoadDigits(path: \"d\", more: [\"e.txt\"])",
            &[("d/1.txt", "1"), ("d/2.txt", "2"), ("e.txt", "3")],
        ),
    ] {
        Bench::new(nodes, files).there_and_back();
    }
}

#[test]
fn a_file_outside_the_folder_of_the_graph_is_part_of_the_action() {
    let outside = tempfile::tempdir().unwrap();
    let path = outside.path().join("a.txt");
    std::fs::write(&path, "12").unwrap();
    let bench = Bench::new(&format!("a: LoadNumber(path: {path:?})"), &[]);
    // The worker must not need the original.
    std::fs::remove_file(&path).unwrap();
    assert_eq!(bench.run().unwrap().key, bench.key);
    assert!(!bench.lab.path("action/files").join("a.txt").exists(), "it is below `%root`");
}

#[test]
fn notes_events_and_failures_come_from_the_worker() {
    let bench = Bench::new("a: Number(), b: Remark(value: \"a\", degraded: true)", &[]);
    let done = bench.run().unwrap();
    assert!(done.notes.iter().any(|note| note.level == Level::Degraded));
    bench.take().unwrap();
    let log = bench.lab.run_only(&bench.graph.source.text, &["b"]);
    assert_eq!((log.exit_code(), log.cached().as_str()), (3, "a b"));

    let bench = Bench::new("a: Number(value: 20), b: Refuse(value: \"a\")", &[]);
    let error = bench.run().unwrap_err();
    assert!(error.is_of_node() && error.to_string().contains("20 is more than 10"), "{error}");
    assert!(!bench.lab.path("outputs").exists(), "a failure leaves no outputs");

    let bench = Bench::new("a: Number(), b: Heavy(value: \"a\", megabytes: 4096)", &[]);
    let error = bench.run().unwrap_err();
    assert!(matches!(error, ActionError::Memory { .. }) && error.is_of_node(), "{error}");

    let bench = Bench::new("a: Number(value: 1), b: Panic(value: \"a\")", &[]);
    assert!(bench.run().unwrap_err().to_string().contains("panicked"));

    let bench = Bench::new("a: Number(), b: Series(value: \"a\", samples: 64)", &[]);
    let mut events = Vec::new();
    let cancel = Arc::new(AtomicBool::new(false));
    let out = bench.lab.path("outputs");
    worker()
        .run_action(&bench.lab.registry, &bench.folder(), &out, &cancel, |event| events.push(event))
        .unwrap();
    assert!(events.iter().any(|event| matches!(event, Event::Part { .. })), "{events:?}");

    let bench = Bench::new("a: Number(), b: Slow(value: \"a\", millis: 60000)", &[]);
    let cancel = Arc::new(AtomicBool::new(true));
    let again = bench.lab.path("again");
    let stopped = worker().run_action(&bench.lab.registry, &bench.folder(), &again, &cancel, |_| {});
    assert!(stopped.is_err_and(|error| error.is_cancelled()) && !again.exists());
}

/// The worker believes nothing in the folder that its key does not prove.
#[test]
fn an_action_that_was_changed_is_refused() {
    let files = [("a.txt", "7")];
    let nodes =
        "n: Number(value: 4), s: Seeded(), a: LoadNumber(path: \"a.txt\"), b: Add(terms: [\"a\", \"n\"])";
    let changed = |change: &dyn Fn(&str) -> String| {
        let bench = Bench::new(nodes, &files);
        let path = bench.folder().join("action.ron");
        let text = std::fs::read_to_string(&path).unwrap();
        let with = change(&text);
        assert_ne!(with, text);
        std::fs::write(path, with).unwrap();
        let error = bench.run().expect_err("it was changed");
        assert!(!bench.lab.path("outputs").exists());
        error
    };
    let is_key = |error: &ActionError| matches!(error, ActionError::Key { .. });
    let error = changed(&|text| text.replacen("key: \"", "key: \"0", 1).replacen("\",", "", 1));
    assert!(matches!(error, ActionError::Format { .. }), "{error}");
    let error = changed(&|text| {
        let at = text.find("key: \"").unwrap() + 6;
        let digit = if &text[at..=at] == "0" { "1" } else { "0" };
        format!("{}{digit}{}", &text[..at], &text[at + 1..])
    });
    assert!(is_key(&error), "{error}");
    let error = changed(&|text| text.replace("format: 1,\n    key", "format: 99,\n    key"));
    assert!(error.to_string().contains("the action has format 99"), "{error}");
    let error = changed(&|text| text.replace("version: 1", "version: 2"));
    assert!(error.to_string().contains("needs version 2 of `add`"), "{error}");
    let error = changed(&|text| text.replace("kind: \"add\"", "kind: \"multiply\""));
    assert!(error.to_string().contains("no kind `multiply`"), "{error}");
    let error = changed(&|text| text.replace("\"number\"", "\"numbers\""));
    assert!(error.to_string().contains("not `number` in format 1"), "{error}");
    let error = changed(&|text| text.replace("(\"terms\"", "(\"sums\""));
    assert!(error.to_string().contains("the names of the inputs are not those of `add`"), "{error}");
    let error = changed(&|text| text.replace("parameters: [", "parameters: [(\"by\", \"2\"),"));
    assert!(error.to_string().contains("no parameter `by`"), "{error}");

    // Values and files with other content.
    let bench = Bench::new(nodes, &files);
    for entry in std::fs::read_dir(bench.folder().join("blobs")).unwrap() {
        let path = entry.unwrap().path();
        let good = std::fs::read(&path).unwrap();
        for bad in
            [&good[1..], &[good.as_slice(), &[0]].concat(), &good.iter().map(|b| b ^ 1).collect::<Vec<_>>()]
        {
            std::fs::write(&path, bad).unwrap();
            assert!(matches!(bench.run().unwrap_err(), ActionError::Content { .. }));
        }
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(bench.run().unwrap_err(), ActionError::Io { .. }));
        std::fs::write(&path, good).unwrap();
    }
    assert!(bench.run().is_ok());
    let bench = Bench::new("a: LoadNumber(path: \"a.txt\")", &files);
    std::fs::write(bench.folder().join("files/a.txt"), "8").unwrap();
    assert!(matches!(bench.run().unwrap_err(), ActionError::Content { .. }));
}

/// Changes to the outputs, each with a part of the message that refuses them.
#[test]
fn outputs_that_were_changed_are_refused() {
    type Change = fn(&Path);
    let flip = |path: &Path, at: usize| {
        let mut bytes = std::fs::read(path).unwrap();
        let at = at % bytes.len();
        bytes[at] ^= 1;
        std::fs::write(path, bytes).unwrap();
    };
    let bench = || {
        let bench = Bench::new("a: Number(), b: Split(value: \"a\")", &[]);
        bench.run().unwrap();
        bench
    };
    let refused = |bench: &Bench, what: &str| {
        let error = bench.take().expect_err(what);
        assert_eq!(bench.lab.engine().store().get_record(&bench.key), None, "nothing was taken: {what}");
        error.to_string()
    };
    let changes: [(&str, Change); 7] = [
        ("which is not a file of the outputs", |out| std::fs::write(out.join("more"), "").unwrap()),
        ("is not an output of", |out| std::fs::write(out.join("values/more"), "").unwrap()),
        ("`entry` is not a file", |out| std::fs::remove_file(out.join("entry")).unwrap()),
        ("`values` is not a folder", |out| {
            std::fs::rename(out.join("values"), out.parent().unwrap().join("v")).unwrap();
        }),
        ("bytes instead of", |out| {
            let path = first(out);
            let bytes = std::fs::read(&path).unwrap();
            std::fs::write(path, [bytes.as_slice(), b"more"].concat()).unwrap();
        }),
        ("is not a file", |out| {
            let path = first(out);
            std::fs::remove_file(&path).unwrap();
            std::fs::create_dir(path).unwrap();
        }),
        #[cfg(unix)]
        ("is not a file", |out| {
            // A link to a file with the right content.
            let path = first(out);
            let aside = out.parent().unwrap().join("aside");
            std::fs::rename(&path, &aside).unwrap();
            std::os::unix::fs::symlink(aside, path).unwrap();
        }),
    ];
    for (message, change) in changes {
        let bench = bench();
        change(&bench.lab.path("outputs"));
        let error = refused(&bench, message);
        assert!(error.contains(message), "{error}");
    }
    // Any changed byte of a value.
    let whole = bench();
    let length = std::fs::read(first(&whole.lab.path("outputs"))).unwrap().len();
    for at in 0..length {
        let bench = bench();
        flip(&first(&bench.lab.path("outputs")), at);
        assert!(refused(&bench, "a value").contains("does not match the digest"));
    }
    // An entry that was cut, or belongs to another action.
    let bytes = std::fs::read(whole.lab.path("outputs/entry")).unwrap();
    for length in [0, 1, 20, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(whole.lab.path("outputs/entry"), &bytes[..length]).unwrap();
        refused(&whole, "a cut entry");
    }
    let other = Bench::new("a: Number(value: 5), b: Split(value: \"a\")", &[]);
    other.run().unwrap();
    std::fs::copy(other.lab.path("outputs/entry"), whole.lab.path("outputs/entry")).unwrap();
    assert!(refused(&whole, "another entry").contains("another key"));
}

/// The first value in a folder of outputs.
fn first(out: &Path) -> PathBuf {
    let mut values: Vec<_> =
        std::fs::read_dir(out.join("values")).unwrap().map(|entry| entry.unwrap().path()).collect();
    values.sort();
    values.remove(0)
}

#[test]
fn a_node_that_cannot_become_an_action_says_why() {
    let lab = Lab::on_disk();
    let graph =
        lab.parse(&graph_text("n: Number(), a: Slow(value: \"n\"), b: Scale(value: \"a\", by: 2)")).unwrap();
    let error = lab.engine().write_action(&graph, 2, &lab.path("action")).unwrap_err();
    assert!(error.to_string().contains("the result of `a`, which the node reads, is not known"), "{error}");
    assert!(!lab.path("action").exists());
    lab.write("gone.txt", "1");
    let graph = lab.parse(&graph_text("a: LoadNumber(path: \"gone.txt\")")).unwrap();
    std::fs::remove_file(lab.path("gone.txt")).unwrap();
    let error = lab.engine().write_action(&graph, 0, &lab.path("action")).unwrap_err();
    assert!(error.to_string().contains("gone.txt"), "{error}");
    lab.write("a.txt", "1");
    let graph = lab.parse(&graph_text("a: LoadNumber(path: \"a.txt\")")).unwrap();
    lab.engine().write_action(&graph, 0, &lab.path("action")).unwrap();
    let error = lab.engine().write_action(&graph, 0, &lab.path("action")).unwrap_err();
    assert!(matches!(error, ActionError::Io { .. }), "an action folder is never overwritten: {error}");
}
