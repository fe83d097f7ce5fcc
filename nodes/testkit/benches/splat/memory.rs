//! Measures the peak memory of rendering, without the memory of the scene, and compares it with the memory
//! estimates of the kinds.

use std::process::Command;
use std::sync::Arc;

use engine::{Artifact, Kind};
use glam::DMat4;
use nodes::kinds::cube_rig::{self, CubeRig, Turn};
use nodes::kinds::splat_panorama::{self, SplatPanorama};
use nodes::kinds::splat_render::{self, SplatRender};
use nodes::kinds::stitch::Holes;
use render::splat::{Drawing, Sort};
use scene::types::{Pose, Rig};

use crate::{Bench, EYE, load};

/// Environment variable, with its value, that makes the allocator of the C library return freed memory at once.
/// Without it, freed memory that the allocator keeps would hide a later peak.
const GIVE_BACK: (&str, &str) = ("MALLOC_MMAP_THRESHOLD_", "65536");

/// The value of the entry `name` in `/proc/self/status`, in MiB.
fn status(name: &str) -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix(name)).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
}

/// Peak memory while `work` runs, minus the memory before it, in MiB.
fn peak<T>(work: impl FnOnce() -> T) -> f64 {
    // 5 forgets the peak so far (proc(5)).
    std::fs::write("/proc/self/clear_refs", "5").unwrap();
    let before = status("VmRSS");
    drop(std::hint::black_box(work()));
    status("VmHWM") - before
}

/// True in the process that takes the measurement.
pub fn measures() -> bool {
    std::env::var_os(GIVE_BACK.0).is_some()
}

pub fn table(bench: &Bench) {
    if !measures() {
        let mut again = Command::new(std::env::current_exe().unwrap());
        again.args(bench.folder.iter()).env(GIVE_BACK.0, GIVE_BACK.1);
        assert!(again.status().unwrap().success());
        return;
    }
    let mib = |bytes: u64| bytes as f64 / (1 << 20) as f64;
    println!("| work | scene MiB | peak beyond the scene MiB | estimate MiB |");
    println!("|---|---|---|---|");
    let line = |what: &str, scene: usize, most: f64, announced: Option<u64>| {
        let announced = announced.map_or("-".to_owned(), |bytes| format!("{:.0}", mib(bytes)));
        println!("| {what} | {:.0} | {most:.0} | {announced} |", mib(scene as u64));
    };
    {
        let (_folder, load) = load::million();
        let size = load().bytes();
        line("load 1 M rows of INRIA PLY (including the scene itself)", size, peak(&load), None);
    }
    let (splats, at) = (bench.garden(), Arc::new(Pose { world_from_local: DMat4::from_translation(EYE) }));
    let size = splats.bytes();
    let view = Arc::new(Rig { cameras: vec![bench.camera("garden_A2_tilted")] });
    let faces = |size_px| {
        let params = CubeRig { height_metres: 0.0, size_px, guard_deg: 3.0, turn: Turn::OffAxis };
        CubeRig::run(&params, cube_rig::In { at: at.clone() }, &bench.cx).unwrap().0.rig
    };
    let by = (SplatRender { sort: Sort::Depth, limit_sigmas: 1.0 }, Drawing::default());
    for (what, rig) in
        [("a view of 640x480", view), ("6 faces of 512 px", faces(512)), ("6 faces of 1024 px", faces(1024))]
    {
        let input = || splat_render::In { splats: splats.clone(), rig: rig.clone(), limit: None };
        let announced = SplatRender::estimate(&by, &input()).bytes;
        let most = peak(|| SplatRender::run(&by, input(), &bench.cx).unwrap());
        line(&format!("splat-render, {what}"), size, most, Some(announced));
    }
    for (width_px, supersample) in [(512, 2), (2048, 1), (2048, 2), (2048, 4)] {
        let own = SplatPanorama {
            height_metres: 0.0,
            width_px,
            supersample,
            holes: Holes::PushPull,
            hole_alpha: 0.25,
        };
        let params = (own, Drawing::default());
        let input = || splat_panorama::In { splats: splats.clone(), at: at.clone(), limit: None };
        let announced = SplatPanorama::estimate(&params, &input()).bytes;
        let most = peak(|| SplatPanorama::run(&params, input(), &bench.cx).unwrap());
        line(
            &format!("splat-panorama, {width_px} px, {supersample}x{supersample} samples"),
            size,
            most,
            Some(announced),
        );
    }
}
