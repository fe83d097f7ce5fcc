//! Tests of sharing graphs: packing, unpacking elsewhere, verification, confinement and locks.

use std::io::Cursor;
use std::path::Path;

use engine::{
    Bundle, Graph, Lock, NodeDifference, Packed, Recipe, Results, Source, SourceRoot, Verdict, VerifyOptions,
    bundle_around, verify,
};

use crate::lab::{Lab, graph_text};

const NODES: &str = r#"
    a: LoadNumber(path: "sub/a.txt"), // a remark
    far: LoadNumber(path: "../far.txt"),
    b: Scale(value: "a", by: 3.0),
    s: Slow(value: "b", millis: 1),
    sum: Add(terms: ["s", "far"]),
    w: WriteNumber(number: "sum", path: "deep/w.txt"),
    r: WriteRecipe(number: ["sum"], path: "r.txt"),
"#;

/// A lab, and a graph that reads one file in a subfolder of its own folder and one file in the parent folder.
fn lab(outer: &Path) -> (Lab, Graph) {
    let lab = Lab::on_disk();
    let folder = outer.join("project");
    std::fs::create_dir_all(folder.join("sub")).unwrap();
    std::fs::write(folder.join("sub/a.txt"), "4").unwrap();
    std::fs::write(outer.join("far.txt"), "5").unwrap();
    let graph = parse(&lab, &graph_text(NODES), SourceRoot::new(folder)).unwrap();
    (lab, graph)
}

fn parse(lab: &Lab, text: &str, root: SourceRoot) -> Result<Graph, engine::Diagnostics> {
    Graph::parse(Source::packed("graph.ron", text), &lab.registry, root)
}

fn run(lab: &Lab, graph: &Graph, out: &str) -> engine::Outcome {
    let options = engine::RunOptions { out: lab.path(out), ..Default::default() };
    lab.engine().run(graph, &options, |_| {})
}

fn pack(lab: &Lab, graph: &Graph, results: Results) -> (Vec<u8>, Packed) {
    let mut bytes = Vec::new();
    let packed = lab.engine().pack(graph, &[], results, &mut bytes).unwrap();
    (bytes, packed)
}

fn checked(lab: &Lab, bytes: &[u8], sample: usize, seed: u64) -> engine::Verified {
    let mut bundle = Bundle::open(Cursor::new(bytes)).unwrap();
    let folder = lab.path("");
    let options =
        VerifyOptions { sample, seed, jobs: 2, memory: 1 << 30, folder: &folder, cancel: Default::default() };
    verify(&mut bundle, &lab.registry, &options, |_| {}).unwrap()
}

#[test]
fn a_bundle_gives_the_same_bytes_elsewhere() {
    let outer = tempfile::tempdir().unwrap();
    let (lab, graph) = lab(outer.path());
    assert_eq!(run(&lab, &graph, "out").totals.failed, 0);
    let (bytes, packed) = pack(&lab, &graph, Results::All);
    assert_eq!((packed.inputs, packed.known, packed.unknown.len(), packed.gone.len()), (2, 7, 0, 0));
    let text = String::from_utf8_lossy(&bytes).into_owned();
    assert!(!text.contains(&*outer.path().to_string_lossy()), "no folder of the packer gets into it");

    // The same from another folder and another cache.
    let second = tempfile::tempdir().unwrap();
    let (other, graph) = self::lab(second.path());
    run(&other, &graph, "out");
    assert!(bytes == pack(&other, &graph, Results::All).0, "the same bundle");

    let target = outer.path().join("unpacked");
    Bundle::open(Cursor::new(&bytes)).unwrap().unpack(&target).unwrap();
    let bundle = target.canonicalize().ok();
    assert!(bundle.is_some() && bundle_around(&target) == bundle && bundle_around(outer.path()).is_none());
    let below = target.join("below");
    std::fs::create_dir(&below).unwrap();
    assert_eq!(bundle_around(&below), bundle, "in all folders of it");
    std::fs::remove_dir(&below).unwrap();
    assert_eq!(std::fs::read_to_string(target.join("inputs/0/far.txt")).unwrap(), "5");
    let text = std::fs::read_to_string(target.join("graph.ron")).unwrap();
    assert!(text.contains("// a remark") && text.contains("path: \"inputs/0/far.txt\""), "{text}");
    let third = Lab::on_disk();
    let graph = parse(&third, &text, SourceRoot::confined(&target, &[]).unwrap()).unwrap();
    run(&third, &graph, "out");
    for file in ["deep/w.txt", "r.txt"] {
        assert_eq!(lab.out(file), third.out(file), "{file}");
    }
    let again = Bundle::open(Cursor::new(&bytes)).unwrap().unpack(&target).unwrap_err().to_string();
    assert!(again.contains("exists already"), "{again}");
}

#[test]
fn verifying_computes_again_and_reports_what_is_not_so() {
    let outer = tempfile::tempdir().unwrap();
    let (lab, graph) = lab(outer.path());
    run(&lab, &graph, "out");
    for results in [Results::Digests, Results::Targets, Results::All] {
        let (bytes, _) = pack(&lab, &graph, results);
        for (sample, seed) in [(0, 0), (2, 1), (2, 2), (100, 0)] {
            let verified = checked(&lab, &bytes, sample, seed);
            assert!(verified.is_good(), "{verified:?}");
            assert_eq!((verified.nodes.len(), verified.known), (sample.min(7), 7));
        }
        let names = |seed| checked(&lab, &bytes, 2, seed).nodes.into_iter().map(|n| n.0).collect::<Vec<_>>();
        assert_eq!(names(1), names(1), "the seed chooses");
        assert!((2..20).any(|seed| names(seed) != names(1)));
    }

    // A packer whose `scale` gave another result.
    let cheat = Lab { registry: crate::arithmetic::registry_of_a_cheat(), ..Lab::on_disk() };
    let folder = outer.path().join("project");
    let graph = parse(&cheat, &graph_text(NODES), SourceRoot::new(folder)).unwrap();
    run(&cheat, &graph, "out");
    let (bytes, _) = pack(&cheat, &graph, Results::All);
    let verified = checked(&lab, &bytes, 100, 0);
    assert!(!verified.is_good());
    let of =
        |id: &str| verified.nodes.iter().find(|(name, _)| name == id).map(|(_, verdict)| verdict).unwrap();
    assert!(
        matches!(of("b"), Verdict::Differs { output, difference: Some(d) } if output == "number" && !d.equal),
        "{verified:?}"
    );
    assert_eq!((of("a"), of("s")), (&Verdict::Equal, &Verdict::OtherInputs));
}

#[test]
fn what_never_ran_is_packed_without_results() {
    let outer = tempfile::tempdir().unwrap();
    let (lab, graph) = lab(outer.path());
    let (bytes, packed) = pack(&lab, &graph, Results::All);
    assert_eq!((packed.inputs, packed.known, packed.unknown.len()), (2, 0, 7));
    assert_eq!(checked(&lab, &bytes, 3, 0).known, 0);
}

#[cfg(unix)]
#[test]
fn a_untrusted_graph_reads_and_writes_where_it_may() {
    let lab = Lab::on_disk();
    std::fs::create_dir_all(lab.path("in/deep")).unwrap();
    std::fs::create_dir_all(lab.path("elsewhere")).unwrap();
    lab.write("secret.txt", "42");
    lab.write("in/a.txt", "1");
    std::os::unix::fs::symlink(lab.path("secret.txt"), lab.path("in/link.txt")).unwrap();
    let root = || SourceRoot::confined(&lab.path("in"), &[]).unwrap();
    let secret = lab.path("secret.txt").to_string_lossy().into_owned();
    for path in ["../secret.txt", "link.txt", "deep/../../secret.txt", &secret] {
        let text = graph_text(&format!("a: LoadNumber(path: \"{path}\")"));
        let mistakes = parse(&lab, &text, root()).map(|_| ()).unwrap_err().render(false);
        assert!(mistakes.contains("may not be read"), "{path}: {mistakes}");
    }
    let text =
        graph_text("a: LoadNumber(path: \"a.txt\"), w: WriteNumber(number: \"a\", path: \"deep/w.txt\")");
    let graph = parse(&lab, &text, root()).unwrap();
    std::fs::create_dir_all(lab.path("out")).unwrap();
    std::os::unix::fs::symlink(lab.path("elsewhere"), lab.path("out/deep")).unwrap();
    let outcome = run(&lab, &graph, "out");
    assert!(outcome.failures.unwrap().render(false).contains("is a link"));
    assert_eq!(std::fs::read_dir(lab.path("elsewhere")).unwrap().count(), 0);
    assert_eq!(run(&lab, &graph, "other").totals.failed, 0);
    // The user's own graph may.
    let own = parse(&lab, &text, SourceRoot::new(lab.path("in"))).unwrap();
    assert_eq!(run(&lab, &own, "out").totals.failed, 0);
    assert_eq!(std::fs::read_dir(lab.path("elsewhere")).unwrap().count(), 1);
}

#[test]
fn a_lock_reports_what_differs() {
    let outer = tempfile::tempdir().unwrap();
    let (lab, graph) = lab(outer.path());
    let lock = |graph: &Graph| lab.engine().lock(graph, &[]).unwrap();
    let cold = lock(&graph);
    assert_eq!((cold.inputs.len(), cold.kinds.len(), cold.results.len()), (2, 6, 0));
    run(&lab, &graph, "out");
    let known = lock(&graph);
    assert_eq!(known.results.len(), 7);
    assert_eq!(known.differences(&known), Default::default());
    assert_eq!(Lock::parse(&Source::new("graph.lock", known.text())).unwrap(), known);
    assert!(Lock::parse(&Source::new("graph.lock", "Lock(format: 1)")).is_err());
    assert!(Lock::parse(&Source::new("l", known.text().replace("format: 1", "format: 9"))).is_err());

    std::fs::write(outer.path().join("far.txt"), "6").unwrap();
    let changed = known.differences(&lock(&graph));
    assert!(
        matches!(&changed.before[..], [line] if line.starts_with("`../far.txt` has the digest")),
        "{changed:?}"
    );
    let other = Lock { kinds: [("add".to_owned(), (2, "portable".to_owned()))].into(), ..known.clone() };
    let changed = known.differences(&other);
    assert_eq!(changed.before, ["`add` has version 2 (portable), but the lock has version 1 (portable)"]);
    let mut other = known.clone();
    other.results.get_mut("b").unwrap().insert("number".to_owned(), "0".repeat(64));
    assert!(
        known.differences(&other).results[0]
            .starts_with("the result of `b.number` has the digest 000000000000")
    );
}

#[test]
fn a_recipe_runs_again_where_its_files_are() {
    let outer = tempfile::tempdir().unwrap();
    let (lab, graph) = lab(outer.path());
    run(&lab, &graph, "out");
    let text = lab.out("r.txt");
    let recipe = Recipe::parse(&text).unwrap();
    assert!(Recipe::parse("Graph()").is_err() && Recipe::parse("").is_err());
    assert_eq!(recipe.other_kinds(&lab.registry), [""; 0]);
    assert!(!recipe.other_kinds(&engine::Registry::new(Vec::new())).is_empty());

    let other = Lab::on_disk();
    let settle = |folders: &[std::path::PathBuf]| {
        recipe.settle("recipe", "r.txt", &other.registry, folders, &engine::Store::in_memory())
    };
    let missing = settle(&[]).unwrap_err().to_string();
    assert_eq!(missing.lines().count(), 2, "all that are missing at once: {missing}");
    // Found below a folder of another layout, and not by a name alone.
    std::fs::create_dir_all(other.path("x/y")).unwrap();
    other.write("a.txt", "another");
    other.write("x/y/a.txt", "4");
    other.write("x/far.txt", "5");
    let folder = other.path("");
    let source = settle(std::slice::from_ref(&folder)).unwrap();
    let root = SourceRoot::confined(&other.path("x"), &[folder]).unwrap();
    let again = parse(&other, &source.text, root).unwrap();
    assert!(recipe.other_sources(&again, &engine::Store::in_memory()).unwrap().is_empty());
    run(&other, &again, "out");
    assert_eq!(other.out("r.txt"), text);
    other.write("x/far.txt", "6");
    assert_eq!(recipe.other_sources(&again, &engine::Store::in_memory()).unwrap().len(), 1);
    assert!(settle(&[other.path("")]).unwrap_err().to_string().contains("`far.txt` with the digest"));
}

#[test]
fn graphs_and_results_are_distinguished() {
    let outer = tempfile::tempdir().unwrap();
    let (lab, a) = lab(outer.path());
    run(&lab, &a, "out");
    let root = || SourceRoot::new(outer.path().join("project"));
    let edited =
        NODES.replace("by: 3.0", "by: 4.0").replace("s: Slow(", "t: Slow(").replace("\"s\"", "\"t\"");
    let b = parse(&lab, &graph_text(&edited), root()).unwrap();
    run(&lab, &b, "out");
    let reported = engine::graph_differences(&a, &b);
    let change = |path: &str, old: &str, new: &str| {
        let (old, new) = (Some(old.to_owned()), Some(new.to_owned()));
        NodeDifference::Changed(vec![engine::Change { path: path.to_owned(), old, new }])
    };
    let expected = [
        ("b", change("by", "3.0", "4.0")),
        ("s", NodeDifference::Gone),
        ("sum", change("terms", "s.number, far.number", "t.number, far.number")),
        ("t", NodeDifference::New),
    ];
    assert_eq!(reported, expected.map(|(id, difference)| (id.to_owned(), difference)));
    let engine = lab.engine();
    let came = engine::result_differences((&engine, &a), (&engine, &b), engine::Artifact::difference);
    assert_eq!(came.compared, 6);
    let short: Vec<_> = came.unequal.iter().map(|node| (node.id.as_str(), node.first)).collect();
    // The node between them has another name, so the next difference begins at the sum.
    assert_eq!(short, [("b", true), ("sum", true), ("r", false), ("w", false)]);
    assert!(came.unequal[0].outputs[0].1.as_ref().is_some_and(|difference| !difference.equal));
    assert!(engine::graph_differences(&a, &a).is_empty());
    assert_eq!(
        engine::result_differences((&engine, &a), (&engine, &a), engine::Artifact::difference).unequal,
        []
    );
}

#[test]
fn a_bundle_holds_what_a_graph_includes() {
    let outer = tempfile::tempdir().unwrap();
    let at = |name: &str| outer.path().join(name);
    for folder in ["project/parts", "shared"] {
        std::fs::create_dir_all(at(folder)).unwrap();
        std::fs::write(at(folder).join("n.txt"), folder).unwrap();
        let text = "Graph(version: 1, nodes: (x: LoadNumber(path: \"n.txt\")))";
        std::fs::write(at(folder).join("part.ron"), text).unwrap();
    }
    std::fs::write(at("project/parts/n.txt"), "4").unwrap();
    std::fs::write(at("shared/n.txt"), "5").unwrap();
    let lab = Lab::on_disk();
    let graph = |include: &str| {
        let text = format!(
            "Graph(version: 1, include: [\"{include}\"], scene: (up: \"+z\"), nodes: (\n\
            w: WriteNumber(number: \"x\", path: \"w.txt\"), y: Scale(value: \"x\")))"
        );
        let root = SourceRoot::new(at("project"));
        let (source, _) = Source::new("graph.ron", text).including(&root);
        let source = engine::apply(&source, &["y.by=7.5".parse().unwrap()]);
        Graph::parse(source, &lab.registry, root).unwrap()
    };
    let inside = graph("parts/part.ron");
    run(&lab, &inside, "out");
    let (bytes, packed) = pack(&lab, &inside, Results::All);
    assert_eq!((packed.inputs, packed.unknown.len()), (1, 0), "y is wanted by nobody");
    let verified = checked(&lab, &bytes, 9, 0);
    assert!(verified.is_good() && verified.known == 2, "{verified:?}");
    let text = String::from_utf8_lossy(&bytes).into_owned();
    assert!(text.contains("y.by=7.5") && text.contains("parts/n.txt"), "settings go along");

    let away = lab.engine().pack(&graph("../shared/part.ron"), &[], Results::All, &mut Vec::new());
    let error = away.unwrap_err().to_string();
    assert!(error.contains("`\"n.txt\"` in `../shared/part.ron`"), "{error}");
}

/// Makes a folder with files of digits and a graph that has a `LoadDigits` node with these fields, and runs the
/// graph. Also returns the recipe of the result.
fn digits(fields: &str) -> (Lab, Graph, tempfile::TempDir, Recipe) {
    let (lab, outer) = (Lab::on_disk(), tempfile::tempdir().unwrap());
    let files =
        [("a/p", 1), ("b/p", 2), ("c/p", 3), ("c/q", 4), ("d/p", 1), ("g/c/x", 5), ("p", 6), ("z", 7)];
    for (name, digit) in files {
        let path = outer.path().join(format!("in/{name}.txt"));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, digit.to_string()).unwrap();
    }
    let text = format!(
        "d: LoadDigits({fields}), w: WriteNumber(number: \"d\", path: \"w.txt\"), r: WriteRecipe(number: [\"d\"], path: \"r.txt\"),"
    );
    let graph = parse(&lab, &graph_text(&text), SourceRoot::new(outer.path().join("in/g"))).unwrap();
    assert_eq!(run(&lab, &graph, "out").totals.failed, 0);
    let recipe = Recipe::parse(&lab.out("r.txt")).unwrap();
    (lab, graph, outer, recipe)
}

#[test]
fn files_of_one_name_are_those_that_were_read_in_order() {
    for fields in [
        r#"path: "../a/p.txt", more: ["../b/p.txt"]"#,
        r#"path: "../b/p.txt", more: ["../a/p.txt", "../b/p.txt", "../p.txt", "../d/p.txt"]"#,
        r#"path: "../c", more: ["../a/p.txt", "../b", "../z.txt"]"#,
        r#"path: "../a/p.txt", more: ["../c", "../b"]"#,
        r#"path: "..""#,
        r#"path: "../", more: ["c"]"#,
        r#"path: "../c/.", more: ["../a"]"#,
    ] {
        let (lab, graph, outer, recipe) = digits(fields);
        let other = Lab::on_disk();
        let folder = outer.path().join("in");
        let settle = |folders: &[std::path::PathBuf]| {
            recipe.settle("recipe", "r.txt", &other.registry, folders, &engine::Store::in_memory())
        };
        let source =
            settle(std::slice::from_ref(&folder)).unwrap_or_else(|error| panic!("{fields}: {error}"));
        let root = SourceRoot::confined(&other.path(""), &[folder]).unwrap();
        let again = parse(&other, &source.text, root).unwrap();
        assert_eq!(recipe.other_sources(&again, &engine::Store::in_memory()).unwrap(), [""; 0], "{fields}");
        run(&other, &again, "out");
        assert_eq!(other.out("r.txt"), lab.out("r.txt"), "{fields}: {}", source.text);
        assert_eq!(recipe.differences(&recipe).unwrap(), [], "{fields}");
        // The same recipe and the same number out of a bundle.
        let (bytes, _) = pack(&lab, &graph, Results::All);
        let verified = checked(&lab, &bytes, 9, 0);
        assert!(verified.is_good() && verified.nodes.len() == 3, "{fields}: {verified:?}");
    }
    // The folder itself counts, by its name, and not only its content.
    let (lab, _, outer, recipe) = digits(r#"path: "../c""#);
    let settle = |folder: &str| {
        let folder = outer.path().join("in").join(folder);
        recipe.settle("recipe", "r.txt", &lab.registry, &[folder], &engine::Store::in_memory())
    };
    assert!(settle("c").is_ok() && settle("").is_ok());
    let errors = settle("b").unwrap_err().to_string();
    assert!(
        errors.contains("do not include a folder `c` with the files this picture was made from")
            && errors.contains("--inputs"),
        "{errors}"
    );
}

#[test]
fn files_that_cannot_be_distinguished_are_refused() {
    let (lab, graph, outer, recipe) = digits(r#"path: "../a/p.txt", more: ["../b/p.txt"]"#);
    let folders = [outer.path().join("in")];
    let settle = |recipe: &Recipe| {
        recipe.settle("recipe", "r.txt", &lab.registry, &folders, &engine::Store::in_memory())
    };
    // One of two files is not listed.
    let line = recipe.text().lines().last().unwrap();
    let short = Recipe::parse(&recipe.text().replace(&format!("{line}\n"), "")).unwrap();
    let errors = settle(&short).unwrap_err().to_string();
    assert!(errors.contains("does not identify the file `p.txt`"), "{errors}");
    // The right files in another order, one less, and one more, are other files.
    let others = |fields: &str| {
        let text = graph_text(&format!("n0: LoadDigits({fields})"));
        let graph = parse(&lab, &text, graph.root.clone()).unwrap();
        recipe.other_sources(&graph, &engine::Store::in_memory()).unwrap()
    };
    assert_eq!(others(r#"path: "../a/p.txt", more: ["../b/p.txt"]"#), [""; 0]);
    let swapped = others(r#"path: "../b/p.txt", more: ["../a/p.txt"]"#);
    assert!(swapped.len() == 2 && swapped[0].contains("at a different position"), "{swapped:?}");
    assert_eq!(others(r#"path: "../a/p.txt", more: ["../a/p.txt"]"#).len(), 1);
    assert!(others(r#"path: "../a/p.txt""#)[0].contains("no longer reads `p.txt`"));
    assert_eq!(others(r#"path: "../a/p.txt", more: ["../b/p.txt", "../z.txt"]"#).len(), 1);
}

#[test]
fn nodes_of_recipes_are_paired_from_the_sink_upward() {
    let lab = Lab::on_disk();
    let recipe = |nodes: &str| {
        let text = format!("{nodes} r: WriteRecipe(number: [\"end\"], path: \"r.txt\"),");
        let graph = lab.parse(&graph_text(&text)).unwrap();
        assert_eq!(run(&lab, &graph, "out").totals.failed, 0);
        Recipe::parse(&lab.out("r.txt")).unwrap()
    };
    let reported = |a: &Recipe, b: &Recipe| {
        let text = |(id, difference): &(String, NodeDifference)| match difference {
            NodeDifference::Gone => format!("- {id}"),
            NodeDifference::New => format!("+ {id}"),
            NodeDifference::Changed(changes) => {
                let paths: Vec<&str> = changes.iter().map(|change| change.path.as_str()).collect();
                format!("~ {id}.{}", paths.join(","))
            }
        };
        a.differences(b).unwrap().iter().map(text).collect::<Vec<_>>()
    };
    let ends = |inner: &str| format!("{inner} end: Add(terms: [\"x\", \"y\"]),");
    let plain = recipe(&ends("x: Number(value: 1.0), n: Number(value: 2.0), y: Round(value: \"n\"),"));
    assert_eq!(reported(&plain, &plain), [""; 0]);
    // One inserted before the first: all numbers differ.
    let more = recipe(&ends(
        "m: Number(value: 1.0), x: Scale(value: \"m\", by: 2.0), n: Number(value: 2.0), y: Round(value: \"n\"),",
    ));
    assert_eq!(reported(&plain, &more), ["~ n3.terms", "+ b.n1 scale"]);
    assert_eq!(reported(&more, &plain), ["- n1 scale", "~ n4.terms"]);
    // A node of another kind instead of two, and a value below it.
    let other = recipe(&ends("x: Number(value: 1.0), y: Number(value: 3.0),"));
    let differences = reported(&plain, &other);
    assert_eq!(differences.len(), 3, "{differences:?}");
    let value = recipe(&ends("x: Number(value: 1.0), n: Number(value: 2.5), y: Round(value: \"n\"),"));
    assert_eq!(reported(&plain, &value), ["~ n1.value"]);
}
