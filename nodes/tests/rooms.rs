//! Tests that modules of the crate import only lower modules, and that no kind imports another kind.

use std::path::Path;

#[path = "../../tests/support/arrows.rs"]
#[allow(clippy::unwrap_used, reason = "a test")]
mod arrows;

/// Modules from the lowest to the highest. A file imports only from its own module and from lower modules.
const ROOMS: [&str; 10] =
    ["error", "program", "math", "types", "io", "light", "geometry", "render", "train", "kinds"];

fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Imports of every file, except the imports of unit tests.
fn imports() -> arrows::Imports {
    let mut imports = arrows::imports(&folder().join("src"));
    imports.retain(|file, _| file != "testing");
    imports
}

/// Imports refer only to lower modules. This test fails if `use crate::kinds::pose::PoseNode;` is added to
/// `types/pose.rs`.
#[test]
fn imports_lead_down_and_in_no_circle() {
    let imports = imports();
    assert!(
        imports.len() > 150 && imports["kinds/place"].contains("types::frame::world_from_gltf"),
        "the imports were read"
    );
    assert_eq!(arrows::upward(&imports, &ROOMS), [""; 0]);
    assert_eq!(arrows::circles(&imports), [[""; 0]; 0]);
}

/// Modules of light transport from the lowest to the highest.
const TRANSPORT: [&str; 6] = ["bsdf", "sky", "scene", "ground", "path", "picture"];

/// Imports within light transport refer only to lower modules. This test fails if `use
/// crate::render::transport::path::rays::Rays;` is added to `scene/receiver.rs`.
#[test]
fn imports_of_light_transport_lead_down() {
    let mut inner = arrows::Imports::new();
    for (file, paths) in imports() {
        if let Some(file) = file.strip_prefix("render/transport/") {
            let paths = paths.iter().filter_map(|path| path.strip_prefix("render::transport::"));
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
    for (file, paths) in imports().iter().filter(|(file, _)| file.starts_with("kinds/")) {
        let other = |path: &&String| path.starts_with("kinds::") && kind(path) != kind(file);
        wrong.extend(paths.iter().filter(other).map(|path| format!("{file} -> {path}")));
    }
    assert_eq!(wrong, [""; 0]);
}

#[test]
fn the_rooms_are_the_folders_and_the_table_in_docs_architecture() {
    let (folders, table) = arrows::rooms(folder(), &["lib", "testing"], "Within `nodes`");
    assert_eq!(folders, ROOMS.map(String::from).into());
    assert_eq!(table, ROOMS, "the table has the highest room first");
}
