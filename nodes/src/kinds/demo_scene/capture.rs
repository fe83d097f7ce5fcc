//! Splats of a demo scene, as training on photographs would produce them: one flat Gaussian per patch of a surface.
//! The patches are smaller where the camera is close. Colours are clipped to the range of a display before they are
//! fitted.

use engine::{Context, NodeError};
use glam::{DMat3, DVec3};
use scene::math::color::srgb_from_linear;
use scene::math::num;
use scene::types::{SplatEncoding, Splats};

use super::light::{Effort, Lit, Rgb, add, times};
use super::place::Layout;
use super::random::unit;
use super::shape::Quad;
use super::view::{DemoCamera, WorldFrame};

/// Number of directions from which a reflective splat is photographed.
const DIRECTIONS: usize = 16;
/// Number of coefficients of spherical harmonics of degree 2.
const SH: usize = 9;
/// Weight of the regularisation of coefficients, as a fraction of the number of photographs.
const RIDGE: f64 = 0.06;
/// Standard deviation of a splat divided by the side of its patch, large enough to leave no gaps.
const WIDTH: f64 = 0.66;
/// Number of splats along the horizon in the dome of sky.
const DOME: usize = 150;

/// One patch of a quad: its middle in (u, v) and its size in metres.
#[derive(Debug, Clone, Copy)]
struct Patch {
    quad: u32,
    u: f64,
    v: f64,
    du: f64,
    dv: f64,
}

impl Patch {
    fn is_seen(self, lit: &Lit<'_>, layout: &Layout) -> bool {
        let quad = &lit.quads[self.quad as usize];
        let (p, n) = (quad.point(self.u, self.v), quad.normal(self.u, self.v));
        !quad.paint.is_solid() || witness(lit, layout, quad, p, n).is_some()
    }
}

/// A splat in the frame of the demo scene.
struct Splat {
    mean: DVec3,
    axes: [DVec3; 3],
    scales: DVec3,
    opacity: f64,
    sh: [Rgb; SH],
}

/// Builds about `count` splats.
pub(super) fn splats(
    lit: &Lit<'_>,
    layout: &Layout,
    view: &DemoCamera,
    world: &WorldFrame,
    count: usize,
    cx: &Context,
) -> Result<(Splats, Defects), NodeError> {
    let floaters = count / 1200;
    let dome = if layout.dome.is_some() { DOME * DOME / 4 } else { 0 };
    let wanted = count.saturating_sub(floaters + dome).max(1);
    // A coarse first pass estimates the share of the patches that any camera sees.
    let coarse = patches(lit.quads, view, wanted / 8 + 1);
    let seen = cx.for_each_tile(coarse.len().div_ceil(256), |c| {
        let range = c * 256..((c + 1) * 256).min(coarse.len());
        range.filter(|&i| coarse[i].is_seen(lit, layout)).count()
    })?;
    let share = seen.iter().sum::<usize>() as f64 / coarse.len().max(1) as f64;
    let patches = patches(lit.quads, view, (wanted as f64 / share.max(0.1)) as usize);
    let chunk = 256;
    let chunks = patches.len().div_ceil(chunk);
    let made = cx.for_each_tile(chunks, |c| {
        let range = c * chunk..((c + 1) * chunk).min(patches.len());
        if c.is_multiple_of(16) {
            cx.progress(0.3 + 0.6 * c as f32 / chunks as f32);
        }
        range.map(|i| splat(lit, layout, patches[i], i as u64, world)).collect::<Vec<_>>()
    })?;
    let all: Vec<Option<Splat>> = made.into_iter().flatten().collect();
    let unseen = all.iter().filter(|splat| splat.is_none()).count() as u64;
    let mut kept: Vec<Splat> = all.into_iter().flatten().collect();
    if let Some(radius) = layout.dome {
        sky_dome(lit, radius, &mut kept);
    }
    for i in 0..floaters as u64 {
        kept.extend(floater(lit, layout, view, i));
    }
    Ok((pack(&kept, world), Defects { unseen, floaters: floaters as u64 }))
}

/// Counts of the intended defects of the capture.
pub(super) struct Defects {
    /// Number of patches that no camera of the capture saw.
    pub unseen: u64,
    /// Number of splats that float in empty space.
    pub floaters: u64,
}

/// Part of a quad: its ranges of u and v.
#[derive(Debug, Clone, Copy)]
struct Piece {
    quad: u32,
    u: [f64; 2],
    v: [f64; 2],
}

impl Piece {
    /// The whole quads, without those that cannot be seen.
    fn whole(quads: &[Quad]) -> Vec<Self> {
        let numbered = (0_u32..).zip(quads);
        let shown = numbered.filter(|(_, quad)| {
            let [lu, lv] = quad.lengths();
            quad.paint != super::paint::Paint::Hidden && lu * lv != 0.0
        });
        shown.map(|(quad, _)| Self { quad, u: [0.0, 1.0], v: [0.0, 1.0] }).collect()
    }

    fn patch(self, quads: &[Quad]) -> Patch {
        let [lu, lv] = quads[self.quad as usize].lengths();
        let middle = |[low, high]: [f64; 2]| 0.5 * (low + high);
        let (du, dv) = (lu * (self.u[1] - self.u[0]), lv * (self.v[1] - self.v[0]));
        Patch { quad: self.quad, u: middle(self.u), v: middle(self.v), du, dv }
    }

    /// The two halves of a piece whose sides appear more than `pixels` pixels long; `None` if they do not. A piece that
    /// is divided is also divided for fewer pixels.
    fn halves(self, quads: &[Quad], view: &DemoCamera, pixels: f64) -> Option<[Self; 2]> {
        let (quad, Patch { u, v, du, dv, .. }) = (&quads[self.quad as usize], self.patch(quads));
        let limit = view.patch_size(quad.point(u, v), quad.normal(u, v), du.max(dv), pixels);
        (du.max(dv) > limit).then(|| match du >= dv {
            true => [Self { u: [self.u[0], u], ..self }, Self { u: [u, self.u[1]], ..self }],
            false => [Self { v: [self.v[0], v], ..self }, Self { v: [v, self.v[1]], ..self }],
        })
    }
}

/// Divides the quads into about `count` patches that appear equally large to the camera. The size at which they
/// appear is found by bisection.
fn patches(quads: &[Quad], view: &DemoCamera, count: usize) -> Vec<Patch> {
    let (mut small, mut large) = (0.2_f64, 200.0_f64);
    // The pieces of the size `large` that are divided at the size `small`, and the number of the others, which stay as they
    // are at every size between.
    let (mut open, mut settled) = (Piece::whole(quads), 0);
    for _ in 0..22 {
        let middle = (small * large).sqrt();
        let mut found = Vec::with_capacity(open.len());
        cut(quads, view, middle, &open, &mut found, count.saturating_sub(settled));
        if settled + found.len() > count {
            small = middle;
        } else {
            (large, open) = (middle, found);
        }
        let before = open.len();
        open.retain(|piece| piece.halves(quads, view, small).is_some());
        settled += before - open.len();
    }
    let mut found = Vec::with_capacity(count);
    cut(quads, view, large, &Piece::whole(quads), &mut found, usize::MAX);
    found.into_iter().map(|piece| piece.patch(quads)).collect()
}

/// Divides pieces into pieces whose sides appear at most `pixels` pixels long, and appends them to `found` in order.
/// Stops after `most` pieces and one more.
fn cut(
    quads: &[Quad],
    view: &DemoCamera,
    pixels: f64,
    pieces: &[Piece],
    found: &mut Vec<Piece>,
    most: usize,
) {
    let mut work: Vec<Piece> = pieces.iter().rev().copied().collect();
    while let Some(piece) = work.pop() {
        match piece.halves(quads, view, pixels) {
            Some([first, second]) => work.extend([second, first]),
            None => found.push(piece),
        }
        if found.len() > most {
            return;
        }
    }
}

/// The splat of a patch; `None` if no camera of the capture saw it.
fn splat(lit: &Lit<'_>, layout: &Layout, patch: Patch, key: u64, world: &WorldFrame) -> Option<Splat> {
    let quad = &lit.quads[patch.quad as usize];
    let [lu, lv] = quad.lengths();
    let random = |d: u64| unit(lit.seed, 0x7370, key, d);
    let (hu, hv) = (0.5 * patch.du / lu, 0.5 * patch.dv / lv);
    let u = patch.u + hu * 0.3 * (random(0) - 0.5);
    let v = patch.v + hv * 0.3 * (random(1) - 0.5);
    let (p, n) = (quad.point(u, v), quad.normal(u, v));
    let outside = quad.paint == super::paint::Paint::Outside;
    let seen_from = if outside { layout.captures.first().copied() } else { witness(lit, layout, quad, p, n) };
    let toward = (p - seen_from?).normalize_or(DVec3::Y);
    let sh = if outside {
        flat(display(lit.sky.radiance(toward)))
    } else {
        colours(lit, quad, u, v, [hu, hv], toward, key, world)
    };
    // The patch may be sheared; its sides give the axes, made orthogonal.
    let along =
        (quad.point((u + 1e-3).min(1.0), v) - quad.point((u - 1e-3).max(0.0), v)).normalize_or(DVec3::X);
    let facet = n;
    let across = facet.cross(along).normalize_or(DVec3::Y);
    let along = across.cross(facet);
    let blur = 0.92 + 0.22 * random(2);
    let scales =
        DVec3::new(WIDTH * patch.du * blur, WIDTH * patch.dv * blur, 0.04 * patch.du.min(patch.dv) + 2e-4);
    Some(Splat { mean: p, axes: [along, across, facet], scales, opacity: 0.93 + 0.06 * random(3), sh })
}

/// Position of the first camera of the capture that sees a point; `None` if no camera sees it.
fn witness(lit: &Lit<'_>, layout: &Layout, quad: &Quad, p: DVec3, n: DVec3) -> Option<DVec3> {
    let middle = DVec3::new(0.0, 0.1, 0.95);
    let sees = |eye: &&DVec3| {
        let way = p - **eye;
        let distance = way.length();
        let toward = way / distance.max(1e-9);
        let level = DVec3::new(middle.x - eye.x, middle.y - eye.y, middle.z - eye.z).normalize_or(DVec3::Y);
        // A field of view of about 100 degrees.
        let in_frame = toward.dot(level) > 0.64;
        let facing = -n.dot(toward);
        let facing = if quad.paint.is_thin() { facing.abs() } else { facing };
        let side = if facing >= 0.0 && n.dot(toward) > 0.0 { -n } else { n };
        in_frame && facing > 0.03 && !lit.caster.blocked(p + side * 4e-3, -toward, distance - 8e-3)
    };
    std::iter::once(&layout.eye).chain(&layout.captures).find(sees).copied()
}

fn display(rgb: Rgb) -> Rgb {
    rgb.map(|v| f64::from(srgb_from_linear(v.clamp(0.0, 1.0) as f32)))
}

/// Coefficients of spherical harmonics of a colour that is the same in all directions.
fn flat(colour: Rgb) -> [Rgb; SH] {
    let mut sh = [[0.0; 3]; SH];
    sh[0] = colour.map(|v| (v - 0.5) / basis(DVec3::Z)[0]);
    sh
}

#[allow(clippy::too_many_arguments, reason = "a patch is defined by this many numbers")]
fn colours(
    lit: &Lit<'_>,
    quad: &Quad,
    u: f64,
    v: f64,
    half: [f64; 2],
    toward: DVec3,
    key: u64,
    world: &WorldFrame,
) -> [Rgb; SH] {
    let effort = Effort { sky: if lit.opening.is_some() { 16 } else { 25 }, sun: 4, lamp: 4 };
    let light = lit.received(quad, u, v, toward, key, effort);
    // The texture is averaged over the patch, as by a pixel of a camera.
    let mut albedo = [0.0; 3];
    let mut gloss = None;
    for (a, b) in [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)] {
        let look = quad.paint.look(lit.seed, quad.texture(u + a * half[0], v + b * half[1]));
        albedo = add(albedo, look.albedo, 0.25);
        gloss = look.gloss;
    }
    let diffuse = add(quad.paint.glow(), times(albedo, light), 1.0 / std::f64::consts::PI);
    let Some(gloss) = gloss else { return flat(display(diffuse)) };
    let (p, n) = (quad.point(u, v), quad.normal(u, v));
    let (a, b) = super::light::frame(n);
    let mut fit = Fit::default();
    for i in 0..DIRECTIONS {
        let random = |d: u64| unit(lit.seed, 0x676c + d, key, i as u64);
        // The same directions for every splat, so that neighbours agree.
        let turn = 2.0 * std::f64::consts::PI * i as f64 * 0.618_034;
        let (sin, cos) = num::sin_cos(turn);
        let up = 0.08 + 0.9 * (i as f64 + 0.5) / DIRECTIONS as f64;
        let out = (1.0 - up * up).max(0.0).sqrt();
        let viewer = a * (out * cos) + b * (out * sin) + n * up;
        let mirror = a * (-out * cos) + b * (-out * sin) + n * up;
        let wobble = (a * (random(2) - 0.5) + b * (random(3) - 0.5)) * (2.0 * gloss.spread);
        let ray = (mirror + wobble).normalize();
        let grazing = 1.0 - up;
        let square = grazing * grazing;
        let fresnel = gloss.f0 + (1.0 - gloss.f0) * square * square * grazing;
        let mirrored = if ray.dot(n) > 0.0 { lit.rough_radiance(p + n * 1e-3, ray) } else { [0.0; 3] };
        // Very bright reflections are dimmed by the roughness of a real coat at grazing angles.
        let colour = add(diffuse, mirrored, fresnel * (0.35 + 0.65 * up));
        fit.photograph(basis(world.turn(-viewer)), display(colour));
    }
    fit.solve()
}

/// Values of the spherical harmonics of the INRIA rasterizer for the direction from the camera to the splat.
fn basis(d: DVec3) -> [f64; SH] {
    let (x, y, z) = (d.x, d.y, d.z);
    [
        0.282_094_791_773_878_14,
        -0.488_602_511_902_919_9 * y,
        0.488_602_511_902_919_9 * z,
        -0.488_602_511_902_919_9 * x,
        1.092_548_430_592_079_2 * x * y,
        -1.092_548_430_592_079_2 * y * z,
        0.315_391_565_252_520_05 * (2.0 * z * z - x * x - y * y),
        -1.092_548_430_592_079_2 * x * z,
        0.546_274_215_296_039_6 * (x * x - y * y),
    ]
}

/// Ridge regression of colours on the basis.
#[derive(Default)]
struct Fit {
    square: [[f64; SH]; SH],
    right: [Rgb; SH],
    photographs: f64,
}

impl Fit {
    fn photograph(&mut self, basis: [f64; SH], colour: Rgb) {
        for i in 0..SH {
            for j in 0..SH {
                self.square[i][j] += basis[i] * basis[j];
            }
            self.right[i] = add(self.right[i], colour.map(|v| v - 0.5), basis[i]);
        }
        self.photographs += 1.0;
    }

    /// Solves the equations by Gaussian elimination without pivoting, since the matrix is positive definite.
    fn solve(mut self) -> [Rgb; SH] {
        for i in 0..SH {
            self.square[i][i] += RIDGE * self.photographs * if i == 0 { 1e-4 } else { 0.3 };
        }
        for i in 0..SH {
            for j in i + 1..SH {
                let factor = self.square[j][i] / self.square[i][i];
                for k in i..SH {
                    self.square[j][k] -= factor * self.square[i][k];
                }
                self.right[j] = add(self.right[j], self.right[i], -factor);
            }
        }
        let mut solved = [[0.0; 3]; SH];
        for i in (0..SH).rev() {
            let rest = (i + 1..SH).fold(self.right[i], |r, j| add(r, solved[j], -self.square[i][j]));
            solved[i] = rest.map(|v| v / self.square[i][i]);
        }
        solved
    }
}

/// Adds large splats of sky in all directions.
fn sky_dome(lit: &Lit<'_>, radius: f64, to: &mut Vec<Splat>) {
    let rows = DOME / 4;
    for row in 0..rows {
        let elevation = -0.12 + 1.68 * (row as f64 + 0.5) / rows as f64;
        let (rise, level) = num::sin_cos(elevation);
        let columns = ((DOME as f64 * level).ceil() as usize).max(4);
        for column in 0..columns {
            let (sin, cos) =
                num::sin_cos(2.0 * std::f64::consts::PI * (column as f64 + 0.5) / columns as f64);
            let d = DVec3::new(cos * level, sin * level, rise);
            let (a, b) = super::light::frame(-d);
            let size = 2.0 * std::f64::consts::PI * radius / DOME as f64;
            to.push(Splat {
                mean: d * radius,
                axes: [a, b, -d],
                scales: DVec3::new(0.62 * size, 0.62 * size, 0.02 * size),
                opacity: 0.97,
                sh: flat(display(lit.sky.with_sun(d))),
            });
        }
    }
}

/// A faint splat in the air. `None` if its position is near the camera and in the camera's view.
fn floater(lit: &Lit<'_>, layout: &Layout, view: &DemoCamera, i: u64) -> Option<Splat> {
    let random = |d: u64| unit(lit.seed, 0x666c, i, d);
    let [low, high] = layout.bounds;
    let p = low + (high - low) * DVec3::new(random(0), random(1), random(2));
    if view.distance(p).is_some_and(|distance| distance < 2.6) {
        return None;
    }
    let (a, b) = super::light::frame(
        DVec3::new(random(3) - 0.5, random(4) - 0.5, random(5) - 0.5).normalize_or(DVec3::Z),
    );
    let toward = DVec3::new(random(6) - 0.5, random(7) - 0.5, random(8) - 0.5).normalize_or(DVec3::Z);
    let size = 0.01 + 0.04 * random(9);
    Some(Splat {
        mean: p,
        axes: [a, b, a.cross(b)],
        scales: DVec3::new(size, size * (0.3 + random(10)), size * 0.3),
        opacity: 0.03 + 0.14 * random(11),
        sh: flat(display(lit.rough_radiance(p, toward))),
    })
}

fn pack(splats: &[Splat], world: &WorldFrame) -> Splats {
    let single = |v: DVec3| [v.x as f32, v.y as f32, v.z as f32];
    Splats {
        means: splats.iter().map(|s| single(world.point(s.mean))).collect(),
        means_low: Vec::new(),
        quats: splats
            .iter()
            .map(|s| quaternion(DMat3::from_cols_array_2d(&s.axes.map(|a| world.turn(a).to_array()))))
            .collect(),
        scales: splats.iter().map(|s| single(s.scales * world.per_metre)).collect(),
        opacities: splats.iter().map(|s| s.opacity as f32).collect(),
        sh_degree: 2,
        sh: splats.iter().flat_map(|s| s.sh.map(|c| c.map(|v| v as f32))).collect(),
        encoding: SplatEncoding::Srgb,
        antialiased: false,
    }
}

/// The unit quaternion (w, x, y, z) of a rotation (Shepperd, Quaternion from Rotation Matrix, 1978).
fn quaternion(m: DMat3) -> [f32; 4] {
    let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
    let q = if x.x + y.y + z.z > 0.0 {
        let s = 2.0 * (1.0 + x.x + y.y + z.z).sqrt();
        [0.25 * s, (y.z - z.y) / s, (z.x - x.z) / s, (x.y - y.x) / s]
    } else if x.x > y.y && x.x > z.z {
        let s = 2.0 * (1.0 + x.x - y.y - z.z).sqrt();
        [(y.z - z.y) / s, 0.25 * s, (y.x + x.y) / s, (z.x + x.z) / s]
    } else if y.y > z.z {
        let s = 2.0 * (1.0 + y.y - x.x - z.z).sqrt();
        [(z.x - x.z) / s, (y.x + x.y) / s, 0.25 * s, (z.y + y.z) / s]
    } else {
        let s = 2.0 * (1.0 + z.z - x.x - y.y).sqrt();
        [(x.y - y.x) / s, (z.x + x.z) / s, (z.y + y.z) / s, 0.25 * s]
    };
    let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    q.map(|c| (c / length) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The search for the size of the patches, which looks only at patches whose division is open, finds those of a search
    /// that divides all quads at every size. This test fails if `patches` counts `settled` twice, or if it keeps the pieces
    /// of a size at which there are too many.
    #[test]
    fn patches_are_those_of_a_search_that_divides_all_quads() {
        use super::super::{DemoScene, Setting, courtyard, room};
        let small = DemoScene { width_px: 96, height_px: 54, ..DemoScene::default() };
        for (place, layout) in [(Setting::Room, room::layout(7)), (Setting::Courtyard, courtyard::layout(7))]
        {
            let view = DemoCamera::new(&layout, &DemoScene { place, ..small.clone() });
            let (quads, mut least) = (&layout.shapes.quads, 0);
            for count in [1, 3_000, 20_000] {
                let mut sizes = [0.2_f64, 200.0];
                let divided = |pixels| {
                    let mut found = Vec::new();
                    cut(quads, &view, pixels, &Piece::whole(quads), &mut found, usize::MAX);
                    found
                };
                for _ in 0..22 {
                    let middle = (sizes[0] * sizes[1]).sqrt();
                    sizes[usize::from(divided(middle).len() <= count)] = middle;
                }
                let all = divided(sizes[1]).into_iter().map(|piece| piece.patch(quads));
                let numbers = |patch: Patch| (patch.quad, [patch.u, patch.v, patch.du, patch.dv]);
                let found: Vec<_> = patches(quads, &view, count).into_iter().map(numbers).collect();
                assert_eq!(found, all.map(numbers).collect::<Vec<_>>());
                assert!(found.len() > least, "{} patches", found.len());
                least = found.len().min(count - 1);
            }
        }
    }

    #[test]
    fn quaternions_turn_as_their_matrix_does() {
        for i in 0..40 {
            let r = |d| unit(1, 2, i, d) - 0.5;
            let n = DVec3::new(r(0), r(1), r(2)).normalize();
            let (a, b) = super::super::light::frame(n);
            let m = DMat3::from_cols(a, b, n);
            assert!((m.determinant() - 1.0).abs() < 1e-9);
            let [w, x, y, z] = quaternion(m).map(f64::from);
            let (axis, v) = (DVec3::new(x, y, z), DVec3::new(0.3, -0.8, 0.5));
            let turned = v + 2.0 * axis.cross(axis.cross(v) + v * w);
            assert!((turned - m * v).length() < 1e-6);
        }
    }

    #[test]
    fn the_fit_recovers_a_colour_that_is_in_the_basis() {
        let mut fit = Fit::default();
        for i in 0..2000 {
            let r = |d| unit(5, 6, i, d) - 0.5;
            let d = DVec3::new(r(0), r(1), r(2)).normalize();
            fit.photograph(basis(d), [0.6; 3]);
        }
        let sh = fit.solve();
        assert!((sh[0][0] * basis(DVec3::X)[0] + 0.5 - 0.6).abs() < 1e-3, "{}", sh[0][0]);
        assert!(sh[1..].iter().flatten().all(|c| c.abs() < 1e-2));
    }
}
