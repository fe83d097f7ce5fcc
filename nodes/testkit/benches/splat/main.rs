//! Prints every table of `docs/evidence/splats.md`: speed of loading and drawing splats, exactness, effect of each
//! setting, time saved by each shortcut, growth of time and memory, and the two ways to render a panorama. Run it
//! as `cargo bench -p lightharmony-testkit --bench splat -- DATA [section ..]`, where DATA is a folder with
//! `splats/garden_sog`, `splats/playbot_sog` and `splat-refs`. Without DATA, only the speed is measured, for a
//! generated cloud of splats.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a benchmark prints its results and may panic")]

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

use engine::{Context, Up};
use glam::DVec3;
use scene::types::{Camera, SplatEncoding, Splats};
use testkit::{Data, Reference, process_seconds};

/// Data, context and thread pool of the benchmarks.
struct Bench {
    /// The data folder; `None` if it is not given.
    folder: Option<PathBuf>,
    data: Option<Data>,
    cx: Context,
    one: rayon::ThreadPool,
    garden: OnceLock<Arc<Splats>>,
}

impl Bench {
    /// The splats of `garden_sog`, or those of [`cloud`] if there is no data folder.
    fn garden(&self) -> Arc<Splats> {
        let load = || match &self.data {
            Some(data) => data.splats("splats/garden_sog", &[], false),
            None => Arc::new(cloud()),
        };
        self.garden.get_or_init(load).clone()
    }

    fn playbot(&self) -> Arc<Splats> {
        self.data.as_ref().unwrap().splats("splats/playbot_sog", &[], false)
    }

    /// The camera of a view of `splat-refs`. If there is no data folder, a camera that looks at [`cloud`].
    fn camera(&self, name: &str) -> Camera {
        match &self.data {
            Some(data) => Camera { name: name.to_owned(), ..Reference::named(data, name).camera },
            None => before_the_cloud(name),
        }
    }

    /// Reference colours of a view of `splat-refs`.
    fn reference(&self, name: &str) -> Vec<f32> {
        let data = self.data.as_ref().unwrap();
        Reference::named(data, name).layer(data, "rgb")
    }
}

/// Position in the garden from which panoramas are rendered.
const EYE: DVec3 = DVec3::new(4.02, -31.3, 0.2);

/// 800 thousand splats, distributed uniformly in a slab in front of the camera.
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

/// Camera of 640x480 pixels that looks at [`cloud`] along -y or, if `name` contains `tilted`, in a direction that
/// is not along an axis.
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
        lens: Default::default(),
        world_from_camera,
    }
}

/// Matrix of a camera with these axes and this position.
fn look(right: DVec3, down: DVec3, forward: DVec3, eye: DVec3) -> [f64; 16] {
    let columns = [right.extend(0.0), down.extend(0.0), forward.extend(0.0), eye.extend(1.0)];
    glam::DMat4::from_cols(columns[0], columns[1], columns[2], columns[3]).to_cols_array()
}

/// Runs `work` several times. Returns the result and the CPU seconds of the fastest run.
fn timed<T>(runs: usize, mut work: impl FnMut() -> T) -> (T, f64) {
    let mut best: Option<(T, f64)> = None;
    for _ in 0..runs {
        let start = process_seconds();
        let result = work();
        let seconds = process_seconds() - start;
        if best.as_ref().is_none_or(|(_, least)| seconds < *least) {
            best = Some((result, seconds));
        }
    }
    best.unwrap()
}

fn millions(n: u64) -> f64 {
    n as f64 / 1e6
}

/// The first line that a command prints; `None` if the command fails.
fn reported(command: &mut Command) -> Option<String> {
    let output = command.output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).lines().next().unwrap_or_default().to_owned())
}

/// Commit and processor with which the measurements are made, as text.
fn origin() -> String {
    let commit = reported(Command::new("git").args(["rev-parse", "--short", "HEAD"]));
    let changed = reported(Command::new("git").args(["status", "--porcelain", "--untracked-files=no"]));
    let changed = if changed.is_some_and(|line| !line.is_empty()) { " with changes" } else { "" };
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    format!(
        "commit {}{changed}, {}",
        commit.unwrap_or_else(|| "unknown".to_owned()),
        model.map_or("unknown processor", |(_, name)| name.trim())
    )
}

/// Name of a section of the output, and the function that prints the section.
type Section = (&'static str, fn(&Bench));

fn main() {
    let mut args = std::env::args().skip(1).filter(|arg| !arg.starts_with("--"));
    // Cargo runs a bench in the folder of its package.
    let folder = args.next().map(|data| Path::new(&data).canonicalize().unwrap());
    let wanted: Vec<String> = args.collect();
    let data = |folder: &Path| Data::of(folder, Up::PlusZ, 1);
    let bench = Bench {
        cx: data(folder.as_deref().unwrap_or(Path::new(""))).context(),
        data: folder.as_deref().map(data),
        folder,
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
    // The first sections need no data.
    let free = 2;
    let most = if bench.data.is_some() { sections.len() } else { free };
    for (name, table) in &sections[..most] {
        if wanted.is_empty() || wanted.iter().any(|w| w == name) {
            println!("\n## {name}");
            table(&bench);
        }
    }
}
