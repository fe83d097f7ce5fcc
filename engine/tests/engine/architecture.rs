use std::path::Path;

#[path = "../../../tests/support/arrows.rs"]
mod arrows;

/// The modules of the engine from the lowest to the highest. A file imports only from its own module and from lower
/// modules.
const ROOMS: [&str; 10] =
    ["value", "text", "kind", "graph", "record", "remote", "run", "plan", "watch", "share"];

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
    let cache = arrows::imports(&folder().join("../cache/src"));
    assert!(cache.len() > 20, "the imports were read");
    assert_eq!(arrows::circles(&cache), [[""; 0]; 0]);
}

#[test]
fn the_rooms_are_the_folders_and_the_table_in_docs_architecture() {
    let (folders, table) = arrows::rooms(folder(), &["lib"], "Within `engine`");
    assert_eq!(folders, ROOMS.map(String::from).into());
    assert_eq!(table, ROOMS, "the table has the highest room first");
}
