//! Proxy of a demo place, similar to a mesh extracted from a capture: closed solids with captured colours at the
//! vertices. The solids of a room lie in a closed shell.

use std::collections::BTreeMap;

use engine::{Context, NodeError};
use glam::DVec3;
use scene::math::color::{code8, linear_from_srgb, srgb_from_linear};
use scene::types::Mesh;

use super::light::{Effort, Lit};
use super::paint::Paint;
use super::place::Layout;
use super::random::unit;
use super::shape::Quad;
use super::view::WorldFrame;

/// Largest deviation of a vertex from the surface, in metres.
const JITTER: f64 = 0.005;
/// Length of the sides of triangles near the object, in metres.
const FINE: f64 = 0.06;
/// Length of the sides of all other triangles, in metres.
const COARSE: f64 = 0.14;
/// Distance from the object, in metres, within which triangles are fine.
const NEAR: f64 = 1.2;
/// Size in metres above which solids are divided coarsely even near the object.
const LARGE: f64 = 4.0;

/// Vertices of a solid, merged where their positions are equal.
#[derive(Default)]
struct Weld {
    known: BTreeMap<(u32, [i64; 3]), u32>,
    points: Vec<(DVec3, DVec3)>,
    triangles: Vec<[u32; 3]>,
}

impl Weld {
    fn vertex(&mut self, solid: u32, p: DVec3, n: DVec3) -> u32 {
        let key = (solid, p.to_array().map(|c| (c * 1e5).round() as i64));
        let next = self.points.len() as u32;
        let index = *self.known.entry(key).or_insert(next);
        if index == next {
            self.points.push((p, n));
        } else {
            self.points[index as usize].1 += n;
        }
        index
    }

    fn triangle(&mut self, corners: [u32; 3]) {
        let [a, b, c] = corners;
        if a != b && b != c && c != a {
            self.triangles.push(corners);
        }
    }

    fn quad(&mut self, solid: u32, quad: &Quad, spacing: f64) {
        let [lu, lv] = quad.lengths();
        // Faces that share an edge must divide it equally, although its length differs in the last bit.
        let parts =
            |length: f64| if quad.divide { (length / spacing - 1e-6).ceil().max(1.0) as usize } else { 1 };
        let (nu, nv) = (parts(lu), parts(lv));
        for j in 0..nv {
            for i in 0..nu {
                let corner = |a: usize, b: usize| (a as f64 / nu as f64, b as f64 / nv as f64);
                let [p, q, r, s] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(a, b)| {
                    let (u, v) = corner(a, b);
                    self.vertex(solid, quad.point(u, v), quad.normal(u, v))
                });
                self.triangle([p, q, r]);
                self.triangle([p, r, s]);
            }
        }
    }
}

pub(super) fn mesh(
    lit: &Lit<'_>,
    layout: &Layout,
    world: &WorldFrame,
    cx: &Context,
) -> Result<Mesh, NodeError> {
    let mut weld = Weld::default();
    if layout.dome.is_none() {
        shell(layout).iter().for_each(|quad| weld.quad(0, quad, COARSE));
    }
    let mut spacing = BTreeMap::new();
    let stand = DVec3::new(0.0, 0.0, layout.stand);
    for quad in lit.quads {
        let Some(solid) = quad.solid else { continue };
        let near = [(0.0, 0.0), (0.5, 0.5), (1.0, 1.0)]
            .iter()
            .any(|&(u, v)| (quad.point(u, v) - stand).length() < NEAR);
        let least = spacing.entry(solid).or_insert(COARSE);
        if near && quad.lengths()[0].max(quad.lengths()[1]) < LARGE {
            *least = FINE;
        }
    }
    for quad in lit.quads {
        if let Some(solid) = quad.solid {
            weld.quad(solid, quad, spacing[&solid]);
        }
    }
    let chunk = 128;
    let colours = cx.for_each_tile(weld.points.len().div_ceil(chunk), |c| {
        let range = c * chunk..((c + 1) * chunk).min(weld.points.len());
        range.map(|i| colour(lit, weld.points[i], i as u64)).collect::<Vec<_>>()
    })?;
    let place = |(i, (p, _)): (usize, &(DVec3, DVec3))| {
        let random = |d| 2.0 * unit(lit.seed, 0x6a69, i as u64, d) - 1.0;
        let moved = *p + DVec3::new(random(0), random(1), random(2)) * (JITTER / 3.0_f64.sqrt());
        let p = world.point(moved);
        [p.x as f32, p.y as f32, p.z as f32]
    };
    Ok(Mesh {
        positions: weld.points.iter().enumerate().map(place).collect(),
        colours: colours.into_iter().flatten().collect(),
        triangles: weld.triangles,
        ..Mesh::default()
    })
}

/// Six walls that face inwards.
fn shell(layout: &Layout) -> Vec<Quad> {
    let mut shapes = super::shape::Shapes::default();
    let [low, high] = layout.bounds;
    shapes.between(low.to_array(), high.to_array(), Paint::Hidden, true);
    let inward = |mut quad: Quad| {
        quad.p.reverse();
        quad.uv.reverse();
        quad.n = quad.n.map(|n| -n);
        quad
    };
    shapes.quads.into_iter().map(inward).collect()
}

/// Captured colour at a vertex: the colour of the surface found along its normal, clipped and rounded to 8 bits.
fn colour(lit: &Lit<'_>, (p, n): (DVec3, DVec3), key: u64) -> [f32; 3] {
    let n = n.normalize_or(DVec3::Z);
    let effort = Effort { sky: 9, sun: 2, lamp: 3 };
    // Vertices lie on edges, so the look-up starts a little inside.
    let from = p + n * 0.05;
    let seen = lit.radiance(from, -n, 0x2000_0000 + key, effort);
    seen.map(|v| {
        let code = code8(srgb_from_linear(v.clamp(0.0, 1.0) as f32));
        linear_from_srgb(f32::from(code) / 255.0)
    })
}
