//! Tests of the texts that report mistakes in graph files.

use std::fmt::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};

use engine::{Context, Kind, KindEntry, NodeError, Notes};

use crate::arithmetic::{Nothing, registry_with};
use crate::lab::{Lab, graph_text};
use crate::shapes::spent;

engine::params! {
    /// A kind without outputs.
    pub struct Consume {
        /// A parameter that changes only the key.
        by: f64 = 1.0, other("2.0");
    }
}
engine::outputs! { /** No values. */ pub struct NoOutputs {} }
impl Kind for Consume {
    const NAME: &'static str = "consume";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = Nothing;
    type Out = NoOutputs;
    fn run(_params: &Self, _inputs: Nothing, _cx: &Context) -> Result<(NoOutputs, Notes), NodeError> {
        Ok((NoOutputs {}, Notes::none()))
    }
}

/// Compares a text with a file in the folder `mistakes`, or writes the file if `UPDATE_SNAPSHOTS` is set.
fn assert_snapshot(name: &str, expected: &str, found: &str) {
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/engine/mistakes");
        return std::fs::write(folder.join(name), found).unwrap();
    }
    assert_eq!(expected, found, "run with UPDATE_SNAPSHOTS=1 where this is meant");
}

#[test]
fn every_mistake_of_a_file_is_reported_at_once() {
    let lab = Lab::on_disk();
    let text = include_str!("mistakes/every.ron");
    // The folder of the lab differs each time.
    let found = lab.mistakes(text).replace(&*lab.path("").to_string_lossy(), "FOLDER/");
    assert_snapshot("every.txt", include_str!("mistakes/every.txt"), &(found + "\n"));
}

#[test]
fn mistakes_of_the_whole_file() {
    let lab = Lab::on_disk();
    let mut found = String::new();
    for text in [
        "",
        "nodes: ()",
        "Grahp(version: 1)",
        "Graph",
        "Graph()",
        "Graph(version: 2, scene: (up: \"+z\"), nodes: ())",
        "Graph(version: 1, scene: (), nodes: ())",
        "Graph(version: 1, scene: \"+z\", nodes: [])",
        "Graph(version: 1, scene: (up: \"+z\", up: \"+y\"), nodes: (), nodes: ())",
        "Graph(version: 1, scene: (up: \"+z\"), nodes: (a: Number(),)), b: Number())",
        "Graph(version: 1, scene: (up: \"+z\"), nodes: (a: Number(value: 1.0, b: Number()))",
        "Graph(version: 1, scene: (up: \"+z\"), nodes: (a: Add(terms: [\"b\"), b: Number()))",
        "Graph(version: 1, scene: (up: \"+z\"), nodes: (a: Number() /* why ))",
        "Graph(version: 1, scene: (up: \"+z\"), nodes: (a: Number() b: Number() c: Scale(value: \"a\") 7))",
    ] {
        let _ = writeln!(found, "{text}\n\n{}\n\n", lab.mistakes(text));
    }
    assert_snapshot("whole.txt", include_str!("mistakes/whole.txt"), &found);
}

const GOOD: &str = "// é ünï\nGraph(\r\n\tversion: 1, /* a /* nested */ one */ scene: (up: \"+z\", seed: 7), nodes: (\n  \
    a: Number(value: -1.5e0), b: Add(terms: [\"a\", \"a.number\"], bias: 2), // done\n  \
    größe: Round(value: \"b\", towards: Down), w: WriteNumber(number: [\"größe\"], each: true, path: \"w_{view}.txt\"),\n))";

#[test]
fn comments_tabs_and_letters_of_any_script_are_fine() {
    let lab = Lab::on_disk();
    assert_eq!(lab.run_text(GOOD).ran(), "a b größe w");
    assert_eq!(
        lab.run_text(&format!("\u{feff}#![enable(implicit_some)]\n{GOOD}\n/* end */ // end")).ran(),
        ""
    );
    let wrong = lab.mistakes(&GOOD.replace("Down", "Dwon"));
    assert!(wrong.contains("graph.ron:5:37") && wrong.contains("did you mean `Down`?"), "{wrong}");
}

#[test]
fn a_half_edited_file_gives_a_diagnostic_or_a_graph_and_never_a_panic() {
    let lab = Lab::on_disk();
    let check = |text: &str| {
        if let Err(diagnostics) = lab.parse(text) {
            assert!(!diagnostics.list.is_empty(), "{text}");
            for one in &diagnostics.list {
                assert!(!one.message.is_empty() && one.span.start <= one.span.end, "{text}: {one:?}");
            }
            assert!(diagnostics.render(false).contains("error: "), "{text}");
            // And one slip gives few messages.
            assert!(diagnostics.list.len() <= 7, "{text}\n{}", diagnostics.render(false));
        }
    };
    for (at, c) in GOOD.char_indices() {
        check(&GOOD[..at]);
        check(&GOOD[at..]);
        check(&format!("{}{}", &GOOD[..at], &GOOD[at + c.len_utf8()..]));
        for inserted in ["(", ")", "[", "\"", "'", ",", ":", "/*", "\\", "é", "\u{201c}", "\0", "r#", "b'"] {
            check(&format!("{}{inserted}{}", &GOOD[..at], &GOOD[at..]));
        }
    }
    let every = include_str!("mistakes/every.ron");
    for (at, _) in every.char_indices().step_by(7) {
        let _ = lab.parse(&every[..at]).map_err(|diagnostics| diagnostics.render(false).len());
    }
}

#[test]
fn one_slip_gives_one_mistake() {
    let lab = Lab::on_disk();
    for (from, to) in [
        ("a: Number(", "a Number("),
        ("a: Number(", "a: Number"),
        ("bias: 2)", "bias: 2"),
        ("bias: 2", "bias: "),
        ("bias: 2", "bias 2"),
        ("\"b\"", "b"),
        ("\"b\"", "'b'"),
        ("\"b\"", "\"b"),
        ("Down),", "Down)"),
        ("nodes: (", "nodes: "),
        ("\"a.number\"]", "\"a.number\""),
        ("[\"a\",", "[\"a\""),
    ] {
        assert!(GOOD.contains(from));
        let wrong = lab.mistakes(&GOOD.replacen(from, to, 1));
        let count = wrong.matches("error: ").count();
        // A missing parenthesis is reported more than once: at the next token, and at the end.
        assert!(count <= 3, "{from} -> {to}: {count}\n{wrong}");
    }
}

#[test]
fn a_hint_fits_the_value_and_the_kind() {
    let lab = Lab::on_disk();
    let hints = |nodes: &str| lab.mistakes(&graph_text(nodes));
    let separate = "if this is a separate node";
    assert!(hints("a: Number(value: 1.0, b: Number())").contains(separate));
    for value in ["Param(\"x\")", "Axis(\"x\")", "Track(\"x\", [(0, 1.0)])"] {
        let wrong = hints(&format!("a: Number(valeu: {value})"));
        assert!(wrong.contains("`lightharmony nodes number`") && !wrong.contains(separate), "{wrong}");
    }
    let mut lab = Lab::on_disk();
    lab.registry = registry_with(KindEntry::of::<Consume>());
    for wire in ["a", "a.number"] {
        let wrong = lab.mistakes(&graph_text(&format!("a: Consume(), b: Scale(value: \"{wire}\")")));
        assert!(wrong.contains("`a` has no output") && wrong.contains("`Consume` has no outputs"), "{wrong}");
    }
}

#[test]
fn hostile_files_are_refused_in_good_time() {
    let lab = Lab::on_disk();
    let start = Instant::now();
    let before = spent(start);
    let long = "x".repeat(1 << 20);
    let deep = 100_000;
    for nodes in [
        format!("{long}: Number(value: \"{long}\", {long}: 1), b: Scale(value: \"{long}y\"), c: {long}()"),
        format!("a: Number(value: {}1{})", "(".repeat(deep), ")".repeat(deep)),
        format!("a: WriteNumber(views: {}{}, path: \"a\", number: [])", "[".repeat(deep), "]".repeat(deep)),
        format!("a: Number(value: {}", "[(".repeat(deep)),
        format!("a: {}", "A(b: ".repeat(deep)),
        format!("a: Number(), /* {} */ b", "/*".repeat(deep)),
        format!("a: Number(), {}", "]".repeat(deep)),
        format!("a: Number(), {}", "\"".repeat(deep + 1)),
        format!("a: Number({})", "value: 1.0, ".repeat(20_000)),
        format!("a: Number({})", "valu: 1.0, ".repeat(20_000)),
        (0..20_000).map(|n| format!("n{n}: Scale(value: \"m{n}\"), ")).collect(),
        (0..20_000).map(|_| "a: Number(), ".to_owned()).collect(),
        (0..50_000).map(|n| format!("n{n}: Scale(value: \"n{}\"), ", (n + 1) % 50_000)).collect(),
    ] {
        let wrong = lab.mistakes(&graph_text(&nodes));
        assert!(wrong.len() < 1 << 20, "{} bytes of mistakes: {}", wrong.len(), &wrong[..2000]);
    }
    let took = spent(start) - before;
    assert!(took < Duration::from_secs(12), "{took:?}");
}
