//! Tests of `watch` as a front end uses it, with JSON lines, real files, and file notifications from the system.

use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStdout, Stdio};

use serde_json::Value;

use crate::Place;

const GRAPH: &str = r#"Graph(
    version: 1,
    scene: (up: "+z"),
    nodes: (
        photo: LoadImage(path: "photo.hdr"),
        save:  WriteImage(image: "photo", path: "photo.png"),
    ),
)
"#;

/// A picture of one pixel whose brightness is proportional to 2^`exponent`.
fn photo(exponent: u8) -> Vec<u8> {
    let head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n";
    [head.as_slice(), &[128, 64, 32, exponent]].concat()
}

struct Watch {
    child: Child,
    lines: std::io::Lines<BufReader<ChildStdout>>,
}

impl Watch {
    fn begin(place: &Place) -> Self {
        let mut command = place.command(&["watch", "graph.ron", "--json"]);
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        Self { child, lines }
    }

    /// Returns all output until the watch is idle.
    fn rest(&mut self) -> Vec<Value> {
        let mut events: Vec<Value> = Vec::new();
        while events.last().is_none_or(|event| event["event"] != "idle") {
            events.push(serde_json::from_str(&self.lines.next().unwrap().unwrap()).unwrap());
        }
        events
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

fn of<'a>(events: &'a [Value], kind: &str) -> Vec<&'a Value> {
    events.iter().filter(|event| event["event"] == kind).collect()
}

#[test]
fn a_front_end_follows_edits_mistakes_and_repairs() {
    let place = Place::new(GRAPH);
    std::fs::write(place.path("photo.hdr"), photo(127)).unwrap();
    let mut watch = Watch::begin(&place);
    let first = watch.rest();
    assert_eq!(of(&first, "plan")[0]["open"], 2);
    assert_eq!(of(&first, "file")[0]["path"], "out/photo.png");
    let before = place.outputs();

    // A new photo, saved like editors that write a temporary file and rename it.
    std::fs::write(place.path("photo.new"), photo(128)).unwrap();
    std::fs::rename(place.path("photo.new"), place.path("photo.hdr")).unwrap();
    assert_eq!(of(&watch.rest(), "done")[0]["ran"], 2);
    assert_ne!(place.outputs(), before);
    let last = place.outputs();

    place.write(&GRAPH.replace("\"photo\"", "\"phto\""));
    let wrong = watch.rest();
    let mistake = &of(&wrong, "mistakes")[0]["list"][0];
    assert_eq!((&mistake["line"], &mistake["column"]), (&6.into(), &34.into()), "{mistake}");
    assert_eq!(mistake["hints"][0], "did you mean `photo`?");
    assert_eq!(of(&wrong, "stale")[0]["path"], "out/photo.png");
    assert_eq!(place.outputs(), last, "the last good picture stays");

    place.write(GRAPH);
    let right = watch.rest();
    assert_eq!((of(&right, "plan").len(), of(&right, "mistakes").len()), (0, 0), "all of it is known");
    assert_eq!(of(&right, "file")[0]["written"], false);
}

#[test]
fn what_cannot_change_is_not_watched() {
    let place = Place::new(GRAPH);
    let output = place.call(&["watch", "-"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("only a file can be watched"));
}

#[test]
fn what_is_written_once_is_not_watched() {
    let place = Place::new(GRAPH);
    std::fs::write(place.path("photo.hdr"), photo(130)).unwrap();
    place.run(&[]).good();
    assert!(place.call(&["pack", "graph.ron", "a.lhb"]).status.success());
    for graph in ["a.lhb", "out/photo.png", "-"] {
        let output = place.call(&["watch", graph]);
        assert_eq!(output.status.code(), Some(2), "{graph}");
        assert_eq!(String::from_utf8(output.stderr).unwrap().lines().count(), 1, "{graph}");
    }
    let help = String::from_utf8(place.call(&["watch", "--help"]).stdout).unwrap();
    assert!(help.contains("The graph file (RON)") && !help.contains("reads standard input"), "{help}");
}
