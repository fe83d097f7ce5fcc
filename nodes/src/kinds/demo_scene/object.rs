//! The object to insert: a glazed vase, a brass ball and a clay ball on a wooden plinth. Coordinates follow glTF: y
//! is up, the unit is the metre, and the foot of the object is at the origin.

use std::f64::consts::PI;

use glam::DVec3;
use scene::math::num;
use scene::types::{Material, NormalMap, Object, Primitive, Sampler, Texture, TextureRef, Wrap};

use super::random::{fractal, noise};

const SIZE: usize = 256;

/// Builds the object: the vase and the two balls on the plinth.
pub(super) fn still_life(seed: u64) -> Object {
    let textures = vec![
        picture(|u, v| glaze(seed, u, v)),
        relief(1.6, |u, v| throwing_rings(seed, u, v)),
        picture(|u, v| timber(seed, u, v)),
        relief(2.2, |u, v| fibres(seed, u, v)),
        picture(|u, v| {
            // glTF: green is roughness, blue is metalness.
            let worn = (0.46 + 0.5 * fibres(seed, u, v)).clamp(0.2, 0.9);
            [1.0, worn, 0.0]
        }),
    ];
    let texture = |index| {
        let sampler = Sampler { wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false };
        Some(TextureRef { texture: index, uv_set: 0, sampler, transform: None })
    };
    let bumps = |index, scale| texture(index).map(|texture| NormalMap { texture, scale });
    let plain = |name: &str, colour: [f32; 3], metallic, roughness| Material {
        name: name.to_owned(),
        base_colour: [colour[0], colour[1], colour[2], 1.0],
        metallic,
        roughness,
        ..Material::default()
    };
    let materials = vec![
        Material {
            base_colour_texture: texture(0),
            normal: bumps(1, 0.35),
            ..plain("glazed ceramic", [1.0; 3], 0.0, 0.12)
        },
        plain("brass", [0.91, 0.70, 0.36], 1.0, 0.24),
        plain("clay", [0.52, 0.185, 0.085], 0.0, 0.85),
        Material {
            base_colour_texture: texture(2),
            normal: bumps(3, 0.6),
            metallic_roughness_texture: texture(4),
            ..plain("walnut", [1.0; 3], 0.0, 0.9)
        },
    ];
    let plinth = 0.055;
    let ball = |r: f64| -> Vec<[f64; 2]> {
        (0..=32)
            .map(|i| {
                let (sin, cos) = num::sin_cos(PI * f64::from(i) / 32.0);
                [if i % 32 == 0 { 0.0 } else { r * sin }, r - r * cos]
            })
            .collect()
    };
    let primitives = vec![
        turned(&smooth(&VASE, 5), DVec3::new(-0.075, plinth, -0.03), 96, 0),
        turned(&ball(0.072), DVec3::new(0.115, plinth, 0.045), 64, 1),
        turned(&ball(0.038), DVec3::new(0.005, plinth, 0.115), 48, 2),
        block(DVec3::new(0.24, plinth, 0.17), 0.006, 3),
    ];
    Object { primitives, materials, textures }
}

/// Profile of the vase as pairs of radius and height: the outside from the foot to the lip, then a short way down
/// the inside.
const VASE: [[f64; 2]; 16] = [
    [0.0, 0.0],
    [0.046, 0.0],
    [0.052, 0.004],
    [0.056, 0.016],
    [0.078, 0.060],
    [0.101, 0.115],
    [0.112, 0.175],
    [0.106, 0.230],
    [0.082, 0.282],
    [0.052, 0.322],
    [0.037, 0.358],
    [0.034, 0.392],
    [0.044, 0.424],
    [0.056, 0.438],
    [0.052, 0.440],
    [0.028, 0.390],
];

/// Catmull-Rom spline through the points, with `parts` segments between neighbouring points.
fn smooth(points: &[[f64; 2]], parts: usize) -> Vec<[f64; 2]> {
    let at = |i: isize| points[i.clamp(0, points.len() as isize - 1) as usize];
    let mut out = Vec::new();
    for i in 0..points.len() as isize - 1 {
        let (a, b, c, d) = (at(i - 1), at(i), at(i + 1), at(i + 2));
        for k in 0..parts {
            let t = k as f64 / parts as f64;
            out.push([0, 1].map(|j| {
                let cubic = 2.0 * b[j]
                    + (c[j] - a[j]) * t
                    + (2.0 * a[j] - 5.0 * b[j] + 4.0 * c[j] - d[j]) * t * t
                    + (3.0 * b[j] - a[j] - 3.0 * c[j] + d[j]) * t * t * t;
                (0.5 * cubic).max(0.0)
            }));
        }
    }
    out.push(points[points.len() - 1]);
    out
}

fn single(v: DVec3) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

/// Solid of revolution about the y axis. `profile` runs from bottom to top.
fn turned(profile: &[[f64; 2]], foot: DVec3, turns: usize, material: u32) -> Primitive {
    let mut p = Primitive { material, ..Primitive::default() };
    let last = profile.len() - 1;
    let mut along = 0.0;
    let girth = profile.iter().fold(0.0_f64, |m, q| m.max(q[0])) * 2.0 * PI;
    for (i, &[r, y]) in profile.iter().enumerate() {
        let (before, after) = (profile[i.saturating_sub(1)], profile[(i + 1).min(last)]);
        let (dr, dy) = (after[0] - before[0], after[1] - before[1]);
        along += if i == 0 { 0.0 } else { DVec3::new(r - before[0], y - before[1], 0.0).length() };
        for k in 0..=turns {
            let (sin, cos) = num::sin_cos(2.0 * PI * (k % turns) as f64 / turns as f64);
            // Seen from above with y up, the rotation runs from z to x, so that u grows to the right.
            let out = DVec3::new(sin, 0.0, cos);
            p.positions.push(single(foot + out * r + DVec3::Y * y));
            p.normals.push(single((out * dy - DVec3::Y * dr).normalize_or(DVec3::Y)));
            p.tangents.push([cos as f32, 0.0, -sin as f32, 1.0]);
            p.uv0.push([k as f32 / turns as f32, (1.0 - along / girth) as f32]);
        }
    }
    let row = turns as u32 + 1;
    for i in 0..last as u32 {
        for k in 0..turns as u32 {
            let (a, b) = (i * row + k, (i + 1) * row + k);
            if profile[i as usize][0] > 0.0 {
                p.triangles.push([a, a + 1, b + 1]);
            }
            if profile[i as usize + 1][0] > 0.0 {
                p.triangles.push([a, b + 1, b]);
            }
        }
    }
    p
}

/// Block with bevelled upper edges. `half` gives half of its width and depth, and its height.
fn block(half: DVec3, bevel: f64, material: u32) -> Primitive {
    let mut p = Primitive { material, ..Primitive::default() };
    let (w, h, d) = (half.x, half.y, half.z);
    let v = DVec3::new;
    let mut face = |corners: [DVec3; 4]| {
        let n = (corners[1] - corners[0]).cross(corners[3] - corners[0]).normalize_or(DVec3::Y);
        let along = (corners[1] - corners[0]).normalize_or(DVec3::X);
        let across = n.cross(along);
        let first = p.positions.len() as u32;
        for corner in corners {
            let (s, t) = (corner.dot(along), corner.dot(across));
            p.positions.push(single(corner));
            p.normals.push(single(n));
            // v grows downwards in a texture.
            p.tangents.push([along.x as f32, along.y as f32, along.z as f32, 1.0]);
            p.uv0.push([(s / 0.5) as f32, (-t / 0.5) as f32]);
        }
        p.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    };
    let low = [v(-w, 0.0, d), v(w, 0.0, d), v(w, 0.0, -d), v(-w, 0.0, -d)];
    let edge = low.map(|c| v(c.x, h - bevel, c.z));
    let top = low.map(|c| v(c.x - c.x.signum() * bevel, h, c.z - c.z.signum() * bevel));
    face(top);
    for i in 0..4 {
        let j = (i + 1) % 4;
        face([low[i], low[j], edge[j], edge[i]]);
        face([edge[i], edge[j], top[j], top[i]]);
    }
    face([low[3], low[2], low[1], low[0]]);
    p
}

fn texture(mut pixel: impl FnMut(f64, f64) -> [u8; 3]) -> Texture {
    let mut rgba = Vec::with_capacity(SIZE * SIZE * 4);
    for y in 0..SIZE {
        for x in 0..SIZE {
            rgba.extend(pixel((x as f64 + 0.5) / SIZE as f64, (y as f64 + 0.5) / SIZE as f64));
            rgba.push(255);
        }
    }
    Texture { width: SIZE as u32, height: SIZE as u32, rgba }
}

fn byte(v: f64) -> u8 {
    (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

fn picture(colour: impl Fn(f64, f64) -> [f64; 3]) -> Texture {
    texture(|u, v| colour(u, v).map(byte))
}

/// Tangent-space normal map of a height field.
fn relief(strength: f64, height: impl Fn(f64, f64) -> f64) -> Texture {
    let step = 1.0 / SIZE as f64;
    texture(|u, v| {
        let du = (height(u + step, v) - height(u - step, v)) * strength;
        // v grows downwards and the bitangent upwards.
        let dv = (height(u, v + step) - height(u, v - step)) * strength;
        let n = DVec3::new(-du, dv, 1.0).normalize_or(DVec3::Z) * 0.5 + DVec3::splat(0.5);
        [byte(n.x), byte(n.y), byte(n.z)]
    })
}

/// Value at `u` of a periodic version of `f`, which blends `f(u)` with `f(u - 1)`. Textures wrap around, so their
/// values must be periodic.
fn wrapped(u: f64, f: impl Fn(f64) -> f64) -> f64 {
    let u = u - u.floor();
    f(u) * (1.0 - u) + f(u - 1.0) * u
}

/// Display colour of the glaze: celadon over a darker body, with a band of drips below the shoulder.
fn glaze(seed: u64, u: f64, v: f64) -> [f64; 3] {
    let run = wrapped(u, |u| fractal(seed + 70, u * 9.0, 0.5)) * 0.16;
    let cloud = wrapped(u, |u| fractal(seed + 71, u * 6.0, v * 8.0));
    let speck = wrapped(u, |u| noise(seed + 72, u * 90.0, v * 90.0));
    let edge = ((v - 0.47 - run) * 22.0).clamp(0.0, 1.0);
    let upper = [0.30, 0.53, 0.55].map(|c| c + 0.10 * cloud);
    let lower = [0.76, 0.72, 0.63].map(|c| c + 0.05 * cloud);
    let drop = if speck > 0.72 { -0.16 } else { 0.0 };
    [0, 1, 2].map(|i| upper[i] * (1.0 - edge) + (lower[i] + drop) * edge)
}

fn throwing_rings(seed: u64, u: f64, v: f64) -> f64 {
    let wander = wrapped(u, |u| noise(seed + 73, u * 3.0, v * 3.0));
    num::f64::sin((v * 24.0 + 0.5 * wander) * 2.0 * PI) / 30.0
}

fn fibres(seed: u64, u: f64, v: f64) -> f64 {
    let warp = 0.25 * noise(seed + 74, u * 2.0, v * 3.0);
    fractal(seed + 75, u * 5.0, (v + warp * 0.2) * 60.0) * 0.5
}

fn timber(seed: u64, u: f64, v: f64) -> [f64; 3] {
    let warp = 0.10 * noise(seed + 76, u * 1.5, v * 3.0);
    let rings = num::f64::sin((v + warp) * 42.0) * 0.5 + 0.5;
    let tone = 0.72 + 0.30 * rings + 0.55 * fibres(seed, u, v);
    [0.52, 0.36, 0.25].map(|c| c * tone)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_object_is_consistent_and_stands_on_its_foot() {
        let object = still_life(7);
        let mut lowest = f32::INFINITY;
        for primitive in &object.primitives {
            assert!(primitive.is_consistent() && !primitive.triangles.is_empty());
            assert!((primitive.material as usize) < object.materials.len());
            for (p, n) in primitive.positions.iter().zip(&primitive.normals) {
                assert!(p.iter().chain(n).all(|v| v.is_finite()));
                lowest = lowest.min(p[1]);
            }
        }
        assert_eq!(lowest, 0.0);
    }

    // The winding agrees with the shading normals, and normal maps have the right orientation: tangent, bitangent
    // and normal are those of the texture coordinates.
    #[test]
    fn winding_and_tangents_agree_with_normals() {
        for primitive in &still_life(7).primitives {
            let at = |i: u32| DVec3::from(primitive.positions[i as usize].map(f64::from));
            for [a, b, c] in &primitive.triangles {
                let cross = (at(*b) - at(*a)).cross(at(*c) - at(*a));
                let n = DVec3::from(primitive.normals[*a as usize].map(f64::from));
                if cross.length() < 1e-9 {
                    continue;
                }
                assert!(cross.normalize().dot(n) > -0.3, "{cross} {n}");
                let uv = |i: u32| primitive.uv0[i as usize].map(f64::from);
                let ([u0, v0], [u1, v1], [u2, v2]) = (uv(*a), uv(*b), uv(*c));
                let det = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0);
                if det.abs() > 1e-6 {
                    let du = ((at(*b) - at(*a)) * (v2 - v0) - (at(*c) - at(*a)) * (v1 - v0)) / det;
                    let [x, y, z, sign] = primitive.tangents[*a as usize].map(f64::from);
                    let tangent = DVec3::new(x, y, z);
                    assert!(du.normalize_or(tangent).dot(tangent) > 0.5, "{du} {tangent}");
                    let dv = ((at(*c) - at(*a)) * (u1 - u0) - (at(*b) - at(*a)) * (u2 - u0)) / det;
                    // glTF: the bitangent is cross(normal, tangent) * w and points against v.
                    assert!(dv.dot(n.cross(tangent) * sign) < 0.0, "{dv}");
                }
            }
        }
    }
}
