//! A furnished living room with a floor lamp and with a window on the left. The sun shines through the window and
//! lights the area behind the table.

use std::f64::consts::PI;

use glam::DVec3;
use scene::math::num;

use super::light::{Lamp, Opening, Sky};
use super::paint::Paint;
use super::place::Layout;
use super::random::unit;
use super::shape::{Placement, Shapes};

const LEFT: f64 = -2.45;
const RIGHT: f64 = 2.75;
const FRONT: f64 = -2.55;
const BACK: f64 = 2.25;
const CEILING: f64 = 2.7;
/// Range of the window in y and in z, in metres.
const WINDOW: [[f64; 2]; 2] = [[-1.0, 1.05], [0.7, 2.25]];
const REVEAL: f64 = 0.16;

const WHITE: Paint = Paint::Lacquer([0.74, 0.73, 0.70]);
const OAK: Paint = Paint::Wood([0.34, 0.20, 0.10]);
const WALNUT: Paint = Paint::Wood([0.155, 0.085, 0.048]);
const WALL: Paint = Paint::Plaster([0.66, 0.615, 0.53]);
const ACCENT: Paint = Paint::Plaster([0.235, 0.33, 0.33]);

/// Height of the table.
pub(super) const TABLE: f64 = 0.44;

pub(super) fn layout(seed: u64) -> Layout {
    let mut s = Shapes::default();
    shell(&mut s);
    window(&mut s);
    table(&mut s);
    sofa(&mut s);
    shelf(&mut s, seed);
    pictures(&mut s);
    let lamp = lamp(&mut s);
    plant(&mut s, seed);
    rest(&mut s);
    let [[y0, y1], [z0, z1]] = WINDOW;
    let opening = Opening {
        corner: DVec3::new(LEFT - REVEAL, y0, z0),
        u: DVec3::new(0.0, y1 - y0, 0.0),
        v: DVec3::new(0.0, 0.0, z1 - z0),
    };
    let sky = Sky {
        zenith: [10.0, 12.4, 16.0],
        horizon: [17.0, 17.2, 17.0],
        ground: [3.4, 3.7, 2.6],
        sun: DVec3::new(-0.66, -0.50, 0.56).normalize(),
        sun_irradiance: [24.0, 20.8, 16.4],
        sun_sine: 0.012,
        glow: 0.0,
    };
    let captures = (0..14).map(|i| {
        let (sin, cos) = num::sin_cos(2.0 * PI * f64::from(i) / 14.0);
        DVec3::new(1.7 * cos + 0.1, 1.55 * sin - 0.4, 1.15 + 0.4 * f64::from(i % 3))
    });
    Layout {
        shapes: s,
        sky,
        opening: Some(opening),
        lamp: Some(lamp),
        stand: TABLE,
        bounds: [DVec3::new(LEFT, FRONT, 0.0), DVec3::new(RIGHT, BACK, CEILING)],
        eye: DVec3::new(0.58, -2.12, 1.30),
        target: DVec3::new(0.02, 0.30, 0.68),
        fov_y_deg: 42.0,
        captures: captures.collect(),
        dome: None,
    }
}

fn shell(s: &mut Shapes) {
    let (w, d) = (RIGHT - LEFT, BACK - FRONT);
    let at = DVec3::new;
    s.flat(at(LEFT, FRONT, 0.0), DVec3::X * w, DVec3::Y * d, Paint::Boards, None);
    let ceiling = Paint::Plaster([0.78, 0.77, 0.74]);
    s.flat(at(LEFT, FRONT, CEILING), DVec3::Y * d, DVec3::X * w, ceiling, None);
    s.flat(at(LEFT, BACK, 0.0), DVec3::X * w, DVec3::Z * CEILING, ACCENT, None);
    s.flat(at(RIGHT, FRONT, 0.0), DVec3::X * -w, DVec3::Z * CEILING, WALL, None);
    s.flat(at(RIGHT, BACK, 0.0), DVec3::Y * -d, DVec3::Z * CEILING, WALL, None);
    // The left wall in four pieces around the window.
    let [[y0, y1], [z0, z1]] = WINDOW;
    let mut piece = |a: [f64; 2], b: [f64; 2]| {
        s.flat(at(LEFT, a[0], a[1]), DVec3::Y * (b[0] - a[0]), DVec3::Z * (b[1] - a[1]), WALL, None);
    };
    piece([FRONT, 0.0], [y0, CEILING]);
    piece([y1, 0.0], [BACK, CEILING]);
    piece([y0, 0.0], [y1, z0]);
    piece([y0, z1], [y1, CEILING]);
    // Skirting boards.
    for (low, high) in [
        ([LEFT, BACK - 0.018, 0.0], [RIGHT, BACK, 0.11]),
        ([LEFT, FRONT, 0.0], [LEFT + 0.018, BACK - 0.018, 0.11]),
        ([RIGHT - 0.018, FRONT, 0.0], [RIGHT, BACK - 0.018, 0.11]),
    ] {
        s.between(low, high, WHITE, false);
    }
}

fn window(s: &mut Shapes) {
    let [[y0, y1], [z0, z1]] = WINDOW;
    let x = LEFT - REVEAL;
    let at = DVec3::new;
    s.flat(at(x, y0, z0), DVec3::X * REVEAL, DVec3::Y * (y1 - y0), WHITE, None);
    s.flat(at(x, y0, z1), DVec3::Y * (y1 - y0), DVec3::X * REVEAL, WHITE, None);
    s.flat(at(x, y0, z0), DVec3::Z * (z1 - z0), DVec3::X * REVEAL, WHITE, None);
    s.flat(at(x, y1, z0), DVec3::X * REVEAL, DVec3::Z * (z1 - z0), WHITE, None);
    // Frame and bars.
    let mut bar = |a: [f64; 2], b: [f64; 2]| {
        s.between([x + 0.03, a[0], a[1]], [x + 0.075, b[0], b[1]], WHITE, false);
    };
    bar([y0, z0], [y1, z0 + 0.055]);
    bar([y0, z1 - 0.055], [y1, z1]);
    bar([y0, z0], [y0 + 0.055, z1]);
    bar([y1 - 0.055, z0], [y1, z1]);
    let middle = 0.5 * (y0 + y1);
    bar([middle - 0.04, z0], [middle + 0.04, z1]);
    for y in [0.5 * (y0 + middle), 0.5 * (middle + y1)] {
        bar([y - 0.013, z0], [y + 0.013, z1]);
    }
    let third = z0 + (z1 - z0) * 0.66;
    bar([y0, third - 0.013], [y1, third + 0.013]);
    s.between([LEFT - 0.01, y0 - 0.06, z0 - 0.04], [LEFT + 0.13, y1 + 0.06, z0], WHITE, false);
    // The view through the window.
    let far = x - 0.35;
    let (low, high) = (DVec3::new(far, y0 - 1.6, z0 - 1.0), DVec3::new(far, y1 + 1.2, z1 + 0.8));
    s.flat(
        DVec3::new(far, low.y, low.z),
        DVec3::Y * (high.y - low.y),
        DVec3::Z * (high.z - low.z),
        Paint::Outside,
        None,
    );
    // Curtains on a rod.
    let rod = Paint::Plain([0.10, 0.085, 0.07]);
    s.between([LEFT + 0.085, y0 - 0.45, z1 + 0.17], [LEFT + 0.105, y1 + 0.50, z1 + 0.19], rod, false);
    for (from, to) in [(y0 - 0.40, y0 - 0.02), (y1 + 0.02, y1 + 0.44)] {
        let edge = |i: usize| {
            let t = i as f64 / 40.0;
            let fold = 0.035 * num::f64::sin(t * 2.0 * PI * 5.0) + 0.01 * num::f64::sin(t * 23.0);
            let y = from + (to - from) * t;
            (DVec3::new(LEFT + 0.10 + 1.3 * fold, y, 0.03), DVec3::new(LEFT + 0.10 + fold, y, z1 + 0.175))
        };
        let edges: Vec<_> = (0..=40).map(edge).collect();
        s.strip(&edges, Paint::Curtain([0.62, 0.57, 0.48]));
    }
}

fn table(s: &mut Shapes) {
    let place = Placement::new(0.0, 0.0, 0.0, 0.0);
    let half = DVec3::new(0.72, 0.42, 0.021);
    s.cuboid(place, DVec3::new(0.0, 0.0, TABLE - half.z), half, OAK, true);
    for (x, y) in [(-0.62, -0.32), (0.62, -0.32), (-0.62, 0.32), (0.62, 0.32)] {
        let leg = DVec3::new(0.028, 0.028, 0.5 * (TABLE - 0.042 - 0.013));
        s.cuboid(place, DVec3::new(x, y, leg.z + 0.0135), leg, OAK, true);
    }
    s.cuboid(place, DVec3::new(0.0, 0.0, 0.17), DVec3::new(0.60, 0.31, 0.011), OAK, true);
    // A stack of volumes and a bowl at one end, magazines below.
    let stack = Placement::new(0.47, 0.19, TABLE, -14.0);
    s.cuboid(stack, DVec3::new(0.0, 0.0, 0.016), DVec3::new(0.13, 0.095, 0.015), Paint::Book(3), true);
    s.cuboid(
        Placement::new(0.475, 0.185, TABLE, 9.0),
        DVec3::new(0.0, 0.0, 0.045),
        DVec3::new(0.115, 0.085, 0.013),
        Paint::Book(1),
        true,
    );
    let below = Placement::new(-0.15, 0.02, 0.182, 8.0);
    s.cuboid(below, DVec3::new(0.0, 0.0, 0.02), DVec3::new(0.15, 0.11, 0.019), Paint::Book(4), false);
    let bowl = [
        [0.0, 0.0],
        [0.045, 0.0],
        [0.05, 0.008],
        [0.09, 0.03],
        [0.118, 0.066],
        [0.113, 0.068],
        [0.085, 0.036],
        [0.045, 0.016],
        [0.0, 0.014],
    ];
    s.revolve(Placement::new(-0.47, 0.17, TABLE, 0.0), &bowl, 28, Paint::Lacquer([0.16, 0.24, 0.25]), true);
    for (x, y, c) in [
        (-0.50, 0.17, [0.45, 0.10, 0.035]),
        (-0.445, 0.15, [0.50, 0.30, 0.05]),
        (-0.46, 0.21, [0.40, 0.08, 0.03]),
    ] {
        let r = 0.036;
        let ball: Vec<[f64; 2]> = (0..=8)
            .map(|i| {
                let (sin, cos) = num::sin_cos(PI * f64::from(i) / 8.0);
                [r * sin, r - r * cos]
            })
            .collect();
        s.revolve(Placement::new(x, y, TABLE + 0.03, 0.0), &ball, 14, Paint::Lacquer(c), false);
    }
}

fn sofa(s: &mut Shapes) {
    let cloth = Paint::Cloth([0.36, 0.33, 0.29]);
    let place = Placement::new(-0.55, 1.72, 0.0, 0.0);
    let v = DVec3::new;
    s.rounded(place, v(0.0, 0.02, 0.20), v(1.02, 0.40, 0.11), 0.03, 0.0, 4, cloth);
    for x in [-0.49, 0.49] {
        s.rounded(place, v(x, -0.05, 0.385), v(0.475, 0.37, 0.085), 0.055, 0.012, 7, cloth);
        s.rounded(place, v(x, 0.26, 0.63), v(0.465, 0.10, 0.22), 0.07, 0.018, 7, cloth);
    }
    for x in [-1.10, 1.10] {
        s.rounded(place, v(x, 0.0, 0.34), v(0.11, 0.43, 0.25), 0.06, 0.006, 6, cloth);
    }
    s.rounded(place, v(0.0, 0.39, 0.42), v(1.10, 0.06, 0.32), 0.05, 0.0, 5, cloth);
    for (x, y) in [(-1.0, -0.3), (1.0, -0.3), (-1.0, 0.3), (1.0, 0.3)] {
        s.cuboid(place, v(x, y, 0.045), v(0.03, 0.03, 0.045), WALNUT, false);
    }
    let leaning = Placement::new(-1.16, 1.74, 0.60, 14.0);
    s.rounded(
        leaning,
        v(0.0, 0.0, 0.03),
        v(0.20, 0.065, 0.19),
        0.05,
        0.03,
        7,
        Paint::Cloth([0.42, 0.17, 0.065]),
    );
    let second = Placement::new(0.12, 1.72, 0.59, -10.0);
    s.rounded(
        second,
        v(0.0, 0.0, 0.03),
        v(0.19, 0.065, 0.18),
        0.05,
        0.03,
        7,
        Paint::Cloth([0.07, 0.15, 0.165]),
    );
    // A throw over the arm.
    let edge = |i: usize| {
        let t = i as f64 / 18.0;
        let turn = PI * (t - 0.5);
        let (x, z) = if t < 0.25 {
            (0.395, 0.22 + 1.44 * t)
        } else if t > 0.75 {
            (0.705, 0.22 + 1.44 * (1.0 - t))
        } else {
            (
                0.55 + 0.155 * num::f64::sin(turn * 2.0).clamp(-1.0, 1.0),
                0.58 + 0.035 * num::f64::cos(turn * 2.0),
            )
        };
        (DVec3::new(x, 1.42, z), DVec3::new(x, 1.80 + 0.015 * num::f64::sin(9.0 * t), z))
    };
    let edges: Vec<_> = (0..=18).rev().map(edge).collect();
    s.strip(&edges, Paint::Cloth([0.56, 0.50, 0.40]));
}

fn shelf(s: &mut Shapes, seed: u64) {
    let (x0, x1, y0, top) = (1.42, 2.52, BACK - 0.33, 2.06);
    for x in [x0, x1] {
        s.between([x - 0.013, y0, 0.0], [x + 0.013, BACK - 0.005, top], WALNUT, true);
    }
    let levels = [0.06, 0.44, 0.82, 1.20, 1.60, top];
    for z in levels {
        s.between([x0 + 0.013, y0, z - 0.022], [x1 - 0.013, BACK - 0.005, z], WALNUT, true);
    }
    let mut k = 0_u64;
    for (row, pair) in levels.windows(2).enumerate() {
        let room = pair[1] - pair[0] - 0.04;
        let mut x = x0 + 0.03;
        while x < x1 - 0.06 {
            k += 1;
            let r = |d: u64| unit(seed, 0x6273, k, d);
            if r(0) < 0.10 {
                x += 0.06 + 0.14 * r(1);
                continue;
            }
            let thick = 0.016 + 0.034 * r(2);
            let tall = (room * (0.62 + 0.36 * r(3))).min(0.33);
            let deep = 0.15 + 0.07 * r(4);
            if row == 3 && (x - x0) > 0.48 && (x - x0) < 0.80 {
                x += 0.05;
                continue;
            }
            let book = Placement::new(x + thick / 2.0, y0 + 0.02 + deep / 2.0, pair[0] + tall / 2.0, 0.0);
            let half = DVec3::new(thick / 2.0 - 0.0008, deep / 2.0, tall / 2.0);
            s.cuboid(book, DVec3::ZERO, half, Paint::Book((r(5) * 1000.0) as u32), false);
            x += thick;
        }
        // The proxy of a row of books is one block, as a capture would mesh it.
        let solid = s.solid();
        let block = s.quads.len();
        s.between(
            [x0 + 0.03, y0 + 0.05, pair[0]],
            [x1 - 0.06, BACK - 0.03, pair[0] + room * 0.8],
            Paint::Hidden,
            false,
        );
        for quad in &mut s.quads[block..] {
            quad.solid = Some(solid);
        }
    }
    // A vase on the free place.
    let vase = [
        [0.0, 0.0],
        [0.045, 0.0],
        [0.075, 0.05],
        [0.085, 0.11],
        [0.065, 0.17],
        [0.03, 0.21],
        [0.026, 0.24],
        [0.036, 0.26],
        [0.030, 0.258],
        [0.0, 0.20],
    ];
    s.revolve(
        Placement::new(x0 + 0.645, y0 + 0.14, levels[3], 0.0),
        &vase,
        28,
        Paint::Lacquer([0.62, 0.60, 0.54]),
        false,
    );
}

fn pictures(s: &mut Shapes) {
    let mut picture = |x: f64, z: f64, w: f64, h: f64, k: u32| {
        let (y, b) = (BACK - 0.022, 0.02);
        s.between(
            [x - w / 2.0 - b, y, z - h / 2.0 - b],
            [x + w / 2.0 + b, BACK - 0.001, z - h / 2.0],
            WALNUT,
            false,
        );
        s.between(
            [x - w / 2.0 - b, y, z + h / 2.0],
            [x + w / 2.0 + b, BACK - 0.001, z + h / 2.0 + b],
            WALNUT,
            false,
        );
        s.between([x - w / 2.0 - b, y, z - h / 2.0], [x - w / 2.0, BACK - 0.001, z + h / 2.0], WALNUT, false);
        s.between([x + w / 2.0, y, z - h / 2.0], [x + w / 2.0 + b, BACK - 0.001, z + h / 2.0], WALNUT, false);
        let corner = DVec3::new(x - w / 2.0, BACK - 0.008, z - h / 2.0);
        s.flat(corner, DVec3::X * w, DVec3::Z * h, Paint::Print(k, [w, h]), None);
    };
    picture(-1.10, 1.52, 0.52, 0.68, 2);
    picture(-0.42, 1.60, 0.44, 0.44, 1);
    picture(0.16, 1.52, 0.42, 0.58, 5);
}

fn lamp(s: &mut Shapes) -> Lamp {
    let place = Placement::new(0.98, 1.86, 0.0, 0.0);
    let metal = Paint::Lacquer([0.10, 0.09, 0.08]);
    s.revolve(
        place,
        &[[0.0, 0.0], [0.14, 0.0], [0.14, 0.018], [0.012, 0.03], [0.012, 1.40], [0.0, 1.40]],
        20,
        metal,
        true,
    );
    let radiance = [7.4, 5.2, 3.0];
    let (radius, height) = (0.185, 0.29);
    s.revolve(
        place,
        &[[radius * 1.02, 1.33], [radius * 0.98, 1.33 + height]],
        28,
        Paint::Glow(radiance),
        false,
    );
    Lamp { base: DVec3::new(0.98, 1.86, 1.33), radius, height, radiance }
}

fn plant(s: &mut Shapes, seed: u64) {
    let (x, y) = (-2.0, 1.72);
    let pot =
        [[0.0, 0.0], [0.13, 0.0], [0.17, 0.14], [0.185, 0.32], [0.165, 0.32], [0.155, 0.27], [0.0, 0.27]];
    s.revolve(Placement::new(x, y, 0.0, 0.0), &pot, 24, Paint::Lacquer([0.52, 0.47, 0.40]), true);
    for i in 0..30_u64 {
        let r = |d: u64| unit(seed, 0x706c, i, d);
        let turn = 2.0 * PI * (i as f64 * 0.382 + 0.1 * r(0));
        let (sin, cos) = num::sin_cos(turn);
        let (out, side) = (DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0));
        let (rise, reach) = (0.75 + 0.75 * r(1), 0.16 + 0.26 * r(2));
        let width = 0.055 + 0.045 * r(3);
        let base = DVec3::new(x, y, 0.27) + out * 0.05 * r(4);
        let edge = |k: usize| {
            let t = k as f64 / 9.0;
            let bend = out * (reach * (0.25 * t + 0.75 * t * t)) + DVec3::Z * (rise * (t - 0.30 * t * t));
            // A stalk for the lower third, then a blade.
            let blade = ((t - 0.32) / 0.68).clamp(0.0, 1.0);
            let w = if blade > 0.0 { width * 2.2 * (blade * (1.0 - blade)).sqrt() + 0.004 } else { 0.005 };
            let keel = DVec3::Z * (0.25 * w);
            (base + bend - side * w + keel, base + bend + side * w + keel)
        };
        let inside = |p: DVec3| DVec3::new(p.x.max(LEFT + 0.03), p.y.min(BACK - 0.03), p.z);
        let edges: Vec<_> = (0..=9).map(edge).map(|(a, b)| (inside(a), inside(b))).collect();
        let green = [0.055 + 0.05 * r(5), 0.15 + 0.07 * r(6), 0.035 + 0.02 * r(7)];
        s.strip(&edges, Paint::Leaf(green));
    }
}

/// Adds the rug, the armchair and the small table at the window.
fn rest(s: &mut Shapes) {
    let v = DVec3::new;
    let (low, high) = ([-1.35, -1.12, 0.0], [1.45, 1.12, 0.013]);
    let size = [high[0] - low[0], high[1] - low[1]];
    s.between(low, high, Paint::Rug(size), true);
    let cloth = Paint::Cloth([0.15, 0.19, 0.14]);
    let chair = Placement::new(1.86, 0.42, 0.0, 62.0);
    s.rounded(chair, v(0.0, 0.0, 0.28), v(0.33, 0.33, 0.10), 0.05, 0.01, 6, cloth);
    s.rounded(chair, v(0.0, -0.02, 0.43), v(0.29, 0.30, 0.07), 0.05, 0.015, 7, cloth);
    s.rounded(chair, v(0.0, -0.32, 0.62), v(0.36, 0.08, 0.34), 0.07, 0.012, 7, cloth);
    for x in [-0.37, 0.37] {
        s.rounded(chair, v(x, -0.01, 0.44), v(0.065, 0.33, 0.16), 0.05, 0.004, 6, cloth);
    }
    for (x, y) in [(-0.3, -0.28), (0.3, -0.28), (-0.3, 0.28), (0.3, 0.28)] {
        s.cuboid(chair, v(x, y, 0.09), v(0.02, 0.02, 0.09), OAK, false);
    }
}
