//! Light that surface points receive from everything except the sun.

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};
use render::light::emitters::WHITE;
use render::light::measure::spiral;
use scene::math::color::luminance;
use scene::math::equirect::uv;
use scene::types::Environment;

use super::place::{CLIPPED, PlaceMesh, Seen};
use super::shading::Shading;

/// Number of directions over the whole sphere. A point receives light from half of them.
const DIRECTIONS: usize = 384;
/// Number of points per tile.
const TILE: usize = 128;

/// Irradiance at one point, split by its origin. Radiance is taken from the capture, so it includes all bounces.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Incident {
    /// Irradiance from surfaces and sky that are not clipped.
    pub known: Vec3,
    /// Irradiance from clipped surfaces and sky, computed from their displayed brightness. It is a lower bound.
    pub clipped: Vec3,
}

/// Displayed radiance of the environment in a direction, limited to white, and whether the environment is clipped
/// in that direction.
pub(super) fn shown(env: &Environment, direction: DVec3) -> (Vec3, bool) {
    let (u, v) = uv(env.up, direction);
    let (width, height) = (env.image.width, env.image.height);
    let at = |t: f64, n: usize| ((t * n as f64) as usize).min(n - 1);
    let rgb = env.image.rgb(at(u, width), at(v, height));
    let most = rgb[0].max(rgb[1]).max(rgb[2]);
    (Vec3::from(rgb) / most.max(1.0), luminance(rgb) >= WHITE)
}

/// Incident light of each point: the captured colours of the surfaces that are visible from it, and the
/// environment in all other directions.
pub(super) fn incident(
    place: &PlaceMesh,
    shading: &Shading,
    env: &Environment,
    cx: &Context,
) -> Result<Vec<Incident>, NodeError> {
    let directions: Vec<(DVec3, Vec3, bool)> = spiral(DIRECTIONS)
        .into_iter()
        .map(|direction| {
            let (rgb, clipped) = shown(env, direction);
            (direction, rgb, clipped)
        })
        .collect();
    let solid_angle = (4.0 * std::f64::consts::PI / DIRECTIONS as f64) as f32;
    let tiles = cx.for_each_tile(shading.points.len().div_ceil(TILE), |tile| {
        let mut found = Vec::with_capacity(TILE);
        for point in shading.points[tile * TILE..].iter().take(TILE) {
            let from = point.position + point.normal * place.offset;
            let mut sum = Incident::default();
            for (direction, sky, sky_clipped) in &directions {
                let cosine = point.normal.dot(*direction) as f32;
                if cosine <= 0.0 {
                    continue;
                }
                let (radiance, clipped) = match place.seen(from, *direction) {
                    Seen::Sky => (*sky, *sky_clipped),
                    Seen::Surface(colour) => (colour.min(Vec3::ONE), colour.max_element() > CLIPPED),
                };
                let part = if clipped { &mut sum.clipped } else { &mut sum.known };
                *part += radiance * (cosine * solid_angle);
            }
            found.push(sum);
        }
        found
    })?;
    Ok(tiles.into_iter().flatten().collect())
}
