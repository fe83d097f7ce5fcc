//! How fast a scene is loaded: 1 million rows of INRIA PLY of degree 3 (62 floats, 248 MB), beside what reading
//! and hashing the same bytes costs. `cargo bench -p lightharmony-nodes --bench load_splats`.
#![allow(clippy::unwrap_used, reason = "a bench may stop at the first surprise")]
#![allow(clippy::print_stdout, reason = "its output is its purpose")]

use std::time::Instant;

use engine::{Context, InputFile, Kind, Scene, Up};
use nodes::load_splats::{self, Frame, LoadSplats};

const ROWS: usize = 1_000_000;
const FIELDS: usize = 62;

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

fn main() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    std::fs::write(&path, file()).unwrap();
    let cx = Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0 }, folder.path());
    let params = LoadSplats {
        path: InputFile("scene.ply".to_owned()),
        more: Vec::new(),
        strict: true,
        max_extent: 1e6,
        frame: Frame::ByFormat,
    };
    for round in 0..5 {
        let start = Instant::now();
        let bytes = std::fs::read(&path).unwrap();
        let read = start.elapsed();
        let start = Instant::now();
        let digest = blake3::hash(&bytes);
        let hashed = start.elapsed();
        drop(bytes);
        let start = Instant::now();
        let (out, _) = LoadSplats::run(&params, load_splats::In {}, &cx).unwrap();
        let loaded = start.elapsed();
        assert_eq!(out.splats.len(), ROWS);
        println!(
            "round {round}: read {read:.3?}, hash {hashed:.3?} ({}), load (read and parse) {loaded:.3?}",
            &digest.to_hex()[..8]
        );
    }
}
