//! Appearance of the surfaces of a demo scene: procedural albedo, gloss and emission.

use super::random::{fractal, noise, unit};

/// Material of a surface. Colours are linear albedo, and texture coordinates are in metres on the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Paint {
    /// One colour.
    Plain([f64; 3]),
    /// One colour under a reflective varnish.
    Lacquer([f64; 3]),
    /// Rolled wall paint or rough plaster.
    Plaster([f64; 3]),
    /// Oak floor boards along v.
    Boards,
    /// Sawn and oiled wood of the given tone, with grain along the longer side.
    Wood([f64; 3]),
    /// A woven rug of the given size.
    Rug([f64; 2]),
    /// Woven cloth.
    Cloth([f64; 3]),
    /// The spine of a book.
    Book(u32),
    /// An abstract print of the given size.
    Print(u32, [f64; 2]),
    /// A leaf, lit from both sides.
    Leaf([f64; 3]),
    /// A curtain, lit from both sides.
    Curtain([f64; 3]),
    /// A lamp shade that glows with the given radiance.
    Glow([f64; 3]),
    /// View through a window, which shows only the sky.
    Outside,
    /// A surface that exists in the proxy only.
    Hidden,
    /// Stone slabs.
    Slabs,
    /// Bricks.
    Bricks,
    /// Water in a basin.
    Water,
}

/// Mirror-like reflection by a coating.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gloss {
    /// Reflectance at normal incidence.
    pub f0: f64,
    /// Half width of the lobe, as the tangent of an angle.
    pub spread: f64,
}

/// Appearance of a point of a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Appearance {
    pub albedo: [f64; 3],
    pub gloss: Option<Gloss>,
}

fn scaled(c: [f64; 3], by: f64) -> [f64; 3] {
    c.map(|v| (v * by).clamp(0.0, 0.92))
}

fn mixed(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    let t = t.clamp(0.0, 1.0);
    [0, 1, 2].map(|i| a[i] * (1.0 - t) + b[i] * t)
}

/// Profile of a groove: 1 within `width` of a multiple of `period`, falling to 0 over another `width`.
fn groove(x: f64, period: f64, width: f64) -> f64 {
    let t = x / period;
    let away = (t - (t + 0.5).floor()).abs() * period;
    (2.0 - away / width).clamp(0.0, 1.0)
}

fn grain(seed: u64, along: f64, across: f64) -> f64 {
    let warp = 0.04 * noise(seed + 7, along * 1.3, across * 4.0);
    fractal(seed, along * 1.6, (across + warp) * 38.0) * 0.7
        + fractal(seed + 3, along * 9.0, across * 210.0) * 0.3
}

impl Paint {
    /// True for thin sheets that are lit from both sides.
    pub(super) fn is_thin(self) -> bool {
        matches!(self, Paint::Leaf(_) | Paint::Curtain(_))
    }

    /// True if rays hit the surface.
    pub(super) fn is_solid(self) -> bool {
        !matches!(self, Paint::Outside | Paint::Hidden)
    }

    /// Emitted radiance.
    pub(super) fn glow(self) -> [f64; 3] {
        if let Paint::Glow(radiance) = self { radiance } else { [0.0; 3] }
    }

    /// Appearance at the texture coordinates (u, v), in metres.
    pub(super) fn look(self, seed: u64, [u, v]: [f64; 2]) -> Appearance {
        let matte = |albedo| Appearance { albedo, gloss: None };
        match self {
            Paint::Plain(c) => matte(c),
            Paint::Lacquer(c) => Appearance { albedo: c, gloss: Some(Gloss { f0: 0.05, spread: 0.06 }) },
            Paint::Plaster(c) => matte(scaled(
                c,
                1.0 + 0.05 * fractal(seed, u * 3.0, v * 3.0) + 0.03 * fractal(seed, u * 40.0, v * 40.0),
            )),
            Paint::Boards => boards(seed, u, v),
            Paint::Wood(c) => Appearance {
                albedo: scaled(c, 1.0 + 0.30 * grain(seed + 11, u, v)),
                gloss: Some(Gloss { f0: 0.04, spread: 0.12 }),
            },
            Paint::Rug(size) => matte(rug(seed, u, v, size)),
            Paint::Cloth(c) => {
                let weave = groove(u, 0.012, 0.0022).max(groove(v, 0.012, 0.0022));
                matte(scaled(c, 1.0 + 0.16 * fractal(seed, u * 16.0, v * 16.0) - 0.13 * weave))
            }
            Paint::Book(k) => matte(book(k, u, v)),
            Paint::Print(k, size) => Appearance {
                albedo: print(k, u / size[0], v / size[1]),
                gloss: Some(Gloss { f0: 0.04, spread: 0.02 }),
            },
            Paint::Leaf(c) => {
                matte(scaled(c, 0.85 + 0.4 * noise(seed, u * 20.0, v * 9.0) + 0.25 * groove(u, 0.5, 0.004)))
            }
            Paint::Curtain(c) => matte(scaled(c, 1.0 + 0.05 * fractal(seed, u * 30.0, v * 5.0))),
            Paint::Glow(_) | Paint::Outside | Paint::Hidden => matte([0.6, 0.55, 0.45]),
            Paint::Slabs => slabs(seed, u, v),
            Paint::Bricks => matte(bricks(seed, u, v)),
            Paint::Water => {
                Appearance { albedo: [0.02, 0.06, 0.07], gloss: Some(Gloss { f0: 0.06, spread: 0.03 }) }
            }
        }
    }
}

fn boards(seed: u64, u: f64, v: f64) -> Appearance {
    let (width, length) = (0.145, 1.9);
    let row = (u / width).floor();
    let shift = unit(seed, 21, row as i64 as u64, 0) * length;
    let board = ((v + shift) / length).floor();
    let key = (row as i64 as u64).wrapping_mul(977) ^ (board as i64 as u64);
    let tone = 0.82 + 0.36 * unit(seed, 22, key, 0);
    let warm = unit(seed, 23, key, 0);
    let base = mixed([0.30, 0.165, 0.075], [0.235, 0.135, 0.07], warm);
    let grain = grain(key, v, u + 7.0 * warm);
    let gap = groove(u, width, 0.0016).max(groove(v + shift, length, 0.0016));
    Appearance {
        albedo: scaled(base, tone * (1.0 + 0.28 * grain) * (1.0 - 0.6 * gap)),
        gloss: Some(Gloss { f0: 0.045, spread: 0.09 }),
    }
}

fn rug(seed: u64, u: f64, v: f64, size: [f64; 2]) -> [f64; 3] {
    let edge = u.min(size[0] - u).min(v).min(size[1] - v);
    let (x, y) = ((u - size[0] / 2.0).abs(), (v - size[1] / 2.0).abs());
    let (cream, blue, rust, navy) =
        ([0.52, 0.44, 0.33], [0.075, 0.14, 0.21], [0.36, 0.095, 0.05], [0.03, 0.045, 0.085]);
    let colour = if edge < 0.035 {
        navy
    } else if edge < 0.07 {
        cream
    } else if edge < 0.22 {
        // A running border of small diamonds.
        let along = if v.min(size[1] - v) < 0.22 { x } else { y };
        let across = (edge - 0.145).abs();
        let t = along / 0.15;
        let diamond = (t - t.floor() - 0.5).abs() * 0.15 + across;
        if diamond < 0.028 {
            cream
        } else if diamond < 0.048 {
            navy
        } else {
            rust
        }
    } else if edge < 0.25 {
        cream
    } else {
        let medallion = x / (size[0] * 0.33) + y / (size[1] * 0.40);
        let t = (x + y) / 0.16;
        let lattice = (t - t.floor() - 0.5).abs();
        if medallion < 0.32 {
            if medallion < 0.17 { rust } else { cream }
        } else if medallion < 0.86 {
            if medallion > 0.78 {
                cream
            } else if lattice < 0.09 {
                rust
            } else {
                blue
            }
        } else if lattice < 0.07 {
            cream
        } else {
            rust
        }
    };
    let wool = 1.0 + 0.22 * fractal(seed + 5, u * 60.0, v * 60.0) + 0.1 * fractal(seed + 6, u * 4.0, v * 4.0);
    scaled(colour, wool * (1.0 - 0.12 * groove(v, 0.014, 0.002)))
}

const COVERS: [[f64; 3]; 9] = [
    [0.33, 0.06, 0.045],
    [0.05, 0.11, 0.20],
    [0.10, 0.20, 0.12],
    [0.55, 0.42, 0.20],
    [0.58, 0.54, 0.46],
    [0.06, 0.06, 0.07],
    [0.28, 0.15, 0.09],
    [0.16, 0.22, 0.27],
    [0.42, 0.20, 0.09],
];

fn book(k: u32, u: f64, v: f64) -> [f64; 3] {
    let cover = COVERS[k as usize % COVERS.len()];
    let pick = unit(17, 31, k.into(), 0);
    let band = |at: f64, width: f64| (v - at).abs() < width;
    let title =
        band(0.045 + 0.02 * pick, 0.004) || band(0.15, 0.011 * pick) || (pick > 0.5 && band(0.19, 0.003));
    let tone = 0.85 + 0.3 * unit(17, 32, k.into(), 0);
    if title && u > 0.004 {
        mixed(scaled(cover, tone), [0.62, 0.52, 0.30], 0.75)
    } else {
        scaled(cover, tone)
    }
}

fn print(k: u32, u: f64, v: f64) -> [f64; 3] {
    let margin = u.min(1.0 - u).min(v).min(1.0 - v);
    if margin < 0.11 {
        return [0.76, 0.74, 0.69];
    }
    let hill = |i: f64| 0.16 + 0.13 * i + 0.10 * noise(u64::from(k) + 40, u * (2.6 - 0.3 * i), i * 3.7);
    let (sun_x, sun_y) = (0.35 + 0.3 * unit(5, 41, k.into(), 0), 0.66);
    let sun = ((u - sun_x) * (u - sun_x) + (v - sun_y) * (v - sun_y) * 1.6).sqrt();
    let sky = if k.is_multiple_of(2) { [0.66, 0.50, 0.34] } else { [0.42, 0.54, 0.56] };
    let layers = if k.is_multiple_of(2) {
        [[0.07, 0.11, 0.13], [0.17, 0.22, 0.20], [0.40, 0.23, 0.13], [0.58, 0.36, 0.20]]
    } else {
        [[0.05, 0.09, 0.07], [0.11, 0.19, 0.15], [0.22, 0.31, 0.27], [0.34, 0.44, 0.42]]
    };
    for (i, colour) in layers.iter().enumerate() {
        if v < hill(i as f64) {
            return scaled(*colour, 1.0 + 0.2 * fractal(k.into(), u * 25.0, v * 25.0));
        }
    }
    if sun < 0.09 { [0.80, 0.42, 0.16] } else { scaled(sky, 0.92 + 0.25 * v) }
}

fn slabs(seed: u64, u: f64, v: f64) -> Appearance {
    let size = 0.62;
    let row = (v / size).floor();
    let u = u + if (row as i64).rem_euclid(2) == 1 { size / 2.0 } else { 0.0 };
    let key = ((u / size).floor() as i64 as u64).wrapping_mul(131) ^ (row as i64 as u64);
    let tone = 0.85 + 0.3 * unit(seed, 51, key, 0);
    let warm = unit(seed, 52, key, 0);
    let joint = groove(u, size, 0.006).max(groove(v, size, 0.006));
    let stain = 1.0 + 0.25 * fractal(seed + 9, u * 2.2, v * 2.2) + 0.13 * fractal(key, u * 24.0, v * 24.0);
    let stone = mixed([0.38, 0.34, 0.28], [0.33, 0.31, 0.285], warm);
    Appearance { albedo: mixed(scaled(stone, tone * stain), [0.09, 0.085, 0.06], joint), gloss: None }
}

fn bricks(seed: u64, u: f64, v: f64) -> [f64; 3] {
    let (width, height) = (0.235, 0.078);
    let row = (v / height).floor();
    let u = u + if (row as i64).rem_euclid(2) == 1 { width / 2.0 } else { 0.0 };
    let key = ((u / width).floor() as i64 as u64).wrapping_mul(733) ^ (row as i64 as u64);
    let joint = groove(u, width, 0.005).max(groove(v, height, 0.005));
    let tone = 0.75 + 0.5 * unit(seed, 61, key, 0);
    let clay = mixed([0.34, 0.125, 0.075], [0.24, 0.11, 0.08], unit(seed, 62, key, 0));
    let rough = 1.0 + 0.22 * fractal(key, u * 40.0, v * 40.0);
    mixed(scaled(clay, tone * rough), [0.42, 0.39, 0.34], joint)
}
