//! The tables of `docs/splats.md`: what each knob of splat rendering costs in accuracy and saves in work,
//! how time and memory grow, and both ways to a panorama.
//! `cargo bench -p lightharmony-nodes --bench splat_tables -- DATA [exact|knobs|growth|panorama]`, where
//! DATA holds `splats/garden_sog`, `splats/playbot_sog` and `splat-refs`.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a bench prints, and may stop")]

mod exact;
mod growth;
mod knobs;
mod panorama;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use engine::{Context, InputFile, Kind, Scene, Up};
use glam::{DMat3, DVec3};
use nodes::load_splats::{self, LoadSplats};
use nodes::num;
use nodes::types::{Camera, Splats};

/// Where the data is, and a context to work in.
struct Bench {
    data: PathBuf,
    cx: Context,
}

impl Bench {
    fn load(&self, path: &str, more: &[&str]) -> Arc<Splats> {
        let file = |path: &str| InputFile(path.to_owned());
        let params = LoadSplats {
            path: file(path),
            more: more.iter().map(|path| file(path)).collect(),
            strict: false,
            max_extent: 1e6,
            frame: load_splats::Frame::ByFormat,
        };
        LoadSplats::run(&params, load_splats::In {}, &self.cx).unwrap().0.splats
    }

    fn garden(&self) -> Arc<Splats> {
        self.load("splats/garden_sog/2_0/meta.json", &["splats/garden_sog/2_1/meta.json"])
    }

    fn playbot(&self) -> Arc<Splats> {
        self.load("splats/playbot_sog/2_0/meta.json", &[])
    }

    /// The camera of a view of `splat-refs`.
    fn camera(&self, name: &str) -> Camera {
        let text = std::fs::read(self.data.join("splat-refs/refs.json")).unwrap();
        let all: serde_json::Value = serde_json::from_slice(&text).unwrap();
        let view = all.as_array().unwrap().iter().find(|view| view["name"] == name).unwrap();
        let camera = &view["camera"];
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let vector =
            |value: &serde_json::Value| DVec3::new(number(&value[0]), number(&value[1]), number(&value[2]));
        let rows = [0, 1, 2].map(|i| vector(&camera["R_w2c"][i]));
        let turn = DMat3::from_cols(rows[0], rows[1], rows[2]);
        let eye = -(turn * vector(&camera["t_w2c"]));
        Camera {
            name: name.to_owned(),
            width_px: camera["width"].as_u64().unwrap() as u32,
            height_px: camera["height"].as_u64().unwrap() as u32,
            fx: number(&camera["fx"]),
            fy: number(&camera["fy"]),
            cx: number(&camera["cx"]),
            cy: number(&camera["cy"]),
            world_from_camera: look(turn.x_axis, turn.y_axis, turn.z_axis, eye),
        }
    }

    /// Colours of a view of `splat-refs`.
    fn reference(&self, name: &str) -> Vec<f32> {
        let bytes = std::fs::read(self.data.join(format!("splat-refs/{name}.rgb.npy"))).unwrap();
        let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        bytes[header..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
    }
}

/// A camera's transform, of its axes and where it stands.
fn look(right: DVec3, down: DVec3, forward: DVec3, eye: DVec3) -> [f64; 16] {
    let columns = [right.extend(0.0), down.extend(0.0), forward.extend(0.0), eye.extend(1.0)];
    glam::DMat4::from_cols(columns[0], columns[1], columns[2], columns[3]).to_cols_array()
}

/// (PSNR in dB with peak 1, largest deviation) of the first three of `channels` and `others` samples a pixel.
fn compare(seen: &[f32], channels: usize, truth: &[f32], others: usize) -> (f64, f64) {
    let (mut squares, mut largest) = (0.0_f64, 0.0_f64);
    for (a, b) in seen.chunks_exact(channels).zip(truth.chunks_exact(others)) {
        for c in 0..3 {
            let off = (f64::from(a[c]) - f64::from(b[c])).abs();
            squares += off * off;
            largest = largest.max(off);
        }
    }
    (-10.0 * num::f64::log10(squares / (truth.len() / others * 3) as f64), largest)
}

/// CPU seconds of every thread of this process, so that others on the machine do not enter.
fn cpu_seconds() -> f64 {
    let mut sum = 0.0;
    for task in std::fs::read_dir("/proc/self/task").unwrap().flatten() {
        let told = std::fs::read_to_string(task.path().join("schedstat")).unwrap_or_default();
        sum += told.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0);
    }
    sum * 1e-9
}

/// A result, and the least CPU seconds of several runs of it.
fn timed<T>(runs: usize, mut work: impl FnMut() -> T) -> (T, f64) {
    let mut best: Option<(T, f64)> = None;
    for _ in 0..runs {
        let start = cpu_seconds();
        let result = work();
        let seconds = cpu_seconds() - start;
        if best.as_ref().is_none_or(|(_, least)| seconds < *least) {
            best = Some((result, seconds));
        }
    }
    best.unwrap()
}

fn main() {
    let mut args = std::env::args().skip(1).filter(|arg| !arg.starts_with("--"));
    let Some(data) = args.next() else {
        println!("no folder of data was named: nothing to measure");
        return;
    };
    let wanted: Vec<String> = args.collect();
    // Cargo runs a bench in the folder of its package.
    let data = Path::new(&data).canonicalize().unwrap();
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 1 };
    let bench = Bench { cx: Context::detached(scene, data.clone()), data };
    let sections =
        [("exact", exact::table as fn(&Bench)), ("knobs", knobs::table), ("growth", growth::table)];
    for (name, table) in sections.into_iter().chain([("panorama", panorama::table as fn(&Bench))]) {
        if wanted.is_empty() || wanted.iter().any(|w| w == name) {
            table(&bench);
        }
    }
}
