//! Surfaces of a demo place: bilinear quads, alone or arranged as boxes, rounded boxes and solids of
//! revolution.

use std::f64::consts::PI;

use glam::DVec3;
use scene::math::num;

use super::paint::Paint;

/// Bilinear quad. Its corners run counter-clockwise as seen from its front.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quad {
    /// Corners at (u, v) = (0, 0), (1, 0), (1, 1), (0, 1), in metres.
    pub p: [DVec3; 4],
    /// Unit shading normals at the corners.
    pub n: [DVec3; 4],
    /// Texture coordinates at the corners, in metres.
    pub uv: [[f64; 2]; 4],
    /// Material of the quad.
    pub paint: Paint,
    /// Index of the closed solid of the proxy to which the quad belongs. `None` if the quad is not part of the
    /// proxy.
    pub solid: Option<u32>,
    /// True if the proxy may divide the quad into smaller quads.
    pub divide: bool,
}

fn mix(q: &[DVec3; 4], u: f64, v: f64) -> DVec3 {
    (q[0] * (1.0 - u) + q[1] * u) * (1.0 - v) + (q[3] * (1.0 - u) + q[2] * u) * v
}

impl Quad {
    pub(super) fn point(&self, u: f64, v: f64) -> DVec3 {
        mix(&self.p, u, v)
    }

    pub(super) fn normal(&self, u: f64, v: f64) -> DVec3 {
        mix(&self.n, u, v).normalize_or(self.n[0])
    }

    pub(super) fn texture(&self, u: f64, v: f64) -> [f64; 2] {
        [0, 1].map(|c| {
            let [a, b, d, e] = self.uv.map(|uv| uv[c]);
            (a * (1.0 - u) + b * u) * (1.0 - v) + (e * (1.0 - u) + d * u) * v
        })
    }

    /// Mean lengths along u and v, in metres.
    pub(super) fn lengths(&self) -> [f64; 2] {
        let side = |a: usize, b: usize| (self.p[a] - self.p[b]).length();
        [0.5 * (side(0, 1) + side(3, 2)), 0.5 * (side(0, 3) + side(1, 2))]
    }
}

/// Placement by a rotation about the vertical axis, followed by a translation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placement {
    sin_cos: (f64, f64),
    at: DVec3,
}

impl Placement {
    pub(super) fn new(x: f64, y: f64, z: f64, yaw_deg: f64) -> Self {
        Self { sin_cos: num::sin_cos(yaw_deg * PI / 180.0), at: DVec3::new(x, y, z) }
    }

    fn turn(&self, v: DVec3) -> DVec3 {
        let (s, c) = self.sin_cos;
        DVec3::new(c * v.x - s * v.y, s * v.x + c * v.y, v.z)
    }

    pub(super) fn point(&self, v: DVec3) -> DVec3 {
        self.turn(v) + self.at
    }
}

/// Builder of the quads of a scene. Solids are numbered in the order in which they are added.
#[derive(Default)]
pub(super) struct Shapes {
    pub quads: Vec<Quad>,
    solids: u32,
}

/// For each face of a box: its axes u and v, for which u x v points outwards, and the direction from the centre of
/// the box to the face.
const FACES: [([f64; 3], [f64; 3], [f64; 3]); 6] = [
    ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
    ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
    ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]),
    ([-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]),
    ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]),
    ([0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]),
];

impl Shapes {
    pub(super) fn solid(&mut self) -> u32 {
        self.solids += 1;
        self.solids
    }

    /// Adds a flat parallelogram with corner `p` and sides `u` and `v`. Its front faces in the direction u x v.
    pub(super) fn flat(&mut self, p: DVec3, u: DVec3, v: DVec3, paint: Paint, solid: Option<u32>) {
        let n = u.cross(v).normalize_or(DVec3::Z);
        let (lu, lv) = (u.length(), v.length());
        self.quads.push(Quad {
            p: [p, p + u, p + u + v, p + v],
            n: [n; 4],
            uv: [[0.0, 0.0], [lu, 0.0], [lu, lv], [0.0, lv]],
            paint,
            solid,
            divide: true,
        });
    }

    /// Adds a box with the half extents `half` around `centre`, transformed by `place`.
    pub(super) fn cuboid(&mut self, place: Placement, centre: DVec3, half: DVec3, paint: Paint, proxy: bool) {
        let solid = proxy.then(|| self.solid());
        for (u, v, n) in FACES {
            let (u, v, n) = (DVec3::from(u) * half, DVec3::from(v) * half, DVec3::from(n) * half);
            let corner = place.point(centre + n - u - v);
            self.flat(corner, place.turn(2.0 * u), place.turn(2.0 * v), paint, solid);
        }
    }

    /// Adds a box given by two corners, without rotation.
    pub(super) fn between(&mut self, low: [f64; 3], high: [f64; 3], paint: Paint, proxy: bool) {
        let (low, high) = (DVec3::from(low), DVec3::from(high));
        let place = Placement::new(0.0, 0.0, 0.0, 0.0);
        self.cuboid(place, (low + high) * 0.5, (high - low) * 0.5, paint, proxy);
    }

    /// Adds a box whose edges are rounded by `radius`, with `n` x `n` quads per face. `puff` makes the faces
    /// bulge.
    #[allow(clippy::too_many_arguments, reason = "a shape is defined by this many numbers")]
    pub(super) fn rounded(
        &mut self,
        place: Placement,
        centre: DVec3,
        half: DVec3,
        radius: f64,
        puff: f64,
        n: usize,
        paint: Paint,
    ) {
        let solid = Some(self.solid());
        let inner = (half - DVec3::splat(radius)).max(DVec3::splat(1e-4));
        let bend = |q: DVec3| {
            let core = q.clamp(-inner, inner);
            let normal = (q - core).normalize_or(DVec3::Z);
            let flat = DVec3::ONE - (q / half) * (q / half);
            let swell = flat.x.max(0.0) * flat.y.max(0.0)
                + flat.y.max(0.0) * flat.z.max(0.0)
                + flat.z.max(0.0) * flat.x.max(0.0);
            (core + normal * (radius + puff * swell), normal)
        };
        // Quads are narrow where the surface bends and wide where it is flat.
        let stop = |i: usize| {
            let t = i as f64 / n as f64 * 2.0 - 1.0;
            0.5 * t * (3.0 - t * t)
        };
        for (fu, fv, fn_) in FACES {
            let (fu, fv, fn_) = (DVec3::from(fu) * half, DVec3::from(fv) * half, DVec3::from(fn_) * half);
            let scale = [2.0 * fu.length(), 2.0 * fv.length()];
            for i in 0..n {
                for j in 0..n {
                    let corner = |a: usize, b: usize| bend(fn_ + fu * stop(a) + fv * stop(b));
                    let corners = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                    let at = |a: usize, b: usize| {
                        [(stop(a) + 1.0) * 0.5 * scale[0], (stop(b) + 1.0) * 0.5 * scale[1]]
                    };
                    self.quads.push(Quad {
                        p: corners.map(|(p, _)| place.point(p + centre)),
                        n: corners.map(|(_, n)| place.turn(n)),
                        uv: [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)],
                        paint,
                        solid,
                        divide: false,
                    });
                }
            }
        }
    }

    /// Adds a solid of revolution about the vertical axis through the origin of `place`. `profile` lists (radius,
    /// height) from bottom to top. A radius of 0 closes an end.
    pub(super) fn revolve(
        &mut self,
        place: Placement,
        profile: &[[f64; 2]],
        turns: usize,
        paint: Paint,
        proxy: bool,
    ) {
        let solid = proxy.then(|| self.solid());
        let slope = |a: [f64; 2], b: [f64; 2]| {
            let (dr, dz) = (b[0] - a[0], b[1] - a[1]);
            [dz, -dr].map(|c| c / (dr * dr + dz * dz).sqrt().max(1e-12))
        };
        let around = |k: usize| num::sin_cos(2.0 * PI * (k % turns) as f64 / turns as f64);
        let mut along = 0.0;
        for pair in profile.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let normal = slope(a, b);
            let length = ((b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1])).sqrt();
            for k in 0..turns {
                let on = |ring: [f64; 2], k: usize| {
                    let (s, c) = around(k);
                    place.point(DVec3::new(ring[0] * c, ring[0] * s, ring[1]))
                };
                let facing = |k: usize| {
                    let (s, c) = around(k);
                    place.turn(DVec3::new(normal[0] * c, normal[0] * s, normal[1]))
                };
                let width = |i: usize| i as f64 * 2.0 * PI * a[0].max(b[0]) / turns as f64;
                self.quads.push(Quad {
                    p: [on(a, k), on(a, k + 1), on(b, k + 1), on(b, k)],
                    n: [facing(k), facing(k + 1), facing(k + 1), facing(k)],
                    uv: [
                        [width(k), along],
                        [width(k + 1), along],
                        [width(k + 1), along + length],
                        [width(k), along + length],
                    ],
                    paint,
                    solid,
                    divide: false,
                });
            }
            along += length;
        }
    }

    /// Adds a strip through pairs of points, lit from both sides, for leaves and curtains.
    pub(super) fn strip(&mut self, edges: &[(DVec3, DVec3)], paint: Paint) {
        let mut along = 0.0;
        for pair in edges.windows(2) {
            let ((a, b), (d, c)) = (pair[0], pair[1]);
            let n = (b - a).cross(d - a).normalize_or(DVec3::Z);
            let (width, length) = ((b - a).length(), (d - a).length());
            self.quads.push(Quad {
                p: [a, b, c, d],
                n: [n; 4],
                uv: [[0.0, along], [width, along], [width, along + length], [0.0, along + length]],
                paint,
                solid: None,
                divide: false,
            });
            along += length;
        }
        // Neighbours share their normals, so that the strip looks bent rather than folded.
        let first = self.quads.len() + 1 - edges.len();
        let flat: Vec<DVec3> = self.quads[first..].iter().map(|quad| quad.n[0]).collect();
        for (i, quad) in self.quads[first..].iter_mut().enumerate() {
            let before = (flat[i] + flat[i.saturating_sub(1)]).normalize_or(flat[i]);
            let after = (flat[i] + flat[(i + 1).min(flat.len() - 1)]).normalize_or(flat[i]);
            quad.n = [before, before, after, after];
        }
    }
}
