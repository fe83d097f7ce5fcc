//! Tests on real captures, objects and reference renders, which are in `../shared/data` next to the checkout. A
//! missing file is a failure here, never a skip; `cargo test` without the feature `real-data` leaves the whole set
//! out, and `.ci/run` reports it.
#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
#![allow(clippy::print_stdout, reason = "figures are for those who run with --nocapture")]

mod files;
mod formats;
mod level;
mod light;
mod looks;
mod mesh;
mod metrics;
mod splat;
mod trace;
mod trials;

/// A file of the shared data.
fn data(path: &str) -> std::path::PathBuf {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(path);
    assert!(root.exists(), "{} is missing", root.display());
    root
}
