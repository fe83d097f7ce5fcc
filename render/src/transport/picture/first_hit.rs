//! Depth and normal of the front surface at the centre of a pixel, and depth of the nearest object anywhere
//! in the pixel.

use glam::Vec3;

use super::camera_rays::CameraRays;
use super::film::FIRST_HIT;
use super::film::TileSums;
use super::pair::shift;
use crate::geometry::bvh::{Hit, Ray};
use crate::transport::path::integrator::Scene;
use crate::transport::scene::media::Media;

/// Maximum number of positions in a pixel at which the nearest object is searched for.
pub(crate) const PLACES: u32 = 16;

/// Height above the receiver, in sizes of the largest object, below which the splats of a place receive the shadow of
/// the receiver. Splats of the ground are often a little above the mesh of the ground.
const LOW: f32 = 0.1;
/// Minimum sine of the angle between ray and receiver with which that height is converted to a depth.
const FLATTEST: f32 = 0.1;

/// Traces three values for each pixel: depth and normal of the front surface at the centre of the pixel, and the
/// depth of the nearest object at the positions of the first `places` samples.
pub(crate) fn trace_first_hit(
    scene: Scene<'_>,
    camera_rays: &CameraRays<'_>,
    pixels: &[(u32, u32)],
    places: u32,
) -> TileSums {
    let mut tile = TileSums::with_room(pixels.len() * FIRST_HIT);
    let planar = |t: f32, ray: &Ray| f64::from(t) * ray.direction.as_dvec3().dot(camera_rays.axes[2]);
    for &block in pixels {
        let (x, y) = camera_rays.pixel(block);
        let ray = camera_rays.through(f64::from(x) + 0.5, f64::from(y) + 0.5);
        // True if any ray of the pixel may hit an object.
        let near = camera_rays.may_show(scene.objects, block);
        tile.rays.camera += 1 + u64::from(near);
        let landed = scene.camera_hit(ray);
        // Blended surfaces count only if they cover more than half.
        let front = || scene.objects.bvh.closest(ray, |hit| scene.objects.coverage(hit, true) > 0.5);
        let object = if near { front() } else { None };
        let object = object.filter(|hit| is_before(&scene, camera_rays, ray, hit, landed));
        let (t, normal) = match (object, landed) {
            (Some(hit), _) => {
                let surface = scene.objects.surface(&hit, -ray.direction, false, 0.0, Media::default());
                (hit.t, surface.normal)
            }
            (None, Some(hit)) => (hit.t, scene.receiver.facing(&hit)),
            (None, None) => (f32::INFINITY, Vec3::ZERO),
        };
        let depth = if t.is_finite() { planar(t, &ray) } else { f64::INFINITY };
        let mut nearest = None::<f64>;
        for number in 0..if near { places } else { 0 } {
            let (_, _, ray) = camera_rays.sample(block, number);
            tile.rays.camera += 1;
            if let Some(hit) = scene.objects.bvh.closest(ray, |hit| scene.objects.coverage(hit, true) > 0.0) {
                tile.rays.camera += 1;
                let landed = scene.camera_hit(ray);
                if is_before(&scene, camera_rays, ray, &hit, landed) {
                    let found = planar(hit.t, &ray);
                    nearest = Some(nearest.map_or(found, |known| known.min(found)));
                }
            }
        }
        let nearest = nearest.unwrap_or_else(|| match landed {
            Some(_) if object.is_none() => {
                let slope = normal.dot(ray.direction).abs().max(FLATTEST);
                (depth - planar(LOW * scene.objects.largest / slope, &ray)).max(0.0)
            }
            _ => depth,
        });
        let [a, b, c] = normal.to_array().map(f64::from);
        tile.push(&[depth, nearest, a, b, c]);
    }
    tile
}

/// True if the object hit `hit` of a camera ray is in front of the receiver hit `landed`.
pub fn is_before(
    scene: &Scene<'_>,
    camera_rays: &CameraRays<'_>,
    ray: Ray,
    hit: &Hit,
    landed: Option<Hit>,
) -> bool {
    landed.is_none_or(|l| {
        hit.t - scene.objects.slack(hit, ray.direction) <= l.t + shift(scene, camera_rays, &l, ray)
    })
}
