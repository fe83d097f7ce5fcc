use std::collections::BTreeSet;
use std::path::Path;

#[path = "../../../tests/support/arrows.rs"]
mod arrows;

/// The rooms of the engine from the lowest to the highest: a file imports only its own room and those below.
const ROOMS: [&str; 9] = ["value", "text", "kind", "graph", "record", "run", "plan", "watch", "share"];

fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn imports_lead_down_and_in_no_circle() {
    let imports = arrows::imports(&folder().join("src"));
    assert!(
        imports.len() > 80 && imports["graph/check"].contains("text::diag::Code"),
        "the imports were read"
    );
    assert_eq!(arrows::upward(&imports, &ROOMS), [""; 0]);
    assert_eq!(arrows::circles(&imports), [[""; 0]; 0]);
}

#[test]
fn the_rooms_are_the_folders_and_the_table_in_docs_architecture() {
    let entries = std::fs::read_dir(folder().join("src")).unwrap();
    let names =
        entries.map(|entry| entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned());
    let folders: BTreeSet<String> = names.filter(|name| name != "lib").collect();
    assert_eq!(folders, ROOMS.map(String::from).into());
    let page = std::fs::read_to_string(folder().join("../docs/architecture.md")).unwrap();
    let (_, section) = page.split_once("Within `engine`").unwrap();
    let lines =
        section.lines().skip_while(|line| !line.starts_with("| `")).take_while(|line| line.starts_with('|'));
    let mut rooms: Vec<&str> = lines.map(|line| line[3..].split('`').next().unwrap()).collect();
    rooms.reverse();
    assert_eq!(rooms, ROOMS, "the table has the highest room first");
}
