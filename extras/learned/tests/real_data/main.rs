//! Against the reference: every tensor that `diffusers` made of a small model with random weights. What needs such a
//! model is tested here too.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests")]

mod files;
mod full_size;
mod parity;
mod training;

use std::path::{Path, PathBuf};

/// The folder of the fixture.
fn fixture() -> PathBuf {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    root.join("../../../shared/data/flux-kontext-tiny")
}

/// Puts the small model's `config.json` into a folder: no header says how its short heads divide.
fn small_config(folder: &Path) {
    std::fs::copy(fixture().join("transformer/config.json"), folder.join("config.json")).unwrap();
}
