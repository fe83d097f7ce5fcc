//! Tests of every kind, every parameter and every output, by the crate `kind_tests`. They use the registry of kinds and
//! contain no list of names. A new kind is tested as soon as `table/fixture.ron` contains a node of this kind.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod files;

use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

use kind_tests::Table;

/// Table that all tests share, because the first run of the fixture is expensive. Only one test at a time uses it.
static SHARED: LazyLock<Mutex<Table>> = LazyLock::new(|| Mutex::new(table()));

fn shared() -> MutexGuard<'static, Table> {
    SHARED.lock().unwrap_or_else(PoisonError::into_inner)
}

fn table() -> Table {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("table");
    std::fs::create_dir_all(&folder).unwrap();
    let table = Table::new(nodes::registry(), include_str!("fixture.ron"), &folder);
    // Files that the loaders of the fixture read, written by the sinks of the crate.
    table.make_files(include_str!("files.ron")).unwrap_or_else(|e| panic!("{e}"));
    for (name, bytes) in handmade() {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    table
}

/// Files in formats that no sink writes.
fn handmade() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("mesh.ply", files::MESH_PLY.into()),
        ("cameras.json", files::CAMERAS_JSON.into()),
        ("dataparser_transforms.json", files::DATAPARSER_JSON.into()),
        ("b.json", files::CAMERAS_JSON.into()),
        ("lpips.safetensors", files::lpips_safetensors()),
        ("exposure.safetensors", files::exposure_safetensors()),
        ("splats.ply", files::splats_ply(12)),
        ("b.ply", files::splats_ply(3)),
        ("object.glb", files::object_glb()),
        ("points3D.txt", b"1 0.1 0.2 0.5 255 0 0 0.5\n2 0.3 -0.2 0.5 0 255 0 0.5\n".into()),
    ]
}

#[test]
fn every_kind_is_documented_and_its_parameters_are_complete() {
    assert_eq!(shared().undocumented(), [""; 0]);
}

#[test]
fn fixture_holds_every_kind_and_runs() {
    assert_eq!(shared().missing(), [""; 0], "see nodes/tests/table/fixture.ron");
}

#[test]
fn values_outside_their_range_are_refused() {
    assert_eq!(shared().accepted_beyond_ranges(), [""; 0]);
}

/// Every value of every knob is valid for its node, and each preset sets all knobs to their values for that preset.
#[test]
fn every_value_of_a_knob_is_one_that_its_node_takes() {
    assert_eq!(shared().wrong_knobs(), [""; 0]);
}

#[test]
fn every_parameter_changes_the_key_and_the_output() {
    assert_eq!(shared().parameters_without_effect(), [""; 0]);
}

#[test]
fn decoding_then_encoding_gives_the_same_bytes() {
    assert_eq!(shared().wrong_encodings(), [""; 0]);
}

/// Compares each node with `golden.txt`. If the outputs differ for an equal key, the VERSION of the kind should have
/// been increased.
#[test]
fn equal_keys_give_the_outputs_they_have_always_given() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/table/golden.txt");
    assert_eq!(shared().outputs_that_changed(&path), [""; 0]);
}

/// Every node of the fixture is computed from an action folder by an engine without a cache, as a worker on another
/// machine does it.
#[test]
fn every_kind_gives_the_same_bytes_from_an_action_folder() {
    assert_eq!(shared().differences_in_actions(), [""; 0]);
}
