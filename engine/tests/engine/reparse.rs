//! Tests of edits: a graph updated by an edit equals the graph parsed from the new text.

use std::sync::Arc;

use engine::{Engine, Event, Graph, RunOptions, Store};

use crate::arithmetic::registry;
use crate::lab::{Lab, graph_text};

fn text() -> String {
    graph_text(
        "// What it begins with: ä.\n  in: LoadNumber(path: \"a.txt\"),\n  one: Number(value: 1.5), /* one */\n\
           s: Add(terms: [\"one\", \"in\"], bias: -0.5), // the sum\n  t: Scale(value: \"s\", by: 2.0),\n\
           no: Refuse(value: \"one\", above: 1.0),\n  w: WriteNumber(number: \"t\", path: \"t.txt\"),",
    )
}

/// Runs a graph with an empty cache. Returns the kind, key and notes of each node, and the failures with their
/// positions.
fn run(lab: &Lab, graph: &Graph) -> (Vec<String>, String) {
    let engine = Engine::new(Store::in_memory(), 1, 1 << 30);
    let options = RunOptions { out: lab.path("out"), ..RunOptions::default() };
    let mut reported = Vec::new();
    let outcome = engine.run(graph, &options, |event| {
        if let Event::Node { id, kind, key, notes, .. } = event {
            reported.push(format!("{id} {kind} {key:?} {notes:?}"));
        }
    });
    reported.sort();
    (reported, outcome.failures.map(|failures| failures.render(false)).unwrap_or_default())
}

fn shape(graph: &Graph) -> String {
    let nodes = graph.nodes.iter().enumerate();
    let node = |(at, node): (usize, &Arc<engine::Node>)| {
        let links = (graph.reads(at), graph.consumers(at));
        format!("{} {} {:?} {:?} {links:?}", node.id, node.kind.name, node.inputs, node.sink_path)
    };
    format!("{:?} {:?} {:?}", nodes.map(node).collect::<Vec<_>>(), graph.order(), graph.scene)
}

/// Replaces a part of a text. Panics unless the part occurs exactly once.
fn with(text: &str, old: &str, new: &str) -> String {
    assert_eq!(text.matches(old).count(), 1, "{old}");
    text.replace(old, new)
}

#[test]
fn parameters_and_comments_are_read_alone_and_all_else_is_not() {
    let lab = Lab::in_memory();
    lab.write("a.txt", "3");
    let text = text();
    let graph = Arc::new(lab.parse(&text).unwrap());
    let edited = |old: &str, new: &str| graph.reparse(with(&text, old, new), registry).is_some();
    for (old, new) in [
        ("1.5", "-20.25"),
        ("bias: -0.5", ""),
        ("bias: -0.5", "bias: /* none */ 0.0"),
        ("by: 2.0)", "by: 2.0,\n)"),
        ("/* one */", ""),
        ("// the sum", "// the sum, and \u{e9}"),
        ("// the sum", "\n//@@ set one.value=3\n"),
        ("// What", "/* a ( */ // What"),
        ("  t:", "\n\n  t:"),
        ("1.5", "1.50"),
    ] {
        assert!(edited(old, new), "{old} to {new}");
    }
    for (old, new) in [
        ("1.5", "many"),
        ("1.5", "1.5, wrong: 2"),
        ("1.5", "1.5, value: 2.0"),
        ("one: N", "two: N"),
        ("Number(value: 1.5)", "Ramp(value: 1.5)"),
        ("\"one\", \"in\"", "\"in\", \"one\""),
        ("by: 2.0)", "by: 2.0), more: Number(value: 1.0)"),
        ("by: 2.0)", "by: 2.0"),
        ("\"t.txt\"", "\"u.txt\""),
        ("\"t.txt\"", "\"../u.txt\""),
        ("a.txt", "gone.txt"),
        ("seed: 7", "seed: 8"),
        ("// the sum\n", "// the sum"),
        ("/* one */", "/* one"),
        ("nodes: (", "axes: (a: List([1])), nodes: ("),
        ("1.5", "Axis(\"a\")"),
        ("1.5", "Param(\"a\")"),
    ] {
        assert!(!edited(old, new), "{old} to {new}");
    }
    let several = Lab::in_memory();
    let axes =
        text.replace("nodes: (", "axes: (a: List([1.0, 2.0])), nodes: (").replace("1.5", "Axis(\"a\")");
    several.write("a.txt", "3");
    let graph = Arc::new(several.parse(&axes.replace("t.txt", "{a}.txt")).unwrap());
    assert!(graph.reparse(axes.replace("by: 2.0", "by: 3.0"), registry).is_none(), "one of several nodes");
}

/// After each of many random edits, the updated graph equals the graph parsed from the text.
#[test]
fn whatever_was_edited_it_is_the_graph_of_its_text() {
    const PIECES: [&str; 18] = [
        "",
        " ",
        "\n",
        "// x\n",
        "/* y */",
        "0",
        "1.5",
        "-",
        ".25",
        "e3",
        "\"",
        ")",
        "(",
        ",",
        "bias: 2.0, ",
        "b",
        "ä",
        "\\",
    ];
    let lab = Lab::in_memory();
    lab.write("a.txt", "3");
    let mut graph = Arc::new(lab.parse(&text()).unwrap());
    let mut state = 7_u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let (mut read_alone, mut parsed) = (0, 0);
    for round in 0..6000 {
        let old = graph.source.text.clone();
        let start = old.floor_char_boundary(random(old.len()));
        let end = old.ceil_char_boundary((start + [0, 0, 1, 1, 2, 4][random(6)]).min(old.len()));
        let new = format!("{}{}{}", &old[..start], PIECES[random(PIECES.len())], &old[end..]);
        let whole = lab.parse(&new);
        match graph.reparse(new.clone(), registry) {
            Some(edited) => {
                let whole = whole.unwrap_or_else(|e| panic!("round {round}: {e}\n{old}\n---\n{new}"));
                assert_eq!(shape(&edited), shape(&whole), "round {round}");
                assert_eq!(run(&lab, &edited), run(&lab, &whole), "round {round}\n{old}\n---\n{new}");
                read_alone += 1;
                // Reset from time to time, so that the text does not grow without end.
                graph = if round % 40 == 0 { Arc::new(lab.parse(&text()).unwrap()) } else { edited };
            }
            None => parsed += usize::from(whole.is_ok()),
        }
    }
    assert!(read_alone > 400 && parsed < read_alone, "{read_alone} read alone, {parsed} parsed");
}
