//! Tests against the reference: every tensor that `diffusers` computes for a small model with random weights.
//! Includes other tests that need such a model.

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

/// Puts the small model's `config.json` into a folder: no header describes how its short heads are divided.
fn small_config(folder: &Path) {
    std::fs::copy(fixture().join("transformer/config.json"), folder.join("config.json")).unwrap();
}
