//! Tests that the modules of `nodes`, `render` and `scene` import only lower modules, and that no kind imports another.

use std::path::{Path, PathBuf};

#[path = "../../tests/support/arrows.rs"]
#[allow(clippy::unwrap_used, reason = "a test")]
mod arrows;

/// Crates from the highest to the lowest with their modules, these from the lowest to the highest. A file imports only
/// from its own module and from lower modules.
const CRATES: [(&str, &[&str]); 3] = [
    ("nodes", &["program", "kinds"]),
    (
        "render",
        &[
            "geometry",
            "light",
            "splat",
            "fusion",
            "transport",
            "pick",
            "layout",
            "look",
            "agreement",
            "train",
        ],
    ),
    ("scene", &["error", "math", "types", "io"]),
];

fn folder(of: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(of)
}

/// Imports of every file of a crate, except the imports of unit tests.
fn imports(of: &str) -> arrows::Imports {
    arrows::imports(&folder(of).join("src"))
}

/// Imports refer only to lower modules. This test fails if `use crate::io::ply;` is added to `types/pose.rs`.
#[test]
fn imports_lead_down_and_in_no_circle() {
    for (name, rooms) in CRATES {
        let imports = imports(name);
        assert!(imports.len() > 100, "the imports of {name} were read");
        assert_eq!(arrows::upward(&imports, rooms), [""; 0]);
        assert_eq!(arrows::circles(&imports), [[""; 0]; 0]);
    }
    assert!(
        imports("render")["transport/picture/crop"].contains("light::env_resolution::smoothest"),
        "the imports were read"
    );
}

/// Modules of light transport from the lowest to the highest.
const TRANSPORT: [&str; 6] = ["bsdf", "sky", "scene", "ground", "path", "picture"];

/// Imports within light transport refer only to lower modules. This test fails if `use
/// crate::transport::path::rays::Rays;` is added to `scene/receiver.rs`.
#[test]
fn imports_of_light_transport_lead_down() {
    let mut inner = arrows::Imports::new();
    for (file, paths) in imports("render") {
        if let Some(file) = file.strip_prefix("transport/") {
            let paths = paths.iter().filter_map(|path| path.strip_prefix("transport::"));
            inner.insert(file.to_owned(), paths.map(str::to_owned).collect());
        }
    }
    assert!(inner.len() > 60, "the imports were read");
    assert_eq!(arrows::upward(&inner, &TRANSPORT), [""; 0]);
}

/// Kinds do not import each other. This test fails if `use crate::kinds::pose::PoseNode;` is added to
/// `kinds/place.rs`.
#[test]
fn no_kind_imports_another() {
    let kind = |path: &str| path.split(['/', ':']).filter(|part| !part.is_empty()).nth(1).map(str::to_owned);
    let mut wrong = Vec::new();
    for (file, paths) in imports("nodes").iter().filter(|(file, _)| file.starts_with("kinds/")) {
        let other = |path: &&String| path.starts_with("kinds::") && kind(path) != kind(file);
        wrong.extend(paths.iter().filter(other).map(|path| format!("{file} -> {path}")));
    }
    assert_eq!(wrong, [""; 0]);
}

#[test]
fn the_rooms_are_the_folders_and_the_table_in_docs_architecture() {
    for (name, rooms) in CRATES {
        let (folders, table) = arrows::rooms(&folder(name), &["lib"], &format!("Within `{name}`"));
        assert_eq!(folders, rooms.iter().map(|room| (*room).to_owned()).collect());
        assert_eq!(table, rooms, "the table of {name} has the highest room first");
    }
}
