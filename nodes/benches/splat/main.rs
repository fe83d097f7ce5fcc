//! Every table of `docs/evidence/splats.md`: how fast splats are loaded and drawn, how exact, what each knob costs and each
//! skip saves, how time and memory grow, and both ways to a panorama.
//! `cargo bench -p lightharmony-nodes --bench splat -- DATA [section ..]`, where DATA holds `splats/garden_sog`,
//! `splats/playbot_sog` and `splat-refs`. Without DATA, speed alone, on a cloud made from a seed.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a bench prints, and may stop")]

mod exact;
mod growth;
mod knobs;
mod load;
mod memory;
mod panorama;
mod skips;
mod speed;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, OnceLock};

use engine::{Context, InputFile, Kind, Scene, Up};
use glam::{DMat3, DVec3};
use nodes::kinds::load_splats::{self, LoadSplats};
use nodes::math::num;
use nodes::types::{Camera, SplatEncoding, Splats};
use rustix::time::{ClockId, clock_gettime};

/// Where the data is, a context to work in, and one thread.
struct Bench {
    data: Option<PathBuf>,
    cx: Context,
    one: rayon::ThreadPool,
    garden: OnceLock<Arc<Splats>>,
}

impl Bench {
    fn data(&self, path: &str) -> PathBuf {
        self.data.as_ref().unwrap().join(path)
    }

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

    /// The garden, or the cloud.
    fn garden(&self) -> Arc<Splats> {
        let load = || match self.data {
            Some(_) => self.load("splats/garden_sog", &[]),
            None => Arc::new(cloud()),
        };
        self.garden.get_or_init(load).clone()
    }

    fn playbot(&self) -> Arc<Splats> {
        self.load("splats/playbot_sog", &[])
    }

    /// The camera of a view of `splat-refs`.
    fn camera(&self, name: &str) -> Camera {
        if self.data.is_none() {
            return before_the_cloud(name);
        }
        let text = std::fs::read(self.data("splat-refs/refs.json")).unwrap();
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
        let bytes = std::fs::read(self.data(&format!("splat-refs/{name}.rgb.npy"))).unwrap();
        let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        bytes[header..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
    }
}

/// A point of the garden around which panoramas are made.
const EYE: DVec3 = DVec3::new(4.02, -31.3, 0.2);

/// 800 thousand splats, uniform in a slab before the camera.
fn cloud() -> Splats {
    let mut state = 1_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1 << 24) as f32
    };
    let n = 800_000;
    let mut mean = || [next() * 40.0 - 20.0, next() * 60.0 - 60.0, next() * 8.0 - 2.0];
    Splats {
        means: (0..n).map(|_| mean()).collect(),
        means_low: Vec::new(),
        quats: vec![[0.5, 0.5, -0.5, 0.5]; n],
        scales: (0..n).map(|_| [0.05 * next(), 0.03 * next(), 0.05 * next()]).collect(),
        opacities: (0..n).map(|_| next()).collect(),
        sh_degree: 0,
        sh: (0..n).map(|_| [next(), next(), next()]).collect(),
        encoding: SplatEncoding::Srgb,
        antialiased: false,
    }
}

/// A 640x480 view along -y, turned off the axes where its name says so.
fn before_the_cloud(name: &str) -> Camera {
    let tilted = DVec3::new(-0.121_572, -0.990_128, -0.069_756);
    let forward = if name.contains("tilted") { tilted.normalize() } else { DVec3::NEG_Y };
    let right = forward.cross(DVec3::Z).normalize();
    let focal = 457.0;
    let world_from_camera = look(right, forward.cross(right), forward, EYE);
    let name = name.to_owned();
    Camera {
        name,
        width_px: 640,
        height_px: 480,
        fx: focal,
        fy: focal,
        cx: 320.0,
        cy: 240.0,
        world_from_camera,
    }
}

/// A camera's transform, of its axes and where it stands.
fn look(right: DVec3, down: DVec3, forward: DVec3, eye: DVec3) -> [f64; 16] {
    let columns = [right.extend(0.0), down.extend(0.0), forward.extend(0.0), eye.extend(1.0)];
    glam::DMat4::from_cols(columns[0], columns[1], columns[2], columns[3]).to_cols_array()
}

/// (PSNR in dB with peak 1, largest deviation) of the first three of `channels` and `others` samples per pixel.
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

fn clock(id: ClockId) -> f64 {
    let time = clock_gettime(id);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// CPU seconds of every thread of this process, so that others on the machine do not enter.
fn cpu_seconds() -> f64 {
    clock(ClockId::ProcessCPUTime)
}

/// CPU seconds of this thread.
fn thread_seconds() -> f64 {
    clock(ClockId::ThreadCPUTime)
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

fn millions(n: u64) -> f64 {
    n as f64 / 1e6
}

/// The first line of what a command prints.
fn told(command: &mut Command) -> Option<String> {
    let output = command.output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).lines().next().unwrap_or_default().to_owned())
}

/// Commit and scenes of the tables.
fn origin() -> String {
    let commit = told(Command::new("git").args(["rev-parse", "--short", "HEAD"]));
    let changed = told(Command::new("git").args(["status", "--porcelain", "--untracked-files=no"]));
    let changed = if changed.is_some_and(|line| !line.is_empty()) { " with changes" } else { "" };
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    format!(
        "commit {}{changed}, {}",
        commit.unwrap_or_else(|| "unknown".to_owned()),
        model.map_or("unknown processor", |(_, name)| name.trim())
    )
}

/// A name, and what prints it.
type Section = (&'static str, fn(&Bench));

fn main() {
    let mut args = std::env::args().skip(1).filter(|arg| !arg.starts_with("--"));
    // Cargo runs a bench in the folder of its package.
    let data = args.next().map(|data| Path::new(&data).canonicalize().unwrap());
    let wanted: Vec<String> = args.collect();
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 1, exhaustive: false };
    let here = data.clone().unwrap_or_default();
    let bench = Bench {
        cx: Context::detached(scene, here),
        data,
        one: rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap(),
        garden: OnceLock::new(),
    };
    if memory::measures() {
        return memory::table(&bench);
    }
    println!("{}", origin());
    let sections: [Section; 8] = [
        ("speed", speed::table),
        ("load", load::table),
        ("exact", exact::table),
        ("knobs", knobs::table),
        ("skips", skips::table),
        ("growth", growth::table),
        ("memory", memory::table),
        ("panorama", panorama::table),
    ];
    // What needs no data.
    let free = 2;
    let most = if bench.data.is_some() { sections.len() } else { free };
    for (name, table) in &sections[..most] {
        if wanted.is_empty() || wanted.iter().any(|w| w == name) {
            println!("\n## {name}");
            table(&bench);
        }
    }
}
