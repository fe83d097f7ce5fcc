//! A paved courtyard in the sun, with two walls, a pergola, a basin, a bench and planters.

use std::f64::consts::PI;

use glam::DVec3;
use scene::math::num;

use super::light::Sky;
use super::paint::Paint;
use super::place::Layout;
use super::random::unit;
use super::shape::{Placement, Shapes};

const LOW: DVec3 = DVec3::new(-5.0, -5.5, 0.0);
const HIGH: DVec3 = DVec3::new(5.0, 5.0, 4.4);
const STONE: Paint = Paint::Plaster([0.54, 0.49, 0.40]);
const STUCCO: Paint = Paint::Plaster([0.60, 0.36, 0.20]);
const TIMBER: Paint = Paint::Wood([0.26, 0.155, 0.085]);

pub(super) fn layout(seed: u64) -> Layout {
    let mut s = Shapes::default();
    let at = DVec3::new;
    let (width, depth) = (HIGH.x - LOW.x, HIGH.y - LOW.y);
    s.flat(LOW, DVec3::X * width, DVec3::Y * depth, Paint::Slabs, None);
    s.between([LOW.x, LOW.y, -0.2], [HIGH.x, HIGH.y, 0.0], Paint::Hidden, true);
    // Walls: brick on the left, stucco behind with a door, low walls elsewhere.
    s.between([LOW.x - 0.35, LOW.y, 0.0], [LOW.x, HIGH.y + 0.35, 3.2], Paint::Bricks, true);
    s.between([LOW.x, HIGH.y, 0.0], [HIGH.x, HIGH.y + 0.35, 3.9], STUCCO, true);
    s.between([HIGH.x, LOW.y, 0.0], [HIGH.x + 0.35, HIGH.y + 0.35, 1.5], Paint::Bricks, true);
    s.between([LOW.x - 0.42, LOW.y, 3.2], [LOW.x + 0.07, HIGH.y + 0.35, 3.3], STONE, true);
    s.between([LOW.x, HIGH.y - 0.08, 3.9], [HIGH.x, HIGH.y + 0.42, 4.02], STONE, true);
    s.between([HIGH.x - 0.06, LOW.y, 1.5], [HIGH.x + 0.41, HIGH.y - 0.1, 1.58], STONE, true);
    door(&mut s, 1.35);
    shutters(&mut s, -1.9);
    arcade(&mut s);
    basin(&mut s);
    bench(&mut s);
    for (i, (x, y)) in [(-1.15, 4.25), (3.0, 4.2), (4.3, 1.6), (-4.3, -0.6)].into_iter().enumerate() {
        planter(&mut s, seed, i as u64, x, y);
    }
    let captures = (0..16).map(|i| {
        let (sin, cos) = num::sin_cos(2.0 * PI * f64::from(i) / 16.0);
        at(3.3 * cos, 3.3 * sin - 0.4, 1.3 + 0.35 * f64::from(i % 3))
    });
    Layout {
        shapes: s,
        sky: Sky {
            zenith: [0.16, 0.30, 0.66],
            horizon: [0.55, 0.68, 0.86],
            ground: [0.20, 0.18, 0.14],
            sun: DVec3::new(-0.62, -0.30, 0.70).normalize(),
            sun_irradiance: [4.3, 3.95, 3.35],
            sun_sine: 0.0095,
            glow: 1.6,
        },
        opening: None,
        lamp: None,
        stand: 0.0,
        bounds: [LOW, HIGH],
        eye: DVec3::new(0.62, -2.15, 0.98),
        target: DVec3::new(0.06, 0.4, 0.46),
        fov_y_deg: 44.0,
        captures: captures.collect(),
        dome: Some(45.0),
    }
}

fn door(s: &mut Shapes, x: f64) {
    let y = HIGH.y;
    let green = Paint::Wood([0.06, 0.13, 0.11]);
    s.between([x - 0.55, y - 0.03, 0.0], [x + 0.55, y - 0.001, 2.15], green, false);
    for side in [-0.63, 0.55] {
        s.between([x + side, y - 0.07, 0.0], [x + side + 0.08, y, 2.23], STONE, true);
    }
    s.between([x - 0.63, y - 0.07, 2.15], [x + 0.63, y, 2.28], STONE, true);
    s.between([x - 0.75, y - 0.36, 0.0], [x + 0.75, y, 0.09], STONE, true);
    for (a, b) in [(-0.48, -0.04), (0.04, 0.48)] {
        for (low, high) in [(0.15, 0.95), (1.05, 2.02)] {
            s.between([x + a, y - 0.045, low], [x + b, y - 0.03, high], green, false);
        }
    }
    s.between(
        [x + 0.015, y - 0.09, 1.0],
        [x + 0.035, y - 0.045, 1.1],
        Paint::Lacquer([0.5, 0.38, 0.16]),
        false,
    );
}

fn shutters(s: &mut Shapes, x: f64) {
    let y = HIGH.y;
    s.between(
        [x - 0.5, y - 0.012, 1.15],
        [x + 0.5, y - 0.001, 2.5],
        Paint::Lacquer([0.03, 0.035, 0.04]),
        false,
    );
    s.between([x - 0.62, y - 0.12, 1.05], [x + 0.62, y, 1.15], STONE, true);
    for (from, to) in [(x - 1.02, x - 0.52), (x + 0.52, x + 1.02)] {
        for i in 0..22 {
            let z = 1.16 + 1.34 * f64::from(i) / 22.0;
            s.between(
                [from, y - 0.05, z],
                [to, y - 0.015, z + 0.043],
                Paint::Plain([0.10, 0.20, 0.22]),
                false,
            );
        }
    }
}

/// Adds the columns and beams of a pergola in front of the left wall.
fn arcade(s: &mut Shapes) {
    for y in [-2.4, 0.3, 3.0] {
        let column = [
            [0.0, 0.0],
            [0.21, 0.0],
            [0.21, 0.10],
            [0.165, 0.14],
            [0.15, 0.20],
            [0.13, 2.30],
            [0.16, 2.36],
            [0.20, 2.46],
            [0.20, 2.54],
            [0.0, 2.54],
        ];
        s.revolve(Placement::new(-3.1, y, 0.0, 0.0), &column, 28, STONE, true);
    }
    s.between([-3.22, -3.2, 2.54], [-2.98, 4.9, 2.74], TIMBER, true);
    for i in 0..11 {
        let y = -3.0 + 0.76 * f64::from(i);
        s.between([-5.0, y - 0.05, 2.74], [-2.5, y + 0.05, 2.88], TIMBER, true);
    }
}

fn basin(s: &mut Shapes) {
    let wall = [
        [0.0, 0.0],
        [0.95, 0.0],
        [0.95, 0.08],
        [0.88, 0.10],
        [0.88, 0.40],
        [0.96, 0.43],
        [0.96, 0.50],
        [0.74, 0.50],
        [0.74, 0.36],
        [0.0, 0.36],
    ];
    s.revolve(Placement::new(2.1, 2.45, 0.0, 0.0), &wall, 40, STONE, true);
    s.revolve(Placement::new(2.1, 2.45, 0.0, 0.0), &[[0.74, 0.40], [0.0, 0.405]], 40, Paint::Water, false);
    let spout = [
        [0.0, 0.36],
        [0.12, 0.36],
        [0.09, 0.46],
        [0.075, 0.80],
        [0.10, 0.86],
        [0.30, 0.96],
        [0.33, 1.02],
        [0.28, 1.01],
        [0.06, 0.94],
        [0.05, 1.16],
        [0.0, 1.20],
    ];
    s.revolve(Placement::new(2.1, 2.45, 0.0, 0.0), &spout, 28, STONE, true);
}

fn bench(s: &mut Shapes) {
    let place = Placement::new(-1.75, 2.7, 0.0, 18.0);
    let v = DVec3::new;
    for x in [-0.7, 0.7] {
        s.cuboid(place, v(x, 0.0, 0.21), v(0.07, 0.2, 0.21), STONE, true);
    }
    for i in 0..4 {
        let y = -0.18 + 0.12 * f64::from(i);
        s.cuboid(place, v(0.0, y, 0.44), v(0.95, 0.05, 0.02), TIMBER, true);
    }
}

fn planter(s: &mut Shapes, seed: u64, i: u64, x: f64, y: f64) {
    let size = 0.85 + 0.4 * unit(seed, 0x706f, i, 0);
    let pot = [
        [0.0, 0.0],
        [0.17, 0.0],
        [0.25, 0.38],
        [0.28, 0.40],
        [0.28, 0.46],
        [0.24, 0.46],
        [0.23, 0.40],
        [0.0, 0.40],
    ]
    .map(|[r, z]| [r * size, z * size]);
    s.revolve(Placement::new(x, y, 0.0, 0.0), &pot, 24, Paint::Plaster([0.42, 0.17, 0.085]), true);
    for k in 0..54_u64 {
        let r = |d: u64| unit(seed, 0x6c65, i * 1000 + k, d);
        let (sin, cos) = num::sin_cos(2.0 * PI * (k as f64 * 0.381_966 + 0.2 * r(0)));
        let (out, side) = (DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0));
        let (rise, reach) = (size * (0.25 + 0.75 * r(1)), size * (0.12 + 0.34 * r(2)));
        let width = 0.03 + 0.03 * r(3);
        let base = DVec3::new(x, y, 0.40 * size) + out * 0.10 * r(4);
        let edge = |j: usize| {
            let t = j as f64 / 7.0;
            let bend = out * (reach * t) + DVec3::Z * (rise * (1.35 * t - 0.55 * t * t));
            let w = width * 2.0 * ((t + 0.03) * (1.03 - t)).max(0.0).sqrt();
            (base + bend - side * w + DVec3::Z * (0.3 * w), base + bend + side * w + DVec3::Z * (0.3 * w))
        };
        let edges: Vec<_> = (0..=7).map(edge).collect();
        let green = [0.07 + 0.07 * r(5), 0.16 + 0.10 * r(6), 0.035 + 0.03 * r(7)];
        s.strip(&edges, Paint::Leaf(green));
    }
}
