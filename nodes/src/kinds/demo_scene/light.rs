//! Light in a demo scene: sun, sky through an opening or overhead, a lamp, and interreflection. Direct light is
//! sampled at every point; indirect light is cached at scattered points and interpolated.

use std::f64::consts::PI;

use engine::{Context, NodeError};
use glam::DVec3;
use scene::math::num;

use super::cast::Caster;
use super::random::unit;
use super::shape::Quad;

/// Linear RGB.
pub(super) type Rgb = [f64; 3];

pub(super) fn add(a: Rgb, b: Rgb, scale: f64) -> Rgb {
    [0, 1, 2].map(|i| a[i] + b[i] * scale)
}

pub(super) fn times(a: Rgb, b: Rgb) -> Rgb {
    [0, 1, 2].map(|i| a[i] * b[i])
}

/// Rectangular opening to the sky; `u` x `v` points into the room.
#[derive(Debug, Clone, Copy)]
pub(super) struct Opening {
    pub corner: DVec3,
    pub u: DVec3,
    pub v: DVec3,
}

/// A glowing upright cylinder.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lamp {
    pub base: DVec3,
    pub radius: f64,
    pub height: f64,
    pub radiance: Rgb,
}

/// Sky and surroundings of the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sky {
    pub zenith: Rgb,
    pub horizon: Rgb,
    pub ground: Rgb,
    /// Unit direction to the sun.
    pub sun: DVec3,
    /// Irradiance on a plane that faces the sun.
    pub sun_irradiance: Rgb,
    /// Sine of the angular radius of the sun.
    pub sun_sine: f64,
    /// Additional radiance of the sky around the sun.
    pub glow: f64,
}

impl Sky {
    /// Radiance from a direction, without the disc of the sun.
    pub(super) fn radiance(&self, d: DVec3) -> Rgb {
        if d.z < 0.0 {
            return self.ground;
        }
        let t = d.z.sqrt();
        let base = [0, 1, 2].map(|i| self.horizon[i] * (1.0 - t) + self.zenith[i] * t);
        let near = d.dot(self.sun).max(0.0);
        let near4 = near * near * near * near;
        let lobe = near4 * near4;
        let corona = lobe * lobe * lobe * lobe;
        add(base, [1.0, 0.93, 0.8], self.glow * (0.25 * lobe + corona))
    }

    /// Radiance with the disc of the sun.
    pub(super) fn with_sun(&self, d: DVec3) -> Rgb {
        let sky = self.radiance(d);
        let sine2 = self.sun_sine * self.sun_sine;
        let inside = d.dot(self.sun) > (1.0 - sine2).sqrt();
        if inside { add(sky, self.sun_irradiance, 1.0 / (PI * sine2)) } else { sky }
    }
}

/// Number of rays for each source of light.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effort {
    pub sky: usize,
    pub sun: usize,
    pub lamp: usize,
}

/// A scene with its light.
pub(super) struct Lit<'a> {
    pub quads: &'a [Quad],
    pub caster: Caster,
    pub sky: Sky,
    pub opening: Option<Opening>,
    pub lamp: Option<Lamp>,
    pub seed: u64,
    cache: Cache,
}

/// Maximum distance over which light is traced, in metres.
const FAR: f64 = 200.0;
/// Offset of ray origins from a surface, in metres. A bilinear quad is intersected as two triangles, which
/// deviate from it by a few millimetres.
const OFF: f64 = 4e-3;

impl<'a> Lit<'a> {
    /// Prepares ray casting and computes the interreflected light.
    pub(super) fn new(
        quads: &'a [Quad],
        sky: Sky,
        opening: Option<Opening>,
        lamp: Option<Lamp>,
        seed: u64,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let caster = Caster::new(quads);
        let mut lit = Self { quads, caster, sky, opening, lamp, seed, cache: Cache::default() };
        lit.cache = Cache::scatter(&lit, cx)?;
        Ok(lit)
    }

    /// Direct irradiance from sun, sky and lamp. `key` selects the random numbers.
    pub(super) fn direct(&self, p: DVec3, n: DVec3, key: u64, effort: Effort) -> Rgb {
        let from = p + n * OFF;
        let mut sum = [0.0; 3];
        let random = |i: usize, d: u64| unit(self.seed, 0x6c69 + d, key, i as u64);
        let side = (effort.sky as f64).sqrt().ceil().max(1.0) as usize;
        if let Some(Opening { corner, u, v }) = self.opening {
            let (inward, total) = (u.cross(v), (side * side) as f64);
            for i in 0..side * side {
                let s = ((i % side) as f64 + random(i, 0)) / side as f64;
                let t = ((i / side) as f64 + random(i, 1)) / side as f64;
                let way = corner + u * s + v * t - from;
                let d2 = way.length_squared();
                let toward = way / d2.sqrt();
                let (facing, seen) = (n.dot(toward), -inward.dot(toward));
                if facing > 0.0 && seen > 0.0 && !self.caster.blocked(from, toward, FAR) {
                    sum = add(sum, self.sky.radiance(toward), facing * seen / d2 / total);
                }
            }
        } else {
            let (a, b) = frame(n);
            for i in 0..side * side {
                let toward = cosine(
                    n,
                    a,
                    b,
                    ((i % side) as f64 + random(i, 0)) / side as f64,
                    ((i / side) as f64 + random(i, 1)) / side as f64,
                );
                if !self.caster.blocked(from, toward, FAR) {
                    sum = add(sum, self.sky.radiance(toward), PI / (side * side) as f64);
                }
            }
        }
        if n.dot(self.sky.sun) > 0.0 {
            let (a, b) = frame(self.sky.sun);
            let open = (0..effort.sun).filter(|&i| {
                let (r, turn) = (random(i, 2).sqrt() * self.sky.sun_sine, 2.0 * PI * random(i, 3));
                let (sin, cos) = num::sin_cos(turn);
                let toward = (self.sky.sun + a * (r * cos) + b * (r * sin)).normalize();
                !self.caster.blocked(from, toward, FAR)
            });
            let share = open.count() as f64 / effort.sun.max(1) as f64;
            sum = add(sum, self.sky.sun_irradiance, n.dot(self.sky.sun) * share);
        }
        if let Some(lamp) = self.lamp {
            for i in 0..effort.lamp {
                let turn = 2.0 * PI * (i as f64 + random(i, 4)) / effort.lamp as f64;
                let (sin, cos) = num::sin_cos(turn);
                let out = DVec3::new(cos, sin, 0.0);
                let on = lamp.base + out * lamp.radius + DVec3::Z * (lamp.height * random(i, 5));
                let way = on - from;
                let d2 = way.length_squared().max(0.01);
                let toward = way / way.length().max(1e-9);
                let (facing, seen) = (n.dot(toward), -out.dot(toward));
                let reach = way.length() - 0.03;
                if facing > 0.0 && seen > 0.0 && reach > 0.0 && !self.caster.blocked(from, toward, reach) {
                    let area = 2.0 * PI * lamp.radius * lamp.height / effort.lamp as f64;
                    sum = add(sum, lamp.radiance, facing * seen / d2 * area);
                }
            }
        }
        sum
    }

    /// Irradiance at a point from light that other surfaces reflect.
    pub(super) fn indirect(&self, p: DVec3, n: DVec3) -> Rgb {
        self.cache.at(p, n, |point| point.indirect)
    }

    /// Radiance along a ray. All light at the hit is taken from the cache.
    pub(super) fn rough_radiance(&self, from: DVec3, toward: DVec3) -> Rgb {
        let Some(hit) = self.caster.nearest(from, toward, FAR) else {
            return self.beyond(from, toward);
        };
        let quad = &self.quads[hit.quad as usize];
        let (p, mut n) = (quad.point(hit.u, hit.v), quad.normal(hit.u, hit.v));
        if n.dot(toward) > 0.0 {
            n = -n;
        }
        let light = self.cache.at(p, n, |point| add(point.direct, point.indirect, 1.0));
        let albedo = quad.paint.look(self.seed, quad.texture(hit.u, hit.v)).albedo;
        add(quad.paint.glow(), times(albedo, light), 1.0 / PI)
    }

    /// Radiance along a ray. Direct light is sampled at the hit.
    pub(super) fn radiance(&self, from: DVec3, toward: DVec3, key: u64, effort: Effort) -> Rgb {
        let Some(hit) = self.caster.nearest(from, toward, FAR) else {
            return self.beyond(from, toward);
        };
        let quad = &self.quads[hit.quad as usize];
        self.surface(quad, hit.u, hit.v, toward, key, effort)
    }

    /// Radiance of a surface point, without specular reflection.
    pub(super) fn surface(
        &self,
        quad: &Quad,
        u: f64,
        v: f64,
        toward: DVec3,
        key: u64,
        effort: Effort,
    ) -> Rgb {
        let albedo = quad.paint.look(self.seed, quad.texture(u, v)).albedo;
        let light = self.received(quad, u, v, toward, key, effort);
        add(quad.paint.glow(), times(albedo, light), 1.0 / PI)
    }

    /// Irradiance at a surface point that is seen along `toward`. Thin sheets also receive light from behind.
    pub(super) fn received(
        &self,
        quad: &Quad,
        u: f64,
        v: f64,
        toward: DVec3,
        key: u64,
        effort: Effort,
    ) -> Rgb {
        let (p, mut n) = (quad.point(u, v), quad.normal(u, v));
        if n.dot(toward) > 0.0 {
            n = -n;
        }
        let one = |n: DVec3, key: u64| add(self.direct(p, n, key, effort), self.indirect(p, n), 1.0);
        if quad.paint.is_thin() {
            let (front, back) = (one(n, key), one(-n, key ^ 0x5555));
            add(front.map(|v| v * 0.6), back, 0.4)
        } else {
            one(n, key)
        }
    }

    /// Radiance that arrives at a point from outside the scene, without the disc of the sun.
    pub(super) fn beyond(&self, from: DVec3, toward: DVec3) -> Rgb {
        if let Some(Opening { corner, u, v }) = self.opening {
            // A ray that passes between two triangles of a closed room does not reach light from outside.
            let inward = u.cross(v);
            let t = (corner - from).dot(inward) / toward.dot(inward);
            let on = from + toward * t - corner;
            let (s, r) = (on.dot(u) / u.length_squared(), on.dot(v) / v.length_squared());
            if !(t > 0.0 && (-0.2..=1.2).contains(&s) && (-0.2..=1.2).contains(&r)) {
                return [0.0; 3];
            }
        }
        self.sky.radiance(toward)
    }

    /// True if a surface blocks the view from a point in a direction to the sky.
    pub(super) fn hidden(&self, from: DVec3, toward: DVec3) -> bool {
        self.caster.blocked(from, toward, FAR)
    }
}

/// Two unit vectors that make a right-handed frame with the unit vector `n` (Duff and others, Building
/// an Orthonormal Basis, Revisited, 2017).
pub(super) fn frame(n: DVec3) -> (DVec3, DVec3) {
    let sign = if n.z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), DVec3::new(b, sign + n.y * n.y * a, -n.y))
}

fn cosine(n: DVec3, a: DVec3, b: DVec3, s: f64, t: f64) -> DVec3 {
    let (sin, cos) = num::sin_cos(2.0 * PI * s);
    let r = t.sqrt();
    (a * (r * cos) + b * (r * sin) + n * (1.0 - t).max(0.0).sqrt()).normalize()
}

#[derive(Debug, Clone, Copy)]
struct Point {
    p: DVec3,
    n: DVec3,
    albedo: Rgb,
    direct: Rgb,
    indirect: Rgb,
}

/// Light at scattered points of the surfaces, with a grid to find the points near a position.
#[derive(Default)]
struct Cache {
    points: Vec<Point>,
    low: DVec3,
    size: [usize; 3],
    /// Index in `order` of the first point of each cell. The points of a cell are
    /// `order[starts[cell]..starts[cell + 1]]`.
    starts: Vec<u32>,
    order: Vec<u32>,
    /// Positions and normals in the order of `order`, so that a search reads memory in sequence.
    ordered: Vec<(DVec3, DVec3)>,
}

/// Distance between points of the cache, in metres.
const SPACING: f64 = 0.10;
/// Radius within which points of the cache are averaged, in metres.
const RADIUS: f64 = 0.26;
/// Square root of the number of rays that gather light at each point. The rays are stratified over a square.
const GATHER: usize = 8;
/// Number of bounces of light.
const BOUNCES: usize = 4;

impl Cache {
    fn scatter(lit: &Lit<'_>, cx: &Context) -> Result<Self, NodeError> {
        let mut places = Vec::new();
        for (q, quad) in lit.quads.iter().enumerate().filter(|(_, quad)| quad.paint.is_solid()) {
            let [a, b] = quad.lengths();
            let (nu, nv) = ((a / SPACING).ceil().max(1.0) as usize, (b / SPACING).ceil().max(1.0) as usize);
            for i in 0..nu * nv {
                let key = places.len() as u64;
                // Small quads keep only as many points as their area requires.
                let keep = a * b / (nu * nv) as f64 / (SPACING * SPACING);
                if unit(lit.seed, 0x6b65, key + q as u64 * 7919, 0) < keep.max(0.05) * 1.5 {
                    let u = ((i % nu) as f64 + 0.2 + 0.6 * unit(lit.seed, 0x7075, key, i as u64)) / nu as f64;
                    let v = ((i / nu) as f64 + 0.2 + 0.6 * unit(lit.seed, 0x7076, key, i as u64)) / nv as f64;
                    places.push((q, u, v, false));
                    if quad.paint.is_thin() {
                        places.push((q, u, v, true));
                    }
                }
            }
        }
        let effort = Effort { sky: 16, sun: 4, lamp: 6 };
        let chunk = 256;
        let made = cx.for_each_tile(places.len().div_ceil(chunk), |c| {
            let range = c * chunk..((c + 1) * chunk).min(places.len());
            range
                .map(|i| {
                    let (q, u, v, back) = places[i];
                    let quad = &lit.quads[q];
                    let (p, n) = (quad.point(u, v), quad.normal(u, v));
                    let n = if back { -n } else { n };
                    let direct = lit.direct(p, n, 0x1000_0000 + i as u64, effort);
                    let albedo = quad.paint.look(lit.seed, quad.texture(u, v)).albedo;
                    Point { p, n, albedo, direct, indirect: [0.0; 3] }
                })
                .collect::<Vec<_>>()
        })?;
        let mut cache = Self { points: made.into_iter().flatten().collect(), ..Self::default() };
        cache.index();
        cache.bounce(lit, cx)?;
        Ok(cache)
    }

    /// Builds the grid of cells.
    fn index(&mut self) {
        let (mut low, mut high) = (DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY));
        for point in &self.points {
            low = low.min(point.p);
            high = high.max(point.p);
        }
        self.low = low;
        self.size = [0, 1, 2].map(|i| ((high[i] - low[i]) / RADIUS).max(0.0) as usize + 1);
        let cells = self.size.iter().product::<usize>();
        let cell_of: Vec<usize> = self.points.iter().map(|point| self.cell(self.place(point.p))).collect();
        self.starts = vec![0; cells + 1];
        for &cell in &cell_of {
            self.starts[cell + 1] += 1;
        }
        for cell in 0..cells {
            self.starts[cell + 1] += self.starts[cell];
        }
        let mut next = self.starts.clone();
        self.order = vec![0; self.points.len()];
        for (i, &cell) in cell_of.iter().enumerate() {
            self.order[next[cell] as usize] = i as u32;
            next[cell] += 1;
        }
        let of = |&i: &u32| (self.points[i as usize].p, self.points[i as usize].n);
        self.ordered = self.order.iter().map(of).collect();
    }

    fn place(&self, p: DVec3) -> [usize; 3] {
        [0, 1, 2].map(|i| (((p[i] - self.low[i]) / RADIUS).max(0.0) as usize).min(self.size[i] - 1))
    }

    fn cell(&self, at: [usize; 3]) -> usize {
        (at[2] * self.size[1] + at[1]) * self.size[0] + at[0]
    }

    /// Mean over the points around `p` with a similar normal on the same surface.
    fn at(&self, p: DVec3, n: DVec3, value: impl Fn(&Point) -> Rgb) -> Rgb {
        let (mut sum, mut weights) = ([0.0; 3], 0.0);
        let (middle, reach) = (self.place(p), reach_above(0.0));
        let range = |i: usize| middle[i].saturating_sub(1)..(middle[i] + 2).min(self.size[i]);
        for (z, y) in range(2).flat_map(|z| range(1).map(move |y| (z, y))) {
            let row = range(0);
            let (first, last) = (self.cell([row.start, y, z]), self.cell([row.end - 1, y, z]));
            let cells = self.starts[first] as usize..self.starts[last + 1] as usize;
            for (i, (at, normal)) in self.order[cells.clone()].iter().zip(&self.ordered[cells]) {
                if p.distance_squared(*at) > reach {
                    continue;
                }
                let weight = closeness((p, n), (*at, *normal));
                if weight > 0.0 {
                    sum = add(sum, value(&self.points[*i as usize]), weight);
                    weights += weight;
                }
            }
        }
        if weights > 0.0 { sum.map(|v| v / weights) } else { [0.0; 3] }
    }

    fn bounce(&mut self, lit: &Lit<'_>, cx: &Context) -> Result<(), NodeError> {
        let chunk = 64;
        let rays = GATHER * GATHER;
        // The point of the cache that each gathering ray hits; none for rays that leave the scene.
        let seen = cx.for_each_tile(self.points.len().div_ceil(chunk), |c| {
            let range = c * chunk..((c + 1) * chunk).min(self.points.len());
            let mut found = Vec::with_capacity(range.len() * rays);
            for i in range {
                let Point { p, n, .. } = self.points[i];
                let (a, b) = frame(n);
                for k in 0..rays {
                    let random = |d: u64| unit(lit.seed, 0x6761 + d, i as u64, k as u64);
                    let s = ((k % GATHER) as f64 + random(0)) / GATHER as f64;
                    let t = ((k / GATHER) as f64 + random(1)) / GATHER as f64;
                    let toward = cosine(n, a, b, s, t);
                    let hit = lit.caster.nearest(p + n * OFF, toward, FAR);
                    found.push(hit.map_or(u32::MAX, |hit| {
                        let quad = &lit.quads[hit.quad as usize];
                        let m = quad.normal(hit.u, hit.v);
                        let m = if m.dot(toward) > 0.0 { -m } else { m };
                        self.nearest(quad.point(hit.u, hit.v), m)
                    }));
                }
            }
            found
        })?;
        let seen: Vec<u32> = seen.into_iter().flatten().collect();
        for _ in 0..BOUNCES {
            cx.check()?;
            let radiosity: Vec<Rgb> = self
                .points
                .iter()
                .map(|point| times(point.albedo, add(point.direct, point.indirect, 1.0)))
                .collect();
            for (point, seen) in self.points.iter_mut().zip(seen.chunks_exact(rays)) {
                let lit = seen.iter().filter_map(|&i| radiosity.get(i as usize));
                point.indirect = lit.fold([0.0; 3], |sum, r| add(sum, *r, 1.0 / rays as f64));
            }
        }
        Ok(())
    }

    /// Index of the point with the largest weight at `p`. Of equal weights, the first point counts. `u32::MAX` if no point
    /// is near.
    fn nearest(&self, p: DVec3, n: DVec3) -> u32 {
        let middle = self.place(p);
        // Squared distance to the cells before, around and after `p` along each axis; a little less, for rounding.
        let gaps = [0, 1, 2].map(|i| {
            let start = self.low[i] + middle[i] as f64 * RADIUS;
            let squared = |gap: f64| {
                let least = (gap - 1e-9).max(0.0);
                least * least
            };
            let before = if middle[i] > 0 { squared(p[i] - start) } else { f64::INFINITY };
            let is_last = middle[i] + 1 == self.size[i];
            let after = if is_last { f64::INFINITY } else { squared(start + RADIUS - p[i]) };
            [before, 0.0, after]
        });
        let (mut best, mut slot, mut reach) = (0.0, usize::MAX, reach_above(0.0));
        for [x, y, z] in OUTWARD {
            if gaps[0][x] + gaps[1][y] + gaps[2][z] > reach {
                continue;
            }
            let cell = self.cell([middle[0] + x - 1, middle[1] + y - 1, middle[2] + z - 1]);
            let slots = self.starts[cell] as usize..self.starts[cell + 1] as usize;
            for (at, (point, normal)) in slots.clone().zip(&self.ordered[slots]) {
                if p.distance_squared(*point) > reach {
                    continue;
                }
                let weight = closeness((p, n), (*point, *normal));
                if weight > best || (weight == best && weight > 0.0 && at < slot) {
                    (best, slot, reach) = (weight, at, reach_above(weight));
                }
            }
        }
        self.order.get(slot).copied().unwrap_or(u32::MAX)
    }
}

/// Offsets by -1, 0 and 1 (as 0, 1 and 2) to a cell and the 26 cells around it, the nearest first.
const OUTWARD: [[usize; 3]; 27] = {
    let (mut out, mut filled, mut apart) = ([[0; 3]; 27], 0, 0);
    while apart <= 3 {
        let mut i = 0;
        while i < 27 {
            let [x, y, z] = [i % 3, i / 3 % 3, i / 9];
            if (x != 1) as usize + (y != 1) as usize + (z != 1) as usize == apart {
                out[filled] = [x, y, z];
                filled += 1;
            }
            i += 1;
        }
        apart += 1;
    }
    out
};

/// Square of the distance beyond which no point has a weight of more than `least`; a little more, for rounding.
fn reach_above(least: f64) -> f64 {
    2.0 * RADIUS * RADIUS * (1.0 - least.sqrt().sqrt()).max(0.0) + 1e-9
}

/// Weight of a point of the cache, given by position and normal, for the light at `p` on a surface with the normal `n`.
/// It is at most the fourth power of 1 - the squared distance / (2 [`RADIUS`]^2).
fn closeness((p, n): (DVec3, DVec3), (at, normal): (DVec3, DVec3)) -> f64 {
    let way = p - at;
    let near = 1.0 - way.length_squared() / (2.0 * RADIUS * RADIUS);
    if near <= 0.0 {
        return 0.0;
    }
    // Points with another orientation or on another surface count only if there are no better ones.
    let alike = n.dot(normal).max(0.03);
    let off = (1.0 - 4.0 * way.dot(n).abs() / RADIUS).max(0.02);
    let near = near * near;
    near * near * alike * alike * alike * off
}
