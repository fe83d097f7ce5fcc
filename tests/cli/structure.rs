//! Tests of the modules of the program: which files import which.

use std::path::Path;

#[path = "../support/arrows.rs"]
#[allow(dead_code, reason = "the rooms of the program are in no table")]
mod arrows;

/// The modules from the lowest to the highest: a file imports only from its own module and from lower modules.
const ROOMS: [&str; 3] = ["terminal", "session", "commands"];

// The files in the folder of a command belong to that command alone.
#[test]
fn imports_lead_down_and_no_verb_imports_another() {
    let imports = arrows::imports(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    assert!(imports["commands/run"].contains("terminal::Report"), "the imports were read");
    assert_eq!(arrows::upward(&imports, &ROOMS), [""; 0]);
    assert_eq!(arrows::circles(&imports), [[""; 0]; 0]);
    let verb = |path: &str| path.replace("::", "/").split('/').nth(1).unwrap_or_default().to_owned();
    let verbs = imports.iter().filter(|(file, _)| file.starts_with("commands/"));
    let across: Vec<String> = verbs
        .flat_map(|(file, paths)| paths.iter().map(move |path| (file, path)))
        .filter(|(file, path)| path.starts_with("commands") && verb(file) != verb(path))
        .map(|(file, path)| format!("{file} -> {path}"))
        .collect();
    assert_eq!(across, [""; 0]);
}

#[test]
fn the_crates_use_each_other_one_way() {
    let folders = [
        ("trade/src", 20),
        ("benchmark/src", 15),
        ("extras/learned/src", 30),
        ("extras/remote/src", 10),
        ("extras/serve/src", 20),
        ("extras/video/src", 3),
        ("extras/oidn/src", 1),
    ];
    for (folder, least) in folders {
        let imports = arrows::imports(&Path::new(env!("CARGO_MANIFEST_DIR")).join(folder));
        assert!(imports.len() > least, "the imports of {folder} were read");
        assert_eq!(arrows::circles(&imports), [[""; 0]; 0]);
    }
}
