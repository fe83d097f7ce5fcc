//! Emitters as sources of light in the place: patches on its surfaces, in its openings, or far away.

use glam::{DMat3, DVec3};
use render::light::emitters::{self, Emitter};
use render::light::measure::luminance;
use render::light::regions;
use scene::types::Environment;

use super::place::{PlaceMesh, Seen};

/// Maximum number of patches of an emitter.
const PATCHES: usize = 16;
/// Maximum number of texels for which rays are cast to find the shape of an emitter.
const PROBES: usize = 256;
/// Minimum fraction of rays to the texels of an emitter that meet the mesh for an emitter to be a surface, and of
/// rays around it for it to be an opening.
const MOSTLY: f64 = 0.5;
/// Minimum brightness of the mesh where an emitter is on it: the median of the largest channel.
const BRIGHT: f32 = 0.6;
/// Minimum length of the mean of the unit normals of a flat surface.
const FLAT: f64 = 0.9;
/// Width of the rim around an opening, in degrees.
const RIM_DEG: f64 = 3.0;
/// Maximum distance of the rim of an opening from its plane (RMS), relative to the radius of the rim.
const PLANAR: f64 = 0.15;
/// Minimum cosine between the normal of a flat source and the direction to the point of capture.
const GRAZING: f64 = 0.1;

/// Where an emitter is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// A flat surface of the mesh, which emits by Lambert's law.
    Surface,
    /// Another surface of the mesh, such as a lampshade. It emits equally in all directions.
    Body,
    /// An opening in the mesh, through which light of equal radiance comes from all directions.
    Opening,
    /// Infinitely far away.
    Distant,
}

/// Part of an emitter.
struct Patch {
    /// Position relative to the middle of the mesh; for a distant emitter, its direction.
    at: DVec3,
    /// Squared distance from the point of capture, divided by the cosine at the source if it is flat; 1 for a
    /// distant emitter.
    scale: f64,
    /// Displayed flux at the point of capture.
    shown: [f64; 3],
    /// Share of the hidden flux of the emitter.
    hidden: f64,
}

/// An emitter with its place and with the light that the panorama shows and hides.
pub(super) struct Source {
    pub kind: Kind,
    /// Median distance from the point of capture, in world units; infinite for a distant emitter.
    pub distance: f64,
    /// Displayed flux at the point of capture.
    pub shown: [f64; 3],
    /// Hidden flux at the point of capture, as predicted.
    pub hidden: [f64; 3],
    /// True if the mesh is bright where the emitter is on it, or if it is not on the mesh.
    pub is_bright: bool,
    patches: Vec<Patch>,
    /// Unit normal of a flat source, towards the point of capture.
    facing: DVec3,
    /// Distance before a patch within which the surfaces of the emitter itself are expected.
    slack: f64,
}

/// Radiance of a texel that the panorama shows, and the luminance that it hides.
pub(super) fn split(env: &Environment, at: usize) -> ([f64; 3], f64) {
    let rgb = emitters::radiance(env, at);
    let shown = rgb.map(|value| value.min(1.0));
    (shown, (luminance(rgb) - luminance(shown)).max(0.0))
}

/// Weight of a texel in the distribution of the hidden light of its emitter, times its solid angle. If nothing is
/// hidden (`all` is 0), the distribution is uniform.
pub(super) fn weight(hidden: f64, solid_angle: f64, all: f64, emitter: &Emitter) -> f64 {
    if all > 0.0 { hidden * solid_angle / all } else { solid_angle / emitter.solid_angle }
}

impl Source {
    /// Finds the place of an emitter by rays from the point of capture `origin`, which is relative to the middle of
    /// the mesh.
    pub fn new(env: &Environment, emitter: &Emitter, place: &PlaceMesh, origin: DVec3) -> Self {
        let (mut shown, mut hidden, mut all) = ([0.0; 3], [0.0; 3], 0.0);
        for &at in &emitter.texels {
            let ((_, solid_angle), (displayed, more)) = (emitters::texel(env, at), split(env, at));
            let rgb = emitters::radiance(env, at);
            shown.iter_mut().zip(displayed).for_each(|(sum, value)| *sum += value * solid_angle);
            let rest = rgb.into_iter().zip(displayed).map(|(value, shown)| value - shown);
            hidden.iter_mut().zip(rest).for_each(|(sum, value)| *sum += value * solid_angle);
            all += more * solid_angle;
        }
        let Shape { kind, facing, distance, extent, is_bright } = shape(env, emitter, place, origin);
        let mut source = Self {
            kind,
            distance,
            shown,
            hidden,
            is_bright,
            patches: Vec::new(),
            facing,
            slack: if kind == Kind::Body { extent } else { 0.03 * distance } + 4.0 * place.offset,
        };
        source.patches = parts(env, &emitter.texels)
            .into_iter()
            .map(|part| source.patch(env, emitter, &part, place, origin, all))
            .collect();
        source
    }

    /// Patch of some texels of the emitter, whose hidden light is `all`.
    fn patch(
        &self,
        env: &Environment,
        emitter: &Emitter,
        texels: &[usize],
        place: &PlaceMesh,
        origin: DVec3,
        all: f64,
    ) -> Patch {
        let (mut towards, mut shown, mut hidden) = (DVec3::ZERO, [0.0; 3], 0.0);
        for &at in texels {
            let ((direction, solid_angle), (displayed, more)) = (emitters::texel(env, at), split(env, at));
            towards += direction * (solid_angle * (luminance(displayed) + more));
            shown.iter_mut().zip(displayed).for_each(|(sum, value)| *sum += value * solid_angle);
            hidden += weight(more, solid_angle, all, emitter);
        }
        let towards = towards.try_normalize().unwrap_or(emitter.direction);
        let distance = match self.kind {
            Kind::Distant => return Patch { at: towards, scale: 1.0, shown, hidden },
            Kind::Opening => {
                // The plane of the opening, at `distance` along the direction of the emitter.
                let depth = self.facing.dot(emitter.direction) * self.distance;
                depth / self.facing.dot(towards).min(-GRAZING)
            }
            Kind::Surface | Kind::Body => {
                let met = place.distance(origin, towards);
                if (0.5 * self.distance..2.0 * self.distance).contains(&met) { met } else { self.distance }
            }
        };
        let cosine = if self.kind == Kind::Body { 1.0 } else { -self.facing.dot(towards) };
        let at = origin + towards * distance;
        Patch { at, scale: distance * distance / cosine.max(GRAZING), shown, hidden }
    }

    /// Irradiance at a surface point by the displayed light, and by the hidden light for a flux of 1. The point is
    /// relative to the middle of the mesh and already offset from its surface.
    pub fn light(&self, from: DVec3, normal: DVec3, place: &PlaceMesh) -> ([f64; 3], f64) {
        let (mut shown, mut hidden) = ([0.0; 3], 0.0);
        for patch in &self.patches {
            let (towards, reach, by) = if self.kind == Kind::Distant {
                (patch.at, f64::INFINITY, 1.0)
            } else {
                let way = patch.at - from;
                let distance = way.length();
                let towards = way / distance.max(f64::MIN_POSITIVE);
                let cosine = if self.kind == Kind::Body { 1.0 } else { -self.facing.dot(towards) };
                // Points closer than the emitter is wide would need finer patches.
                let near = (0.1 * self.distance).max(distance);
                (towards, distance - self.slack, cosine.max(0.0) / (near * near))
            };
            let by = by * patch.scale * normal.dot(towards).max(0.0);
            if by > 0.0 && (reach <= 0.0 || place.lets_in_from(from, towards, reach)) {
                shown.iter_mut().zip(patch.shown).for_each(|(sum, value)| *sum += by * value);
                hidden += by * patch.hidden;
            }
        }
        (shown, hidden)
    }
}

/// Shape of an emitter.
struct Shape {
    kind: Kind,
    /// Unit normal towards the point of capture if the emitter is flat.
    facing: DVec3,
    distance: f64,
    /// RMS radius of its surface, in world units.
    extent: f64,
    is_bright: bool,
}

fn shape(env: &Environment, emitter: &Emitter, place: &PlaceMesh, origin: DVec3) -> Shape {
    let step = emitter.texels.len().div_ceil(PROBES).max(1);
    let rays = |texels: &mut dyn Iterator<Item = usize>| {
        let mut met: Vec<(DVec3, DVec3)> = Vec::new();
        let mut count = 0;
        for at in texels {
            let towards = emitters::texel(env, at).0;
            count += 1;
            met.extend(place.surface(origin, towards));
        }
        (met, count)
    };
    let (met, count) = rays(&mut emitter.texels.iter().copied().step_by(step));
    let distance_of = |met: &[(DVec3, DVec3)]| {
        let mut distances: Vec<f64> = met.iter().map(|(position, _)| position.distance(origin)).collect();
        let middle = distances.len() / 2;
        *distances.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    if met.len() as f64 >= MOSTLY * f64::from(count) && !met.is_empty() {
        let mean = met.iter().map(|(_, normal)| *normal).sum::<DVec3>() / met.len() as f64;
        let centre = met.iter().map(|(position, _)| *position).sum::<DVec3>() / met.len() as f64;
        let spread = met.iter().map(|(position, _)| position.distance_squared(centre)).sum::<f64>();
        let extent = (spread / met.len() as f64).sqrt();
        let distance = distance_of(&met);
        let colour = |at: &usize| place.seen(origin, emitters::texel(env, *at).0);
        let mut brightness: Vec<f32> = emitter
            .texels
            .iter()
            .step_by(step)
            .filter_map(|at| if let Seen::Surface(rgb) = colour(at) { Some(rgb.max_element()) } else { None })
            .collect();
        let middle = brightness.len() / 2;
        let is_bright = *brightness.select_nth_unstable_by(middle, f32::total_cmp).1 > BRIGHT;
        let (kind, facing) = if mean.length() > FLAT && -mean.normalize().dot(emitter.direction) > GRAZING {
            (Kind::Surface, mean.normalize())
        } else {
            (Kind::Body, -emitter.direction)
        };
        return Shape { kind, facing, distance, extent, is_bright };
    }
    let distant = Shape {
        kind: Kind::Distant,
        facing: -emitter.direction,
        distance: f64::INFINITY,
        extent: 0.0,
        is_bright: true,
    };
    let size = (env.image.width, env.image.width * env.image.height);
    let steps = (RIM_DEG * env.image.width as f64 / 360.0).ceil() as usize;
    let all = regions::around(&emitter.texels, size, steps);
    let inside: std::collections::BTreeSet<usize> = emitter.texels.iter().copied().collect();
    let rim: Vec<usize> = all.difference(&inside).copied().collect();
    let (met, count) = rays(&mut rim.iter().copied().step_by(rim.len().div_ceil(PROBES).max(1)));
    if met.len() < 8 || (met.len() as f64) < MOSTLY * f64::from(count) {
        return distant;
    }
    let positions: Vec<DVec3> = met.iter().map(|(position, _)| *position).collect();
    let (normal, centre, off, extent) = plane(&positions);
    let normal = if normal.dot(emitter.direction) > 0.0 { -normal } else { normal };
    let along = normal.dot(centre - origin) / normal.dot(emitter.direction);
    if off > PLANAR * extent || -normal.dot(emitter.direction) < GRAZING || along <= 0.0 {
        return distant;
    }
    Shape { kind: Kind::Opening, facing: normal, distance: along, extent, is_bright: true }
}

/// Unit normal and centre of the plane nearest to some points, their RMS distance from it, and their RMS distance
/// from its centre.
fn plane(points: &[DVec3]) -> (DVec3, DVec3, f64, f64) {
    let count = points.len() as f64;
    let centre = points.iter().sum::<DVec3>() / count;
    let mut covariance = DMat3::ZERO;
    for point in points {
        let d = *point - centre;
        covariance += DMat3::from_cols(d * d.x, d * d.y, d * d.z) * (1.0 / count);
    }
    let trace = covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z;
    // The smallest eigenvector is the largest of `trace - covariance`.
    let turned = DMat3::from_diagonal(DVec3::splat(trace)) - covariance;
    let mut normal = DVec3::new(0.6, 0.5, 0.62);
    for _ in 0..60 {
        normal = (turned * normal).try_normalize().unwrap_or(DVec3::Z);
    }
    (normal, centre, normal.dot(covariance * normal).max(0.0).sqrt(), trace.sqrt())
}

/// Divides texels into at most [`PATCHES`] parts of similar light. The part with the most light is divided at the
/// median of its light, along its longest side, until there are enough parts.
fn parts(env: &Environment, texels: &[usize]) -> Vec<Vec<usize>> {
    let texels = texels.iter().map(|&at| {
        let ((towards, solid_angle), (shown, hidden)) = (emitters::texel(env, at), split(env, at));
        (at, towards, solid_angle * (luminance(shown) + hidden))
    });
    let total = |part: &[(usize, DVec3, f64)]| part.iter().map(|(_, _, light)| light).sum::<f64>();
    let all: Vec<(usize, DVec3, f64)> = texels.collect();
    let mut parts = vec![(total(&all), all)];
    while parts.len() < PATCHES {
        let split = (0..parts.len()).filter(|&index| parts[index].1.len() > 1);
        let Some(most) = split.max_by(|&a, &b| parts[a].0.total_cmp(&parts[b].0).then(b.cmp(&a))) else {
            break;
        };
        let (sum, mut part) = parts.swap_remove(most);
        let (low, high) =
            part.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (_, d, _)| {
                (low.min(*d), high.max(*d))
            });
        let axis = (high - low).max_position();
        part.sort_by(|a, b| a.1[axis].total_cmp(&b.1[axis]).then(a.0.cmp(&b.0)));
        let (mut below, mut cut) = (0.0, 0);
        while cut + 1 < part.len() && (cut == 0 || below < 0.5 * sum) {
            below += part[cut].2;
            cut += 1;
        }
        let rest = part.split_off(cut);
        parts.push((total(&part), part));
        parts.push((total(&rest), rest));
    }
    parts.into_iter().map(|(_, part)| part.into_iter().map(|(at, ..)| at).collect()).collect()
}
