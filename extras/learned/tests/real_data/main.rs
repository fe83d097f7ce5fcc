//! Tests that compare this crate with a reference: the tensors that `diffusers` computes for a small model with
//! random weights. Other tests that need the small model are here too.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests")]

mod files;
mod full_size;
mod in_graph;
mod parity;
mod training;

use std::path::{Path, PathBuf};

/// The folder that contains the small model and the reference.
fn fixture() -> PathBuf {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    root.join("../../../shared/data/flux-kontext-tiny")
}

/// Copies the small model's `config.json` into a folder. It is needed because the weights file does not contain the
/// axes, and the heads of the small model have fewer channels than the heads of the published model.
fn small_config(folder: &Path) {
    std::fs::copy(fixture().join("transformer/config.json"), folder.join("config.json")).unwrap();
}
