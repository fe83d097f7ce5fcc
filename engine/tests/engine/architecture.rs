use std::collections::BTreeSet;
use std::path::Path;

// The table of files stands between its heading and the paragraph on what is remembered.
#[test]
fn each_file_of_the_engine_is_in_the_table_of_docs_architecture() {
    let crate_folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = std::fs::read_to_string(crate_folder.join("../docs/architecture.md")).unwrap();
    let (_, table) = page.split_once("Within `engine`").unwrap();
    let (table, _) = table.split_once("\n\nSix files").unwrap();
    let first_cells = table.lines().filter_map(|line| line.strip_prefix("| `")?.split('|').next());
    let cells: Vec<&str> =
        first_cells.flat_map(|cell| cell.trim_end_matches(['`', ' ']).split("`, `")).collect();
    let named: BTreeSet<String> = cells.iter().map(|name| (*name).to_owned()).collect();
    assert_eq!(named.len(), cells.len(), "a file stands in two rows");
    let files = std::fs::read_dir(crate_folder.join("src")).unwrap();
    let stem = |entry: std::io::Result<std::fs::DirEntry>| {
        let stem = entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned();
        (stem != "lib").then_some(stem)
    };
    let there: BTreeSet<String> = files.filter_map(stem).collect();
    assert_eq!(named, there);
}
