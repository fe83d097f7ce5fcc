//! Surface points of the place with their captured colours.

use engine::{Context, NodeError};
use glam::{DQuat, DVec3, Vec3};
use scene::math::color::linear_from_srgb;
use scene::types::{SplatEncoding, Splats};

use super::place::{CLIPPED, PlaceMesh};

/// The constant spherical harmonic of degree 0.
const SH0: f32 = 0.282_094_8;
/// Minimum opacity of a splat that counts as a surface.
const OPAQUE: f32 = 0.5;
/// Minimum linear luminance of a point. Darker points are mostly noise.
const DARKEST: f32 = 0.002;
/// Maximum distance of a point from the point of capture, relative to the median distance. Farther points belong to
/// sky shells or to the distant background.
const FARTHEST: f64 = 3.0;
/// Number of points per tile.
const TILE: usize = 256;

/// A surface point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    /// Position in the frame of the place's tree.
    pub position: DVec3,
    /// Unit normal on the side of the surface that faces the point of capture.
    pub normal: DVec3,
    /// Captured linear radiance.
    pub radiance: Vec3,
}

/// Points that are compared, and the size of the surroundings of the point of capture.
pub(super) struct Shading {
    pub points: Vec<Point>,
    /// Median distance of surfaces from the point of capture, in world units.
    pub size: f64,
}

/// A surface on which points may be sampled.
struct Surface {
    point: Point,
    area: f64,
    distance: f64,
}

impl Shading {
    /// Samples `count` points on the splats, or on the mesh if there are no splats. Only points visible from the
    /// point of capture are taken. The density of points is higher near the point of capture, since surfaces there
    /// matter more for an object at that point. Points are taken at equal steps of the cumulative weight, so equal
    /// inputs give equal points.
    pub fn sample(
        place: &PlaceMesh,
        splats: Option<&Splats>,
        origin: DVec3,
        count: usize,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let origin = place.local(origin);
        let surfaces: Vec<Surface> = match splats {
            Some(splats) => {
                (0..splats.len()).filter_map(|index| of_splat(splats, index, place, origin)).collect()
            }
            None => (0..place.corners.len()).filter_map(|index| of_triangle(place, index, origin)).collect(),
        };
        cx.check()?;
        let mut distances: Vec<f64> = surfaces.iter().map(|surface| surface.distance).collect();
        if distances.is_empty() {
            return Ok(Self { points: Vec::new(), size: 0.0 });
        }
        let middle = distances.len() / 2;
        let size = *distances.select_nth_unstable_by(middle, f64::total_cmp).1;
        let weight = |surface: &Surface| {
            let away = surface.distance / size.max(f64::MIN_POSITIVE);
            if away < FARTHEST { surface.area / (1.0 + away * away) } else { 0.0 }
        };
        let total: f64 = surfaces.iter().map(weight).sum();
        let (mut sum, mut next, mut drawn) = (0.0, 0.5, Vec::new());
        for surface in &surfaces {
            sum += weight(surface);
            let reached = sum * count as f64 / total;
            if reached > next {
                drawn.push(surface);
                next = (reached - 0.5).floor() + 1.5;
            }
        }
        let tiles = cx.for_each_tile(drawn.len().div_ceil(TILE), |tile| {
            let those = drawn[tile * TILE..].iter().take(TILE);
            those
                .filter(|surface| is_seen(place, origin, size, surface))
                .map(|surface| surface.point)
                .collect()
        })?;
        Ok(Self { points: tiles.into_iter().flat_map(|tile: Vec<Point>| tile).collect(), size })
    }
}

/// True if a surface is visible from the point of capture. The colours of hidden surfaces are meaningless,
/// because no camera captured them.
fn is_seen(place: &PlaceMesh, origin: DVec3, size: f64, surface: &Surface) -> bool {
    let towards = (surface.point.position - origin) / surface.distance;
    place.distance(origin, towards) > surface.distance - 0.02 * (size + surface.distance)
}

fn surface(position: DVec3, normal: DVec3, radiance: Vec3, area: f64, origin: DVec3) -> Option<Surface> {
    let luminance = scene::math::color::luminance(radiance.to_array());
    let towards = origin - position;
    let distance = towards.length();
    let usable =
        radiance.max_element() < CLIPPED && luminance > DARKEST && distance > 0.0 && distance.is_finite();
    let normal = if normal.dot(towards) < 0.0 { -normal } else { normal };
    usable.then_some(Surface { point: Point { position, normal, radiance }, area, distance })
}

/// Converts a splat to a surface: its two long axes span the surface, and its short axis is the normal. `None` if
/// the splat cannot be used, for example because it is transparent.
fn of_splat(splats: &Splats, index: usize, place: &PlaceMesh, origin: DVec3) -> Option<Surface> {
    let scales = splats.scales[index].map(f64::from);
    let thin = (0..3).min_by(|&a, &b| scales[a].total_cmp(&scales[b]))?;
    if splats.opacities[index] <= OPAQUE {
        return None;
    }
    let [w, x, y, z] = splats.quats[index].map(f64::from);
    let normal = DQuat::from_xyzw(x, y, z, w).normalize() * DVec3::AXES[thin];
    let shown = Vec3::from(splats.sh[index * splats.sh_len()]) * SH0 + 0.5;
    let radiance = match splats.encoding {
        SplatEncoding::Srgb => Vec3::from(shown.to_array().map(|v| linear_from_srgb(v.max(0.0)))),
        SplatEncoding::Linear => shown.max(Vec3::ZERO),
    };
    let area = scales[(thin + 1) % 3] * scales[(thin + 2) % 3];
    surface(place.local(splats.mean(index)), normal, radiance, area, origin)
}

fn of_triangle(place: &PlaceMesh, index: usize, origin: DVec3) -> Option<Surface> {
    let [a, b, c] = place.corners[index].map(Vec3::as_dvec3);
    let normal = (b - a).cross(c - a);
    let area = 0.5 * normal.length();
    if !(area > 0.0 && area.is_finite()) {
        return None;
    }
    surface((a + b + c) / 3.0, normal / (2.0 * area), place.middle_colour(index)?, area, origin)
}
