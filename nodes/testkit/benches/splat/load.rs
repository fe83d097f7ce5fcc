//! Measures the speed of loading a scene of 1 million splats from an INRIA PLY file of degree 3 (62 floats per
//! splat, 248 MB), and compares it with the speed of reading and hashing the same bytes.

use std::sync::Arc;
use std::time::Instant;

use engine::Up;
use scene::types::Splats;
use testkit::{Data, process_seconds};

use crate::Bench;

const ROWS: usize = 1_000_000;
const FIELDS: usize = 62;
const RUNS: usize = 5;

fn file() -> Vec<u8> {
    let names = ["x", "y", "z", "nx", "ny", "nz"].map(str::to_owned).into_iter();
    let names = names
        .chain((0..3).map(|i| format!("f_dc_{i}")))
        .chain((0..45).map(|i| format!("f_rest_{i}")))
        .chain(["opacity".to_owned()])
        .chain((0..3).map(|i| format!("scale_{i}")))
        .chain((0..4).map(|i| format!("rot_{i}")));
    let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {ROWS}\n");
    names.for_each(|name| text.push_str(&format!("property float {name}\n")));
    text.push_str("end_header\n");
    let mut bytes = text.into_bytes();
    bytes.reserve(ROWS * FIELDS * 4);
    let mut state = 7_u32;
    for _ in 0..ROWS * FIELDS {
        // Numerical Recipes' generator; numbers from -5 to 5.
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let value = (state >> 8) as f32 / 16_777_216.0 * 10.0 - 5.0;
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes
}

/// Runs `work` several times, and returns the shortest CPU time and the shortest wall time, in seconds.
fn least(mut work: impl FnMut()) -> [f64; 2] {
    let mut best = [f64::INFINITY; 2];
    for _ in 0..RUNS {
        let (start, cpu) = (Instant::now(), process_seconds());
        work();
        best = [best[0].min(process_seconds() - cpu), best[1].min(start.elapsed().as_secs_f64())];
    }
    best
}

/// Writes the file to a temporary folder. Returns the folder, and a function that loads the file.
pub fn million() -> (tempfile::TempDir, impl Fn() -> Arc<Splats>) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.ply"), file()).unwrap();
    let data = Data::of(folder.path(), Up::PlusZ, 0);
    let load = move || {
        let splats = data.splats("scene.ply", &[], true);
        assert_eq!(splats.len(), ROWS);
        splats
    };
    (folder, load)
}

pub fn table(_: &Bench) {
    let (folder, load) = million();
    let path = folder.path().join("scene.ply");
    let bytes = std::fs::read(&path).unwrap();
    println!("{ROWS} rows of {FIELDS} floats, {} bytes\n", bytes.len());
    println!("| what | CPU s | wall s, minimum of {RUNS} runs |");
    println!("|---|---|---|");
    let line = |what: &str, [cpu, wall]: [f64; 2]| println!("| {what} | {cpu:.2} | {wall:.2} |");
    line("hash (BLAKE3)", least(|| _ = std::hint::black_box(blake3::hash(&bytes))));
    drop(bytes);
    line("read", least(|| drop(std::hint::black_box(std::fs::read(&path).unwrap()))));
    line("load: read, activate, join", least(|| drop(std::hint::black_box(load()))));
}
