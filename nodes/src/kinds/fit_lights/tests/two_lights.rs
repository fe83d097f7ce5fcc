//! A room with a warm lamp and a cool window, whose light is computed here by radiosity.

use std::f64::consts::PI;

use engine::{Notes, Up};
use glam::DVec3;

use super::super::*;
use render::geometry::sampling::{fraction, hash};
use render::light::emitters::{Emitters, colour_angle_deg, find, texel};
use render::light::measure::luminance;
use scene::math::num;
use scene::types::{Cell, Image};
use testing::context;

type Rgb = [f64; 3];

const EYE: DVec3 = DVec3::new(0.2, -0.3, 1.1);
const HALF: DVec3 = DVec3::new(2.5, 2.0, 1.35);
const WARM: Rgb = [1.0, 0.62, 0.30];
const COOL: Rgb = [0.62, 0.82, 1.0];
const WHITE: Rgb = [0.70, 0.69, 0.67];
/// Furniture, which casts the shadows.
const BOXES: [[DVec3; 2]; 2] = [
    [DVec3::new(-1.3, 0.6, 0.0), DVec3::new(-0.5, 1.3, 0.8)],
    [DVec3::new(0.7, -1.5, 0.0), DVec3::new(1.3, -0.9, 1.0)],
];
const LAMP: [DVec3; 2] = [DVec3::new(1.4, 0.7, 1.25), DVec3::new(1.7, 1.0, 1.55)];

struct Wall {
    corner: DVec3,
    u: DVec3,
    v: DVec3,
    albedo: Rgb,
    glow: Rgb,
    /// Irradiance of each cell, row by row.
    light: Vec<Rgb>,
}

impl Wall {
    fn normal(&self) -> DVec3 {
        self.u.cross(self.v).normalize()
    }

    fn counts(&self, step: f64) -> [usize; 2] {
        [self.u, self.v].map(|side| ((side.length() / step).round() as usize).max(1))
    }

    /// Middles of the cells, and the area of one.
    fn cells(&self, step: f64) -> (Vec<DVec3>, f64) {
        let [n, m] = self.counts(step);
        let at = |i: usize| {
            let [s, t] = [(i % n) as f64 + 0.5, (i / n) as f64 + 0.5];
            self.corner + self.u * (s / n as f64) + self.v * (t / m as f64)
        };
        ((0..n * m).map(at).collect(), self.u.cross(self.v).length() / (n * m) as f64)
    }
}

/// Lamp and window of a room, and how it is captured.
#[derive(Clone, Copy)]
struct Case {
    lamp: Rgb,
    window: Rgb,
    left: Rgb,
    right: Rgb,
    /// True if the mesh shows albedo instead of light.
    unlit: bool,
    /// Part of the cells of the mesh that are missing.
    holes: f64,
    scale: f64,
    all_black: bool,
}

const BOTH: Case = Case {
    lamp: [60.0 * WARM[0], 60.0 * WARM[1], 60.0 * WARM[2]],
    window: [9.0 * COOL[0], 9.0 * COOL[1], 9.0 * COOL[2]],
    left: WHITE,
    right: WHITE,
    unlit: false,
    holes: 0.0,
    scale: 1.0,
    all_black: false,
};

fn slabs([low, high]: [DVec3; 2], from: DVec3, d: DVec3) -> Option<(f64, f64)> {
    let (a, b) = ((low - from) / d, (high - from) / d);
    let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
    (near < far && far > 0.0).then_some((near, far))
}

fn is_open(from: DVec3, to: DVec3) -> bool {
    let inner = |[low, high]: [DVec3; 2]| [low + 1e-3, high - 1e-3];
    !BOXES.into_iter().any(|one| slabs(inner(one), from, to - from).is_some_and(|(near, _)| near < 1.0))
}

const STEP: f64 = 0.125;

/// Sides of a box, seen from outside.
fn sides([low, high]: [DVec3; 2], albedo: Rgb, glow: Rgb) -> Vec<Wall> {
    let d = high - low;
    let [x, y, z] = [DVec3::X * d.x, DVec3::Y * d.y, DVec3::Z * d.z];
    let of = |corner, u, v| Wall { corner, u, v, albedo, glow, light: Vec::new() };
    vec![
        of(low + z, x, y),
        of(low, y, x),
        of(low, x, z),
        of(low + x + y, -x, z),
        of(low + x, y, z),
        of(low + y, -y, z),
    ]
}

fn room(case: &Case) -> Vec<Wall> {
    let plain = |corner: DVec3, u: DVec3, v: DVec3, albedo: Rgb| Wall {
        corner,
        u,
        v,
        albedo,
        glow: [0.0; 3],
        light: Vec::new(),
    };
    let (low, x, y, z) = (DVec3::new(-HALF.x, -HALF.y, 0.0), DVec3::X * 5.0, DVec3::Y * 4.0, DVec3::Z * 2.7);
    let mut walls = vec![
        plain(low, x, y, [0.38, 0.26, 0.16]),
        plain(low + z, y, x, WHITE),
        plain(low + x, z, y, case.right),
        plain(low, z, x, WHITE),
        plain(low + y, x, z, WHITE),
    ];
    // The left wall around the window.
    let pieces = [(0.0, 4.0, 0.0, 0.9), (0.0, 4.0, 2.1, 2.7), (0.0, 1.1, 0.9, 2.1), (2.6, 4.0, 0.9, 2.1)];
    for (a, b, c, d) in pieces {
        let corner = low + DVec3::new(0.0, a, c);
        walls.push(plain(corner, DVec3::Y * (b - a), DVec3::Z * (d - c), case.left));
    }
    let window = plain(low + DVec3::new(0.0, 1.1, 0.9), DVec3::Y * 1.5, DVec3::Z * 1.2, [0.05; 3]);
    walls.push(Wall { glow: case.window, ..window });
    walls.extend(sides(LAMP, [0.4; 3], case.lamp));
    walls.extend(BOXES.into_iter().flat_map(|one| sides(one, [0.5, 0.45, 0.4], [0.0; 3])));
    if case.all_black {
        walls.iter_mut().for_each(|wall| wall.albedo = [0.02; 3]);
    }
    let gather = |points: &[DVec3], normal: DVec3, sources: &[(DVec3, DVec3, Rgb)]| -> Vec<Rgb> {
        let at = |point: &DVec3| {
            let from = *point + normal * 2e-3;
            let mut sum = [0.0; 3];
            for (position, facing, power) in sources {
                let way = *position - from;
                let square = way.length_squared().max(1e-3);
                let by = way.dot(normal).max(0.0) * (-way.dot(*facing)).max(0.0) / (square * square);
                if by > 1e-8 && is_open(from, *position) {
                    (0..3).for_each(|c| sum[c] += by * power[c]);
                }
            }
            sum
        };
        points.iter().map(at).collect()
    };
    let mut lights = Vec::new();
    for wall in walls.iter().filter(|wall| wall.glow[1] > 0.0) {
        let (cells, area) = wall.cells(0.2);
        lights.extend(cells.into_iter().map(|at| (at, wall.normal(), wall.glow.map(|v| v * area))));
    }
    let coarse: Vec<_> = walls.iter().map(|wall| wall.cells(0.5)).collect();
    let direct: Vec<Vec<Rgb>> =
        walls.iter().zip(&coarse).map(|(wall, (cells, _))| gather(cells, wall.normal(), &lights)).collect();
    let mut light = direct.clone();
    let sources = |light: &[Vec<Rgb>]| -> Vec<(DVec3, DVec3, Rgb)> {
        let of = |(index, wall): (usize, &Wall)| {
            let (cells, area) = &coarse[index];
            let power = |rgb: Rgb| [0, 1, 2].map(|c| rgb[c] * wall.albedo[c] / PI * area);
            let list = cells.iter().zip(&light[index]).map(|(at, rgb)| (*at, wall.normal(), power(*rgb)));
            list.collect::<Vec<_>>()
        };
        walls.iter().enumerate().flat_map(of).collect()
    };
    for _ in 0..3 {
        let sources = sources(&light);
        for (index, wall) in walls.iter().enumerate() {
            let more = gather(&coarse[index].0, wall.normal(), &sources);
            for (cell, more) in more.into_iter().enumerate() {
                light[index][cell] = [0, 1, 2].map(|c| direct[index][cell][c] + more[c]);
            }
        }
    }
    lights.extend(sources(&light));
    for wall in &mut walls {
        let cells = wall.cells(STEP).0;
        wall.light = gather(&cells, wall.normal(), &lights);
    }
    walls
}

/// Albedo of a cell: piecewise constant, with 10 % of noise.
fn albedo(wall: &Wall, index: usize, cell: usize) -> Rgb {
    let n = wall.counts(STEP)[0];
    let slab = (cell % n / 5 + cell / n / 5) % 2;
    let noise = 0.95 + 0.1 * fraction(hash(cell as u32, index as u32));
    let by = noise * if index == 0 && slab == 1 { 0.7 } else { 1.0 };
    wall.albedo.map(|value| value * by)
}

fn radiance(wall: &Wall, index: usize, cell: usize) -> Rgb {
    let albedo = albedo(wall, index, cell);
    [0, 1, 2].map(|c| wall.glow[c] + albedo[c] * wall.light[cell][c] / PI)
}

/// The mesh of the capture, and the true environment.
fn captured(case: &Case) -> (Mesh, Environment) {
    let walls = room(case);
    let (width, height) = (256, 128);
    let mut env =
        Environment { image: Image::new(width, height, 3).into(), up: Up::PlusZ, origin: Some(EYE) };
    for at in 0..width * height {
        let d = texel(&env, at).0;
        let mut best = (f64::INFINITY, [0.0; 3]);
        for (index, wall) in walls.iter().enumerate() {
            let normal = wall.normal();
            let t = (wall.corner - EYE).dot(normal) / d.dot(normal);
            let p = EYE + d * t - wall.corner;
            let [a, b] = [wall.u, wall.v].map(|side| p.dot(side) / side.length_squared());
            if t > 0.0 && t < best.0 && d.dot(normal) < 0.0 && a.min(b) >= 0.0 && a.max(b) < 1.0 {
                let [n, m] = wall.counts(STEP);
                let cell = (b * m as f64) as usize * n + (a * n as f64) as usize;
                best = (t, radiance(wall, index, cell));
            }
        }
        let texel = &mut env.image.samples[3 * at..3 * at + 3];
        texel.iter_mut().zip(best.1).for_each(|(value, v)| *value = v as f32);
    }
    let mut all: Vec<f32> = env.image.samples.iter().copied().skip(1).step_by(3).collect();
    let middle = all.len() / 2;
    let exposure = 0.2 / *all.select_nth_unstable_by(middle, f32::total_cmp).1;
    env.image.samples.iter_mut().for_each(|value| *value *= exposure);
    let mut mesh = Mesh::default();
    for (index, wall) in walls.iter().enumerate() {
        let [n, m] = wall.counts(STEP);
        for cell in 0..n * m {
            let dark = wall.glow[1] == 0.0;
            if dark && fraction(hash(cell as u32, 7 * index as u32)) < case.holes {
                continue;
            }
            let shown = radiance(wall, index, cell).map(|v| (v * f64::from(exposure)).min(1.0) as f32);
            let shown = if case.unlit && dark { albedo(wall, index, cell).map(|v| v as f32) } else { shown };
            let first = mesh.positions.len() as u32;
            for (a, b) in [(0, 0), (1, 0), (1, 1), (0, 1)] {
                let [s, t] = [(cell % n + a) as f64 / n as f64, (cell / n + b) as f64 / m as f64];
                let position = (wall.corner + wall.u * s + wall.v * t) * case.scale;
                mesh.positions.push(position.as_vec3().to_array());
                mesh.colours.push(shown);
            }
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    (mesh, env)
}

/// The environment with the hidden light of its emitters replaced by white light of the given multiples of the true
/// luminance, in the order of the emitters.
fn predicted(truth: &Environment, stops: &[f64]) -> (Environment, Emitters) {
    let emitters = find(truth);
    let mut env = truth.clone();
    for (emitter, stops) in emitters.list.iter().zip(stops) {
        let by = num::f64::exp2(*stops);
        for &at in &emitter.texels {
            let texel = &mut env.image.samples[3 * at..3 * at + 3];
            let light = luminance([0, 1, 2].map(|c| f64::from(texel[c])));
            texel.fill((light * by).max(1.0) as f32);
        }
    }
    (env, emitters)
}

/// Errors of the emitters: strength in stops, and colour in degrees.
fn errors(env: &Environment, truth: &Environment, emitters: &Emitters) -> Vec<[f64; 2]> {
    let fluxes = emitters.fluxes(env).into_iter().zip(emitters.fluxes(truth));
    let error = |(found, want): (Rgb, Rgb)| {
        let stops = num::f64::log2(luminance(found) / luminance(want));
        [stops, colour_angle_deg(found, want).expect("not black")]
    };
    fluxes.map(error).collect()
}

fn fitted(mesh: Mesh, env: Environment) -> (Out, Notes) {
    let inputs = In { env: Arc::new(env), receiver: Arc::new(mesh), splats: None };
    FitLights::run(&FitLights { points: 6000, strengths: true, ..FitLights::default() }, inputs, &context())
        .expect("runs")
}

fn verdicts(out: &Out) -> Vec<String> {
    let last = |row: &Vec<Cell>| match row.last() {
        Some(Cell::Text(text)) => text.clone(),
        _ => String::new(),
    };
    out.report.tables[1].rows.iter().map(last).collect()
}

/// Errors before and after the fit, with predictions that are off by `stops`.
fn compared(case: &Case, stops: &[f64]) -> (Vec<[f64; 2]>, Vec<[f64; 2]>, Out) {
    let (mesh, truth) = captured(case);
    let (env, emitters) = predicted(&truth, stops);
    let before = errors(&env, &truth, &emitters);
    let (out, _) = fitted(mesh, env);
    let after = errors(&out.env, &truth, &emitters);
    (before, after, out)
}

// The prediction of one light is half as strong, the other twice as strong, and both are white.
#[test]
fn two_lights_get_their_strengths_and_colours_back() {
    for stops in [[-1.0, 1.0], [1.0, -1.0]] {
        let (before, after, _) = compared(&BOTH, &stops);
        for (before, after) in before.iter().zip(&after) {
            assert!(after[0].abs() < 0.5 * before[0].abs(), "{before:?} {after:?}");
            assert!(after[1] < 0.5 * before[1], "{before:?} {after:?}");
        }
    }
}

// The walls have the colours that the lights have in `BOTH`, and the lights are white.
#[test]
fn coloured_walls_do_not_make_coloured_lights() {
    let case = Case { lamp: [40.0; 3], window: [8.0; 3], left: COOL, right: WARM, ..BOTH };
    let (before, after, _) = compared(&case, &[0.0, 0.0]);
    for (before, after) in before.iter().zip(&after) {
        assert!(
            after[0].abs() < before[0].abs() + 0.25 && after[1] < before[1] + 3.0,
            "{before:?} {after:?}"
        );
    }
}

#[test]
fn colours_without_light_change_nothing() {
    let (mesh, truth) = captured(&Case { unlit: true, ..BOTH });
    let (env, _) = predicted(&truth, &[-1.0, 1.0]);
    let (out, notes) = fitted(mesh, env.clone());
    assert_eq!(*out.env, env, "{:?}", verdicts(&out));
    assert!(notes.iter().any(|note| note.id == "emitters-kept"));
}

// Holes, a wrong scale and black walls do not make the light worse than its prediction.
#[test]
fn poor_captures_do_no_harm() {
    let holes = Case { holes: 0.3, ..BOTH };
    let scaled = Case { scale: 1.5, ..BOTH };
    let black = Case { all_black: true, ..BOTH };
    let lamp = Case { window: [0.0; 3], ..BOTH };
    let window = Case { lamp: [0.0; 3], ..BOTH };
    for (name, case) in
        [("holes", holes), ("scale", scaled), ("black", black), ("lamp", lamp), ("window", window)]
    {
        let (before, after, _) = compared(&case, &[-0.7, 0.7]);
        for (before, after) in before.iter().zip(&after) {
            assert!(after[0].abs() < before[0].abs() + 0.35, "{name}: {before:?} {after:?}");
            assert!(after[1] < before[1] + 4.0, "{name}: {before:?} {after:?}");
        }
    }
}

// A mesh of another scale has other colours than the panorama in the same directions, and so do unlit colours. A true mesh
// does not, even with holes.
#[test]
fn a_mesh_that_does_not_fit_the_panorama_changes_nothing() {
    let verdict = |case: &Case| verdicts(&compared(case, &[-0.7, 0.7]).2);
    let refused = |list: &[String]| list.iter().any(|text| text.contains("other colours than the panorama"));
    for case in [Case { scale: 1.5, ..BOTH }, Case { scale: 0.7, ..BOTH }] {
        let found = verdict(&case);
        assert!(refused(&found), "{}: {found:?}", case.scale);
    }
    let found = verdict(&Case { holes: 0.3, ..BOTH });
    assert!(!refused(&found), "{found:?}");
}

#[test]
fn the_fit_does_not_depend_on_chance() {
    let (mesh, truth) = captured(&BOTH);
    let (env, _) = predicted(&truth, &[-1.0, 1.0]);
    assert_eq!(*fitted(mesh.clone(), env.clone()).0.env, *fitted(mesh, env).0.env);
}
