//! Tests of whole insertions into the bench case of `../shared/data`, with the graphs in `tests/bench_case`. The
//! shadow region is compared with the renders of an independent program.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    missing_docs,
    reason = "a test may stop at the first surprise"
)]

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// PSNR in the shadow region of each view. `picture` is the name of one of the compared pictures.
fn shadow_psnr(graph: &str, picture: &str, folder: &Path) -> Vec<f64> {
    let report = std::fs::read_to_string(folder.join(format!("{graph}.json"))).unwrap();
    let report: Value = serde_json::from_str(&report).unwrap();
    let table = &report["tables"][0];
    let column = |name: &str| {
        let columns = table["columns"].as_array().unwrap();
        columns.iter().position(|c| c.as_str().unwrap().starts_with(name)).unwrap()
    };
    let (what, region, psnr) = (column("picture"), column("region"), column("psnr"));
    let rows = table["rows"].as_array().unwrap().iter();
    rows.filter(|row| row[what] == picture && row[region] == "shadow")
        .map(|row| row[psnr].as_f64().unwrap())
        .collect()
}

fn run(graph: &str, folder: &Path) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    assert!(root.join("../shared/data/bench-case").exists(), "../shared/data/bench-case is missing");
    let status = Command::new(env!("CARGO_BIN_EXE_lightharmony"))
        .arg("run")
        .arg(root.join(format!("tests/bench_case/{graph}.ron")))
        .args([
            "--set",
            "trace.samples=16",
            "--set",
            &format!("table.path={graph}.json"),
            "--only",
            "table",
            "--out",
        ])
        .arg(folder)
        .env("LIGHTHARMONY_CACHE", folder.join("cache"))
        .status()
        .unwrap();
    assert!(status.success());
}

// 16 samples lose about 1 dB to noise compared with the 64 of `docs/evidence/bench.md`.
#[test]
fn with_true_light_the_shadow_is_five_decibels_over_none() {
    let folder = tempfile::tempdir().unwrap();
    run("oracle", folder.path());
    let ours = shadow_psnr("oracle", "image", folder.path());
    let none = shadow_psnr("oracle", "no shadow", folder.path());
    println!("oracle: {ours:.1?} against {none:.1?}");
    assert_eq!(ours.len(), 3);
    assert!(ours.iter().zip(&none).all(|(ours, none)| ours >= &(none + 5.0)), "{ours:?} {none:?}");
}

// The splats limit the result (22.7 dB in the first view), so the margin is small there.
#[test]
fn end_to_end_every_view_beats_no_shadow() {
    let folder = tempfile::tempdir().unwrap();
    run("end_to_end", folder.path());
    let ours = shadow_psnr("end_to_end", "image", folder.path());
    let none = shadow_psnr("end_to_end", "no shadow", folder.path());
    println!("end to end: {ours:.1?} against {none:.1?}");
    assert_eq!(ours.len(), 3);
    assert!(ours.iter().zip(&none).all(|(ours, none)| ours >= &(none + 0.8)), "{ours:?} {none:?}");
}
