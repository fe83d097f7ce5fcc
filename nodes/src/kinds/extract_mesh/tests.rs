//! Tests with synthetic scenes whose surfaces are known.

use glam::{DMat4, Vec3};

use super::*;
use render::geometry::bvh::{Bvh, Ray};
use render::geometry::sampling::{hash, unit};
use scene::types::Cell;
use testing::{context, direction};

/// Three pseudo-random numbers in [-1, 1], computed from a counter.
fn noise(i: usize) -> [f32; 3] {
    [0, 1, 2].map(|axis| 2.0 * unit(hash(i as u32, axis)) - 1.0)
}

/// Centre of the room of [`Scene::room`].
const MIDDLE: Vec3 = Vec3::new(0.0, 0.0, 1.3);
/// Half the size of the room.
const HALF: Vec3 = Vec3::new(2.0, 2.0, 1.3);

/// A scene of flat splats.
struct Scene {
    splats: Splats,
    /// Amplitude of the uniform noise of the positions, in metres.
    jitter: f32,
    /// Amplitude of the uniform noise of the normals, as a slope.
    tilt: f32,
}

impl Scene {
    fn new() -> Self {
        Self { splats: Splats::empty(), jitter: 0.0, tilt: 0.0 }
    }

    /// Adds a rectangle of splats with a spacing of 5 cm. `u` and `v` are the vectors from its centre to the
    /// middles of two adjacent sides.
    fn wall(mut self, middle: Vec3, u: Vec3, v: Vec3, colour: [f32; 3]) -> Self {
        let (columns, rows) = ((u.length() / 0.025).round() as usize, (v.length() / 0.025).round() as usize);
        for y in 0..rows {
            for x in 0..columns {
                let (a, b) = (
                    (x as f32 + 0.5) / columns as f32 * 2.0 - 1.0,
                    (y as f32 + 0.5) / rows as f32 * 2.0 - 1.0,
                );
                let of = noise(self.splats.len());
                let straight = u.cross(v).normalize();
                let normal = straight + (u.normalize() * of[0] + v.normalize() * of[1]) * self.tilt;
                let q = glam::Quat::from_rotation_arc(Vec3::Z, normal.normalize());
                self.splats.means.push((middle + u * a + v * b + straight * of[2] * self.jitter).to_array());
                self.splats.quats.push([q.w, q.x, q.y, q.z]);
                self.splats.scales.push([0.04, 0.04, 0.001]);
                self.splats.opacities.push(0.95);
                self.splats.sh.push(colour.map(|c| (c - 0.5) / 0.282_094_8));
            }
        }
        self
    }

    /// Adds the six sides of a box, which look the same from inside and outside.
    fn sides(self, middle: Vec3, half: Vec3, colour: [f32; 3]) -> Self {
        let [x, y, z] = [Vec3::X * half.x, Vec3::Y * half.y, Vec3::Z * half.z];
        [(x, y, z), (y, z, x), (z, x, y)].into_iter().fold(self, |scene, (n, u, v)| {
            scene.wall(middle + n, u, v, colour).wall(middle - n, u, v, colour)
        })
    }

    fn blob(mut self, at: Vec3, sigma: f32) -> Self {
        self.splats.means.push(at.to_array());
        self.splats.quats.push([1.0, 0.0, 0.0, 0.0]);
        self.splats.scales.push([sigma; 3]);
        self.splats.opacities.push(0.9);
        self.splats.sh.push([1.0; 3]);
        self
    }

    /// A room of 4 by 4 by 2.6 m whose floor is at height 0.
    fn room() -> Self {
        Self::new().sides(MIDDLE, HALF, [0.6, 0.5, 0.4])
    }

    fn mesh(self, params: &ExtractMesh) -> (Out, Notes) {
        self.mesh_in(params, 1.0)
    }

    /// Stores the scene in units of `metres_per_unit` metres, and extracts its mesh.
    fn mesh_in(mut self, params: &ExtractMesh, metres_per_unit: f32) -> (Out, Notes) {
        let scene = engine::Scene {
            up: engine::Up::PlusZ,
            metres_per_unit: f64::from(metres_per_unit),
            seed: 7,
            exhaustive: false,
        };
        for value in self.splats.means.iter_mut().chain(&mut self.splats.scales).flatten() {
            *value /= metres_per_unit;
        }
        let foot = DVec3::new(0.3, 0.2, 0.0) / f64::from(metres_per_unit);
        let pose = Pose { world_from_local: DMat4::from_translation(foot) };
        let inputs = In { splats: Arc::new(self.splats), cameras: None, around: Some(Arc::new(pose)) };
        ExtractMesh::run(params, inputs, &Context::detached(scene, ".")).expect("runs")
    }
}

fn coarse() -> ExtractMesh {
    ExtractMesh { voxel_metres: 0.03, reach_metres: 4.0, places: 6, size_px: 96, ..ExtractMesh::default() }
}

fn corners(mesh: &Mesh) -> Vec<[Vec3; 3]> {
    mesh.triangles.iter().map(|t| t.map(|i| Vec3::from(mesh.positions[i as usize]))).collect()
}

/// Points distributed over a mesh: about one point per 4 square centimetres, and at least one per triangle.
fn points(mesh: &Mesh) -> Vec<Vec3> {
    let mut points = Vec::new();
    for [a, b, c] in corners(mesh) {
        let count = (0.5 * (b - a).cross(c - a).length() / 4e-4).ceil() as usize;
        for _ in 0..count.max(1) {
            let [u, v, _] = noise(points.len()).map(|v| 0.5 * v + 0.5);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            points.push(a + (b - a) * u + (c - a) * v);
        }
    }
    points
}

/// Sorted distances of points from a surface, in millimetres.
fn off(points: &[Vec3], distance: impl Fn(Vec3) -> f32) -> Vec<f32> {
    let mut all: Vec<f32> = points.iter().map(|p| 1000.0 * distance(*p).abs()).collect();
    all.sort_unstable_by(f32::total_cmp);
    all
}

/// True if a point of a room is at least 10 cm from each edge where two of its sides meet. Nearer to an edge, the
/// mesh cuts the corner, because each vertex is the mean of the crossings of a cell.
fn on_a_side(p: Vec3) -> bool {
    let mut apart = ((p - MIDDLE).abs() - HALF).abs().to_array();
    apart.sort_unstable_by(f32::total_cmp);
    apart[1] > 0.1
}

fn at(sorted: &[f32], share: f32) -> f32 {
    sorted[((sorted.len() - 1) as f32 * share) as usize]
}

/// Distance of a point from the nearest side of a box.
fn to_sides(p: Vec3, middle: Vec3, half: Vec3) -> f32 {
    let q = (p - middle).abs() - half;
    (q.max(Vec3::ZERO).length() + q.max_element().min(0.0)).abs()
}

fn counted(out: &Out, name: &str) -> u64 {
    let row = out.report.tables[0].rows.iter().find(|row| row[0] == Cell::Text(name.to_owned()));
    match row.expect("is counted")[1] {
        Cell::Count(n) => n,
        _ => panic!("a count"),
    }
}

#[test]
fn a_room_is_closed_and_faces_inwards() {
    let (out, notes) = Scene::room().mesh(&coarse());
    assert_eq!(notes.iter().count(), 0);
    // Walls are where their splats are. The splats are 80 mm wide, and pixels cover 10 to 50 mm. Where two sides
    // meet, the mesh cuts the corner by at most half the diagonal of a cell: 52 mm for cells of 60 mm.
    let all = points(&out.mesh);
    let sides: Vec<Vec3> = all.iter().copied().filter(|p| on_a_side(*p)).collect();
    let far = off(&sides, |p| to_sides(p, MIDDLE, HALF));
    assert!(at(&far, 0.5) < 2.0 && at(&far, 0.9) < 6.0, "{} {}", at(&far, 0.5), at(&far, 0.9));
    let far = off(&all, |p| to_sides(p, MIDDLE, HALF));
    assert!(at(&far, 0.99) < 40.0 && at(&far, 1.0) < 65.0, "{} {}", at(&far, 0.99), at(&far, 1.0));
    let corners = corners(&out.mesh);
    let tree = Bvh::build(&corners);
    let eye = Vec3::new(0.3, 0.2, 0.8);
    for i in 0..2000 {
        let ray = direction([unit(hash(i, 7)), unit(hash(i, 8))]);
        let hit = tree.closest(Ray::new(eye, ray), |_| true).expect("the room is closed");
        assert!(!hit.back && to_sides(eye + ray * hit.t, MIDDLE, HALF) < 0.065);
    }
    // Walls are flat, so at most one in ten triangles remains.
    assert!(counted(&out, "triangles") * 10 < counted(&out, "triangles before simplification"));
    // The colour of the walls, in linear light.
    let expected = [0.6, 0.5, 0.4].map(scene::math::color::linear_from_srgb);
    for colour in &out.mesh.colours {
        assert!((0..3).all(|c| (colour[c] - expected[c]).abs() < 0.02), "{colour:?}");
    }
}

/// The near plane was 0.2 units in an earlier version. In units of 16 m, the floor around `around` was cut away and
/// became a hole. This test fails if `NEAR_METRES` is used without `* metre`.
#[test]
fn units_do_not_matter() {
    let metres = Scene::room().mesh(&coarse()).0.mesh;
    let units = Scene::room().mesh_in(&coarse(), 16.0).0.mesh;
    assert_eq!(metres.triangles.len(), units.triangles.len());
    let pairs = metres.positions.iter().zip(&units.positions);
    let worst = pairs.map(|(a, b)| (Vec3::from(*a) - 16.0 * Vec3::from(*b)).length()).fold(0.0, f32::max);
    assert!(worst < 1e-4, "{worst}");
}

#[test]
fn a_box_on_the_ground_is_a_box_on_the_ground() {
    let (middle, half) = (Vec3::new(0.9, 0.2, 0.2), Vec3::new(0.2, 0.2, 0.2));
    let ground = Scene::new().wall(Vec3::ZERO, Vec3::X * 2.5, Vec3::Y * 2.5, [0.5; 3]);
    let (out, _) = ground.sides(middle, half, [0.8, 0.2, 0.2]).mesh(&coarse());
    // Only points away from the border of the ground; below the border, space was seen neither as a surface nor as
    // empty.
    let inner: Vec<Vec3> =
        points(&out.mesh).into_iter().filter(|p| p.abs().truncate().max_element() < 2.2).collect();
    let far = off(&inner, |p| p.z.abs().min(to_sides(p, middle, half)));
    assert!(at(&far, 0.5) < 3.0 && at(&far, 0.95) < 30.0, "{} {}", at(&far, 0.5), at(&far, 0.95));
    // The mesh has the top and the sides of the box: rays from above and from the side hit them.
    let corners = corners(&out.mesh);
    let tree = Bvh::build(&corners);
    let top = tree.closest(Ray::new(Vec3::new(0.9, 0.2, 2.0), -Vec3::Z), |_| true).expect("a top");
    // This test fails if `MOST_CELLS` is 100 in `flatten`.
    assert!((top.t - 1.6).abs() < 0.005 && !top.back, "{}", top.t);
    let side = tree.closest(Ray::new(Vec3::new(-1.0, 0.2, 0.2), Vec3::X), |_| true).expect("a side");
    assert!((side.t - 1.7).abs() < 0.005 && !side.back, "{}", side.t);
    // There is nothing under the ground: no second sheet behind what was seen.
    assert!(inner.iter().all(|p| p.z > -0.01));
}

#[test]
fn what_is_seen_through_from_elsewhere_is_left_out() {
    let floaters = (0..40).fold(Scene::room(), |scene, i| {
        let of = noise(900 + i);
        scene.blob(Vec3::new(1.4 * of[0], 1.4 * of[1], 1.3 + 0.8 * of[2]), 0.01)
    });
    let (out, _) = floaters.mesh(&coarse());
    let far = off(&points(&out.mesh), |p| to_sides(p, MIDDLE, HALF));
    assert!(at(&far, 1.0) < 65.0, "{}", at(&far, 1.0));
}

// Splats with errors of at most 5 mm and 6 degrees (2.9 mm root mean square) give sides with smaller errors.
#[test]
fn noise_is_averaged() {
    let noisy = Scene { jitter: 0.005, tilt: 0.1, ..Scene::new() };
    let scene = noisy.sides(MIDDLE, HALF, [0.6, 0.5, 0.4]);
    let (out, _) = scene.mesh(&coarse());
    let sides: Vec<Vec3> = points(&out.mesh).into_iter().filter(|p| on_a_side(*p)).collect();
    let far = off(&sides, |p| to_sides(p, MIDDLE, HALF));
    assert!(at(&far, 0.5) < 2.5 && at(&far, 0.9) < 7.0, "{} {}", at(&far, 0.5), at(&far, 0.9));
}

// Noise of the splats themselves, which is the same in all views, is removed from level ground; a kerb of 10 cm
// does not move.
#[test]
fn level_ground_is_flat_and_a_kerb_stays() {
    let noisy = Scene { jitter: 0.005, tilt: 0.1, ..Scene::new() };
    let low = noisy.wall(Vec3::ZERO, Vec3::X * 2.5, Vec3::Y * 2.5, [0.5; 3]);
    let high = low.wall(Vec3::new(1.8, 0.0, 0.1), Vec3::X * 0.7, Vec3::Y * 2.5, [0.5; 3]);
    let (out, _) =
        high.wall(Vec3::new(1.1, 0.0, 0.05), Vec3::Y * 2.5, Vec3::Z * 0.05, [0.5; 3]).mesh(&coarse());
    let all = points(&out.mesh);
    let of = |low: f32, high: f32, z: f32| {
        let on = all.iter().copied().filter(|p| (low..high).contains(&p.x) && p.y.abs() < 1.0);
        off(&on.collect::<Vec<_>>(), |p| p.z - z)
    };
    for far in [of(-1.0, 0.9, 0.0), of(1.3, 2.0, 0.1)] {
        assert!(at(&far, 0.5) < 2.5 && at(&far, 0.9) < 5.0, "{} {}", at(&far, 0.5), at(&far, 0.9));
    }
}

#[test]
fn neither_sky_nor_what_lies_beyond_the_reach_is_meshed() {
    let scene = Scene::new().wall(Vec3::ZERO, Vec3::X * 3.0, Vec3::Y * 3.0, [0.5; 3]);
    let mut scene = scene.wall(Vec3::Y * 8.0 + Vec3::Z * 2.0, Vec3::X * 4.0, Vec3::Z * 4.0, [0.3; 3]);
    for i in 0..3000 {
        let d = direction([unit(hash(i, 1)), 0.5 * unit(hash(i, 2))]);
        scene = scene.blob(d * 50.0, 1.5);
    }
    let (out, _) = scene.mesh(&ExtractMesh { reach_metres: 5.0, ..coarse() });
    assert!(!out.mesh.triangles.is_empty());
    // At most one cell, of 240 mm, beyond the reach.
    let focus = Vec3::new(0.3, 0.2, 0.0);
    assert!(out.mesh.positions.iter().all(|p| (Vec3::from(*p) - focus).length() < 5.3 && p[2] < 0.1));
}

#[test]
fn any_number_of_threads_gives_the_same_mesh() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| Scene::room().mesh(&coarse()).0.mesh)
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}

// The mesh of a scene a million metres from the origin equals the mesh of the same scene at the origin, to within a
// hundredth of a cell.
#[test]
fn a_scene_far_from_the_origin_keeps_its_digits() {
    let far = DVec3::new(1e6, -2e6, 300.0);
    let mut scene = Scene::room().splats;
    for mean in &mut scene.means {
        let place = far + DVec3::from(mean.map(f64::from));
        *mean = place.as_vec3().to_array();
        scene.means_low.push((place - place.as_vec3().as_dvec3()).as_vec3().to_array());
    }
    let pose = Pose { world_from_local: DMat4::from_translation(far + DVec3::new(0.3, 0.2, 0.0)) };
    let inputs = In { splats: Arc::new(scene), cameras: None, around: Some(Arc::new(pose)) };
    let mesh = ExtractMesh::run(&coarse(), inputs, &context()).expect("runs").0.mesh;
    assert_eq!(mesh.positions_low.len(), mesh.positions.len());
    let near = Mesh {
        positions: (0..mesh.positions.len() as u32)
            .map(|i| (mesh.position(i) - far).as_vec3().to_array())
            .collect(),
        positions_low: Vec::new(),
        ..(*mesh).clone()
    };
    let sides: Vec<Vec3> = points(&near).into_iter().filter(|p| on_a_side(*p)).collect();
    let off = off(&sides, |p| to_sides(p, MIDDLE, HALF));
    assert!(at(&off, 0.5) < 2.0 && at(&off, 0.9) < 6.0, "{} {}", at(&off, 0.5), at(&off, 0.9));
}

#[test]
fn nothing_to_start_from_is_an_error_and_nothing_to_see_is_degraded() {
    let none = In { splats: Arc::new(Scene::room().splats), cameras: None, around: None };
    let error = ExtractMesh::run(&coarse(), none, &context()).err().expect("is refused");
    assert!(error.to_string().contains("neither `around` nor `cameras` is wired"), "{error}");
    let (out, notes) = Scene::new().mesh(&coarse());
    assert!(out.mesh.triangles.is_empty() && notes.iter().any(|note| note.id == "empty"));
}

#[test]
fn a_stopped_run_ends() {
    let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.3, 0.2, 0.0)) };
    let inputs =
        || In { splats: Arc::new(Scene::room().splats), cameras: None, around: Some(Arc::new(pose.clone())) };
    for fraction in [0.1, 0.55, 0.75, 0.85] {
        let cx = context().stopping_at(fraction);
        assert!(ExtractMesh::run(&coarse(), inputs(), &cx).is_err(), "{fraction}");
    }
}
