//! Rays a second beside Embree, on the same triangles and rays in one run.

use std::path::Path;
use std::process::Command;

use engine::{InputFile, Kind};
use glam::Vec3;
use nodes::bvh::{Bvh, Ray};
use nodes::load_object::{self, LoadObject};
use nodes::sampling::{Points, circle};

use super::case::{Case, context};

/// Rays of a set.
const RAYS: u32 = 196_608;

fn helmet(data: &Path) -> Vec<[Vec3; 3]> {
    let params = LoadObject { path: InputFile("gltf/DamagedHelmet.glb".to_owned()), scene: None };
    let object = LoadObject::run(&params, load_object::In {}, &context(data, 1)).unwrap().0.object;
    let corners = object
        .primitives
        .iter()
        .flat_map(|p| p.triangles.iter().map(|t| t.map(|i| Vec3::from_array(p.positions[i as usize]))));
    corners.collect()
}

/// Rays of a pinhole at `eye` that looks along -z, and rays without order.
fn rays(eye: Vec3, tangent: f32, origins: impl Fn(Points) -> Vec3) -> [Vec<Ray>; 2] {
    let (width, height) = (512, RAYS / 512);
    let coherent = (0..RAYS).map(|i| {
        let x = ((i % width) as f32 + 0.5) / width as f32 * 2.0 - 1.0;
        let y = (((i / width) as f32 + 0.5) * 2.0 - height as f32) / width as f32;
        Ray::new(eye, Vec3::new(x * tangent, -y * tangent, -1.0).normalize())
    });
    let random = (0..RAYS).map(|i| {
        let points = Points::new(5, i);
        let [u, v] = points.pair(3);
        let (sin, cos) = circle(u);
        let (z, r) = (1.0 - 2.0 * v, 2.0 * (v * (1.0 - v)).sqrt());
        Ray::new(origins(points), Vec3::new(r * cos, r * sin, z))
    });
    [coherent.collect(), random.collect()]
}

/// Millions of rays a CPU second: closest and any, the best of three passes, and hits.
fn rates(bvh: &Bvh, rays: &[Ray]) -> ([f64; 2], usize) {
    let mut best = [f64::INFINITY; 2];
    let mut hits = 0;
    for _ in 0..3 {
        let start = super::cpu_seconds();
        hits = rays.iter().filter(|ray| bvh.closest(**ray, |_| true).is_some()).count();
        best[0] = best[0].min(super::cpu_seconds() - start);
        let start = super::cpu_seconds();
        assert_eq!(hits, rays.iter().filter(|ray| bvh.any(**ray, |_| true)).count());
        best[1] = best[1].min(super::cpu_seconds() - start);
    }
    (best.map(|seconds| rays.len() as f64 / seconds / 1e6), hits)
}

fn write(path: &Path, vectors: impl Iterator<Item = Vec3>) {
    let bytes: Vec<u8> = vectors.flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes).collect();
    std::fs::write(path, bytes).unwrap();
}

/// Embree's rates on the same, if a C++ compiler and Embree 3 are installed.
fn embree(triangles: &[[Vec3; 3]], sets: &[Vec<Ray>; 2]) -> Option<String> {
    let folder = std::env::temp_dir().join(format!("lightharmony-rays-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let program = folder.join("embree");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/trace/embree.cpp");
    let built = Command::new("c++").arg("-O2").arg(source).arg("-o").arg(&program).arg("-lembree3").status();
    let text = built.is_ok_and(|status| status.success()).then(|| {
        let files = ["triangles", "coherent", "random"].map(|name| folder.join(name));
        write(&files[0], triangles.iter().flatten().copied());
        for (file, rays) in files[1..].iter().zip(sets) {
            write(file, rays.iter().flat_map(|ray| [ray.origin, ray.direction]));
        }
        String::from_utf8(Command::new(&program).args(&files).output().unwrap().stdout).unwrap()
    });
    std::fs::remove_dir_all(&folder).unwrap();
    text
}

/// Prints the table.
pub fn table(data: &Path) {
    let helmet = helmet(data);
    let room = Case::load(data, "closed_room").receiver;
    let mut mixed: Vec<[Vec3; 3]> =
        room.triangles.iter().map(|t| t.map(|i| Vec3::from_array(room.positions[i as usize]))).collect();
    let (low, high) = Bvh::build(&mixed).bounds().unwrap();
    let (middle, size) = ((low + high) * 0.5, high - low);
    for at in [Vec3::new(-0.25, -0.2, 0.0), Vec3::new(0.1, -0.2, 0.15), Vec3::new(0.25, -0.2, -0.15)] {
        mixed.extend(helmet.iter().map(|t| t.map(|p| p * 0.4 + middle + at * size)));
    }
    let inside = |points: Points| {
        let ([x, y], [z, _]) = (points.pair(0), points.pair(1));
        low + size * (Vec3::new(x, y, z) * 0.98 + 0.01)
    };
    let around = |points: Points| {
        let [u, v] = points.pair(0);
        let (sin, cos) = circle(u);
        let (z, r) = (1.0 - 2.0 * v, 2.0 * (v * (1.0 - v)).sqrt());
        Vec3::new(r * cos, r * sin, z)
    };
    let cases = [
        ("a room and three helmets", &mixed, rays(middle + Vec3::Z * (0.45 * size.z), 0.8, inside)),
        ("one helmet", &helmet, rays(Vec3::new(0.0, 0.2, 3.0), 0.4, around)),
    ];
    for (name, triangles, sets) in cases {
        let start = super::cpu_seconds();
        let bvh = Bvh::build(triangles);
        println!("{name}: {} triangles, build {:.4} CPU-s", triangles.len(), super::cpu_seconds() - start);
        for (order, rays) in ["coherent", "random"].into_iter().zip(&sets) {
            let ([closest, any], hits) = rates(&bvh, rays);
            println!("  {order}: closest {closest:.2}, any {any:.2} M rays/CPU-s, {hits} hits");
        }
        match embree(triangles, &sets) {
            Some(text) => println!("  Embree, robust:\n{text}"),
            None => println!("  no Embree 3 here (libembree-dev)"),
        }
    }
}
