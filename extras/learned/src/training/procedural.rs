//! Procedural panoramas: skies with sun, clouds or overcast, nights with a moon or lamps, rooms with windows and
//! lamps, and studios. The energy of their lights is consistent with the brightness of the surfaces that they
//! light, since the amount of hidden light is learned from these surfaces.

use std::f64::consts::{PI, TAU};

use engine::Up;
use glam::{DVec2, DVec3};
use render::geometry::sampling::{hash, unit};
use scene::math::equirect::{direction, pixel_solid_angle};
use scene::math::num;
use scene::types::{Image, Linear};

use super::truth::WIDTH;

/// Stream of random numbers, keyed by seed and index.
struct Chance {
    key: u32,
    count: u32,
}

impl Chance {
    fn next(&mut self) -> f64 {
        self.count += 1;
        f64::from(unit(hash(self.key, self.count)))
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    /// Random number between `low` and `high` whose logarithm is uniformly distributed.
    fn ratio(&mut self, low: f64, high: f64) -> f64 {
        num::f64::exp2(self.between(num::f64::log2(low), num::f64::log2(high)))
    }

    fn tint(&mut self, strength: f64) -> DVec3 {
        let warm = self.between(-strength, strength);
        DVec3::new(num::f64::exp2(warm), 1.0, num::f64::exp2(-1.3 * warm))
    }

    fn toward(&mut self, elevation_deg: (f64, f64)) -> DVec3 {
        let (sin, cos) = num::sin_cos(self.between(elevation_deg.0, elevation_deg.1).to_radians());
        let (y, x) = num::sin_cos(self.between(0.0, TAU));
        DVec3::new(x * cos, y * cos, sin)
    }
}

/// Smooth noise at a point, with a standard deviation of about 1: lattice noise of four octaves.
fn noise(key: u32, p: DVec3) -> f64 {
    let octave = |(sum, size, p): (f64, f64, DVec3), octave: u32| {
        let (cell, part) = (p.floor(), p - p.floor());
        let smooth = part * part * (DVec3::splat(3.0) - 2.0 * part);
        let corner = |x: i32, y: i32, z: i32| {
            let at = |v: f64, step: i32| (v as i32).wrapping_add(step) as u32;
            let key = hash(hash(key, octave), hash(at(cell.x, x), hash(at(cell.y, y), at(cell.z, z))));
            f64::from(unit(key)) * 2.0 - 1.0
        };
        let along = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let row = |y, z| along(corner(0, y, z), corner(1, y, z), smooth.x);
        let plane = |z| along(row(0, z), row(1, z), smooth.y);
        (sum + size * along(plane(0), plane(1), smooth.z), size * 0.6, p * 2.03)
    };
    (0..4).fold((0.0, 1.5, p), octave).0
}

/// Fills a panorama with the colour of each direction. Up is +z.
fn paint(colour: impl Fn(DVec3) -> DVec3) -> Image<Linear> {
    let (width, height) = (WIDTH, WIDTH / 2);
    let pixel = |i: usize| {
        let (u, v) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        colour(direction(Up::PlusZ, u / width as f64, v / height as f64)).to_array().map(|v| v as f32)
    };
    Image::from_samples(width, height, 3, (0..width * height).flat_map(pixel).collect())
}

/// Adds a light with a Gaussian profile of the given angular radius. `irradiance` is the irradiance on a plane that
/// faces the light.
fn add_disc(image: &mut Image<Linear>, toward: DVec3, radius: f64, irradiance: DVec3) {
    let (width, height) = (image.width, image.height);
    let fall = |x: usize, y: usize| {
        let at = direction(Up::PlusZ, (x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64);
        let angle = num::f64::acos(at.dot(toward).clamp(-1.0, 1.0)) / radius;
        if angle > 4.0 { 0.0 } else { num::f64::exp(-angle * angle) }
    };
    let mut total = 0.0;
    for y in 0..height {
        total += (0..width).map(|x| fall(x, y)).sum::<f64>() * pixel_solid_angle(width, height, y);
    }
    for y in 0..height {
        for x in 0..width {
            let scale = fall(x, y) / total.max(1e-12);
            for (to, light) in image.pixel_mut(x, y).iter_mut().zip(irradiance.to_array()) {
                *to += (light * scale) as f32;
            }
        }
    }
}

/// Sky above ground: clear, cloudy, overcast or at night.
fn outdoors(chance: &mut Chance) -> Image<Linear> {
    let key = chance.key;
    let night = chance.next() < 0.2;
    let cover = chance.next();
    let sun = chance.toward((2.0, 75.0));
    let blue = DVec3::new(0.25, 0.45, 1.0) * chance.between(0.5, 1.0);
    let haze = DVec3::new(0.8, 0.9, 1.0) * chance.between(0.6, 1.8);
    let power = chance.between(0.3, 0.8);
    let (glow, glow_deg) = (chance.ratio(0.3, 12.0), chance.between(3.0, 20.0));
    let warm = chance.tint(0.15) * DVec3::new(1.0, 0.93, 0.8);
    let (grey, edge) = (chance.between(0.5, 1.8), chance.between(2.0, 6.0));
    // Clouds are where the noise exceeds this.
    let level = 2.0 - 4.0 * cover;
    let veiled = noise(key ^ 1, sun * 3.0) > level;
    let cloud = |d: DVec3| 1.0 / (1.0 + num::f64::exp(-edge * (noise(key ^ 1, d * 3.0) - level)));
    let sky = |d: DVec3| {
        let t = num::pow(d.z.clamp(0.0, 1.0), power);
        let angle = num::f64::acos(d.dot(sun).clamp(-1.0, 1.0)).to_degrees();
        let near = glow * num::f64::exp(-angle / glow_deg);
        let clear = haze * (1.0 - t) + blue * t + warm * near;
        let white = DVec3::splat(grey * (1.0 + 1.5 * num::f64::exp(-angle / 25.0)))
            * (1.0 + 0.3 * noise(key ^ 2, d * 6.0)).max(0.2);
        clear.lerp(white, cloud(d).clamp(0.0, 1.0))
    };
    let ambient = PI * 0.5 * (sky(DVec3::Z) + sky(DVec3::new(0.7, 0.5, 0.5).normalize()));
    // A clear sun gives a plane that faces it about six times the light of the sky; clouds remove most of it.
    let direct = if veiled { chance.ratio(0.003, 0.5) } else { chance.ratio(1.5, 8.0) };
    let direct = warm * (ambient.y * direct * if night { 0.3 } else { 1.0 });
    let albedo = DVec3::new(chance.between(0.05, 0.4), chance.between(0.05, 0.4), chance.between(0.04, 0.3));
    let snow = if chance.next() < 0.1 { 2.0 } else { 1.0 };
    let shade = chance.between(-1.0, 2.5);
    let (skyline, rough) = (chance.between(-0.1, 0.25), chance.between(0.0, 0.15));
    let dark = if night { 0.02 } else { 1.0 };
    let mut image = paint(|d| {
        let around = DVec3::new(d.x, d.y, 0.0).try_normalize().unwrap_or(DVec3::X);
        let ridge = skyline + rough * noise(key ^ 3, around * 4.0);
        if d.z > ridge.max(0.0) {
            return sky(d) * dark;
        }
        let lit = if noise(key ^ 4, d * 5.0) > shade { 0.0 } else { sun.z };
        let facing = if d.z > 0.0 { 0.5 } else { 1.0 };
        let stain = (1.0 + 0.35 * noise(key ^ 5, d * 9.0)).max(0.1) * snow;
        (albedo * (ambient * facing + direct * lit) * (stain / PI)).min(ambient * 0.4 + direct) * dark
    });
    add_disc(&mut image, sun, chance.between(0.5_f64, 1.0).to_radians(), direct * dark);
    if night || chance.next() < 0.05 {
        for _ in 0..(1.0 + chance.next() * 12.0) as usize {
            let (toward, radius) = (chance.toward((-4.0, 20.0)), chance.ratio(0.5, 2.5).to_radians());
            let lamp = chance.tint(0.5) * (ambient.y * dark * chance.ratio(0.05, 5.0));
            add_disc(&mut image, toward, radius, lamp);
        }
    }
    image
}

/// A light in a room: a rectangle on a wall, or a ball.
struct Lamp {
    at: DVec3,
    /// Half width and half height of a rectangle on the wall with index `wall`, or the radius of a ball.
    half: DVec2,
    wall: Option<usize>,
    radiance: DVec3,
}

/// Room or studio: a box, lights on its walls and in it, and light reflected by the walls.
fn indoors(chance: &mut Chance) -> Image<Linear> {
    let key = chance.key;
    let studio = chance.next() < 0.35;
    // Distances from the eye to the walls: -x, +x, -y, +y, -z, +z.
    let reach: [f64; 6] = std::array::from_fn(|i| match i {
        4 => chance.between(0.9, 1.7),
        5 => chance.between(0.8, 3.0),
        _ => chance.ratio(1.2, 7.0),
    });
    let base = if studio { chance.between(0.03, 0.5) } else { chance.between(0.25, 0.75) };
    let albedo: [DVec3; 6] = std::array::from_fn(|i| {
        let floor = i == 4;
        let level =
            if floor && studio && chance.next() < 0.5 { 0.8 } else { base * chance.between(0.6, 1.2) };
        chance.tint(if floor { 0.4 } else { 0.15 }) * level.min(0.85)
    });
    let normal = |wall: usize| {
        let axis = [DVec3::X, DVec3::Y, DVec3::Z][wall / 2];
        if wall.is_multiple_of(2) { axis } else { -axis }
    };
    let mut lamps = Vec::new();
    let windows = if studio { 0 } else { (chance.next() * 4.0) as usize };
    for _ in 0..windows {
        let wall = (chance.next() * 4.0) as usize;
        let (along, half) =
            (chance.between(-0.7, 0.7), DVec2::new(chance.between(0.2, 1.3), chance.between(0.3, 0.9)));
        let mut at = -normal(wall) * reach[wall];
        at[1 - wall / 2] = along * reach[2 * (1 - wall / 2)];
        at.z = chance.between(-0.1, 0.6) * reach[5];
        let radiance = DVec3::new(0.9, 1.0, 1.15) * chance.ratio(3.0, 60.0);
        lamps.push(Lamp { at, half, wall: Some(wall), radiance });
    }
    let count = if studio {
        1.0 + chance.next() * 3.0
    } else {
        chance.next() * 7.0 + f64::from(u8::from(windows == 0))
    };
    for _ in 0..count as usize {
        let size = if studio { chance.ratio(0.15, 0.7) } else { chance.ratio(0.04, 0.3) };
        let radiance =
            chance.tint(if studio { 0.1 } else { 0.4 }) * chance.ratio(20.0, 600.0) * (0.1 / size).min(2.0);
        if chance.next() < 0.4 {
            let at = DVec3::new(
                chance.between(-0.8, 0.8) * reach[0],
                chance.between(-0.8, 0.8) * reach[2],
                reach[5],
            );
            lamps.push(Lamp {
                at,
                half: DVec2::new(size, size * chance.ratio(0.5, 4.0)),
                wall: Some(5),
                radiance,
            });
        } else {
            let far = chance.between(0.4, 0.9) * reach[0].min(reach[1]).min(reach[2]).min(reach[3]);
            let at = chance.toward((-5.0, 60.0)) * far.max(3.0 * size);
            lamps.push(Lamp { at, half: DVec2::splat(size), wall: None, radiance });
        }
    }
    let area = |lamp: &Lamp| {
        if lamp.wall.is_some() { 4.0 * lamp.half.x * lamp.half.y } else { PI * lamp.half.x * lamp.half.x }
    };
    // Interreflection between the walls, as in an integrating sphere.
    let (w, d, h) = (reach[0] + reach[1], reach[2] + reach[3], reach[4] + reach[5]);
    let surface = 2.0 * (w * d + w * h + d * h);
    let mean = albedo.iter().copied().sum::<DVec3>() / 6.0;
    let flux: DVec3 =
        lamps.iter().map(|l| l.radiance * (area(l) * if l.wall.is_some() { PI } else { 4.0 * PI })).sum();
    let ambient = flux * mean / ((DVec3::ONE - mean) * surface);
    let mut image = paint(|d| {
        let hit = (0..6).map(|wall| (reach[wall] / -d.dot(normal(wall)), wall)).filter(|(t, _)| *t > 0.0);
        let (distance, wall) = hit.fold((f64::INFINITY, 0), |a, b| if b.0 < a.0 { b } else { a });
        let p = d * distance.min(1e3);
        let on = |lamp: &&Lamp| {
            let off = (p - lamp.at).abs();
            let (across, up) = match wall / 2 {
                0 => (off.y, off.z),
                1 => (off.x, off.z),
                _ => (off.x, off.y),
            };
            lamp.wall == Some(wall) && across < lamp.half.x && up < lamp.half.y
        };
        if let Some(lamp) = lamps.iter().find(on) {
            let view = if wall < 4 { (1.0 + 0.6 * noise(key ^ 7, p * 2.0)).max(0.15) } else { 1.0 };
            return lamp.radiance * view;
        }
        let direct = lamps.iter().map(|lamp| {
            let (away, n) = (lamp.at - p, normal(wall));
            let r2 = away.length_squared() + area(lamp);
            let facing = away.dot(n).max(0.0) / r2.sqrt();
            let emits = lamp.wall.map_or(1.0, |w| (-away).dot(normal(w)).max(0.0) / r2.sqrt());
            lamp.radiance * (area(lamp) * facing * emits / r2)
        });
        let stain = (1.0 + 0.25 * noise(key ^ 8, p * 2.5)).max(0.1);
        albedo[wall] * (direct.sum::<DVec3>() / PI + ambient / mean.max(DVec3::splat(0.01)) * 0.5) * stain
    });
    for lamp in lamps.iter().filter(|lamp| lamp.wall.is_none()) {
        let distance = lamp.at.length().max(2.0 * lamp.half.x);
        let solid_angle = PI * lamp.half.x * lamp.half.x / (distance * distance);
        add_disc(
            &mut image,
            lamp.at.normalize_or(DVec3::Z),
            (lamp.half.x / distance).max(0.008),
            lamp.radiance * solid_angle,
        );
    }
    image
}

/// Makes the procedural panorama with the given index, for the given seed.
pub fn panorama(seed: u64, index: u32) -> Image<Linear> {
    let mut chance = Chance { key: hash(hash(seed as u32, (seed >> 32) as u32), index), count: 0 };
    if index.is_multiple_of(2) { outdoors(&mut chance) } else { indoors(&mut chance) }
}
