//! Compares the rays per second of this tracer with those of Embree, for the same triangles and the same rays in
//! one run.

use std::io::{BufRead, BufReader, Lines, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use glam::Vec3;
use render::geometry::bvh::{Bvh, Ray};
use render::geometry::sampling::{Points, circle};
use testkit::{Case, Data, thread_seconds};

/// Number of rays in a set of rays.
const RAYS: u32 = 196_608;
/// Number of passes over a set of rays per measurement. With fewer, a measurement would take less than a tenth of a
/// second.
const PASSES: usize = 4;
/// Number of rounds. In each round, first this tracer and then Embree is measured.
const ROUNDS: usize = 7;

fn helmet(data: &Data) -> Vec<[Vec3; 3]> {
    let object = data.object("gltf/DamagedHelmet.glb").0;
    let corners = object
        .primitives
        .iter()
        .flat_map(|p| p.triangles.iter().map(|t| t.map(|i| Vec3::from_array(p.positions[i as usize]))));
    corners.collect()
}

/// Two sets of rays: rays of a pinhole camera at `eye` that looks along -z, and incoherent rays from `origins`.
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

/// Traces a set of rays [`PASSES`] times for the closest hit and then [`PASSES`] times for any hit. Returns the CPU
/// seconds of each, and the number of rays that hit a triangle.
fn pass(bvh: &Bvh, rays: &[Ray]) -> ([f64; 2], usize) {
    let start = thread_seconds();
    let mut hits = [0; 2];
    for _ in 0..PASSES {
        hits[0] += rays.iter().filter(|ray| bvh.closest(**ray, |_| true).is_some()).count();
    }
    let middle = thread_seconds();
    for _ in 0..PASSES {
        hits[1] += rays.iter().filter(|ray| bvh.any(**ray, |_| true)).count();
    }
    let end = thread_seconds();
    assert_eq!(hits[0], hits[1], "`closest` and `any` must find the same number of hits");
    ([middle - start, end - middle], hits[0] / PASSES)
}

fn write(path: &Path, vectors: impl Iterator<Item = Vec3>) {
    let bytes: Vec<u8> = vectors.flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes).collect();
    std::fs::write(path, bytes).unwrap();
}

/// Embree with the same triangles and rays, in a separate process. The process reads the index of a set of rays,
/// traces this set, and prints its measurements.
struct Embree {
    program: Child,
    folder: PathBuf,
    /// Output of the process.
    lines: Lines<BufReader<ChildStdout>>,
}

impl Embree {
    /// Compiles and starts the process. `None` if no C++ compiler or Embree 3 is installed.
    fn start(triangles: &[[Vec3; 3]], sets: &[Vec<Ray>; 2]) -> Option<Self> {
        let folder = std::env::temp_dir().join(format!("lightharmony-rays-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let program = folder.join("embree");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/trace/embree.cpp");
        let built =
            Command::new("c++").arg("-O2").arg(source).arg("-o").arg(&program).arg("-lembree3").status();
        if !built.is_ok_and(|status| status.success()) {
            std::fs::remove_dir_all(&folder).unwrap();
            return None;
        }
        let files = ["triangles", "coherent", "random"].map(|name| folder.join(name));
        write(&files[0], triangles.iter().flatten().copied());
        for (file, rays) in files[1..].iter().zip(sets) {
            write(file, rays.iter().flat_map(|ray| [ray.origin, ray.direction]));
        }
        let mut command = Command::new(&program);
        let command = command.arg(PASSES.to_string()).args(&files);
        let mut program = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(program.stdout.take().unwrap()).lines();
        Some(Self { program, folder, lines })
    }

    /// Reads the numbers in the next line of the output of the process.
    fn numbers(&mut self) -> Vec<f64> {
        let line = self.lines.next().expect("a line").unwrap();
        line.split(' ').map(|word| word.parse().unwrap()).collect()
    }

    /// Same as [`pass`], but run by Embree.
    fn pass(&mut self, set: usize) -> ([f64; 2], usize) {
        writeln!(self.program.stdin.as_mut().unwrap(), "{set}").unwrap();
        let reported = self.numbers();
        ([reported[0], reported[1]], reported[2] as usize)
    }

    fn end(mut self) {
        drop(self.program.stdin.take());
        self.program.wait().unwrap();
        std::fs::remove_dir_all(&self.folder).unwrap();
    }
}

/// Minimum, median and maximum of a list.
fn spread(mut list: Vec<f64>) -> [f64; 3] {
    list.sort_by(f64::total_cmp);
    [list[0], list[list.len() / 2], list[list.len() - 1]]
}

/// Prints the table.
pub fn table(data: &Data) {
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
    println!("| scene | rays | kind | ours | Embree | ratio: median, minimum to maximum |");
    println!("|---|---|---|---|---|---|");
    let mut more = Vec::new();
    for (name, triangles, sets) in cases {
        let start = thread_seconds();
        let bvh = Bvh::build(triangles);
        let mut line =
            format!("{name}: {} triangles, build {:.4} CPU-s", triangles.len(), thread_seconds() - start);
        let mut embree = Embree::start(triangles, &sets);
        match &mut embree {
            Some(embree) => line += &format!(", Embree {:.4}", embree.numbers()[0]),
            None => line += "; Embree 3 is not installed (libembree-dev)",
        }
        for (set, order) in ["coherent", "random"].into_iter().enumerate() {
            let rays = &sets[set];
            let mut seconds = [const { [const { Vec::new() }; 2] }; 2];
            let mut hits = [0; 2];
            for _ in 0..ROUNDS {
                let ours = pass(&bvh, rays);
                let reported = embree.as_mut().map_or(([f64::NAN; 2], 0), |embree| embree.pass(set));
                for (who, (pair, found)) in [ours, reported].into_iter().enumerate() {
                    hits[who] = found;
                    seconds[who].iter_mut().zip(pair).for_each(|(list, s)| list.push(s));
                }
            }
            line += &format!("; {order}: {} hits, Embree {}", hits[0], hits[1]);
            for (kind, word) in ["closest", "any"].into_iter().enumerate() {
                let [ours, theirs] = [0, 1].map(|who| &seconds[who][kind]);
                // Both took turns, so the times of a round were measured in the same state of the machine.
                let [least, median, most] =
                    spread(theirs.iter().zip(ours).map(|(theirs, ours)| theirs / ours).collect());
                let rate =
                    |list: &Vec<f64>| rays.len() as f64 * PASSES as f64 / spread(list.clone())[1] / 1e6;
                println!(
                    "| {name} | {order} | {word} | {:.2} | {:.2} | {median:.2}, {least:.2} to {most:.2} |",
                    rate(ours),
                    rate(theirs)
                );
            }
        }
        embree.into_iter().for_each(Embree::end);
        more.push(line);
    }
    println!("\n{}\n", more.join("\n"));
}
