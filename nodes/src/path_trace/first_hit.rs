//! Depth and normal of what is in front.

use glam::Vec3;

use super::camera_rays::CameraRays;
use super::film::TileSums;
use super::integrator::Scene;
use super::media::Media;
use super::pair::shift;
use crate::sampling::{hash, stream};

/// Depth and normal of what is in front at the centres of some pixels.
pub(super) fn trace_first_hit(
    scene: Scene<'_>,
    camera_rays: &CameraRays<'_>,
    pixels: &[(u32, u32)],
) -> TileSums {
    let mut tile = TileSums::default();
    for &block in pixels {
        let (x, y) = camera_rays.pixel(block);
        let ray = camera_rays.through(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let key = hash(stream(camera_rays.seed, x, y), 0);
        tile.rays.camera += 1 + u64::from(scene.objects.shown);
        let found = || scene.objects.bvh.closest(ray, |hit| scene.objects.accepts(hit, key, true));
        let object = if scene.objects.shown { found() } else { None };
        let landed = scene.camera_hit(ray);
        let out = -ray.direction;
        let (t, normal) = match (object, landed) {
            (Some(hit), landed)
                if landed.is_none_or(|l| {
                    let slack = scene.objects.slack(&hit, ray.direction);
                    hit.t - slack <= l.t + shift(&scene, camera_rays, &l, ray)
                }) =>
            {
                (hit.t, scene.objects.surface(&hit, out, false, 0.0, Media::default()).normal)
            }
            (_, Some(hit)) => (hit.t, scene.receiver.surface(&hit).normal),
            _ => (f32::INFINITY, Vec3::ZERO),
        };
        let depth = if t.is_finite() {
            f64::from(t) * ray.direction.as_dvec3().dot(camera_rays.axes[2])
        } else {
            f64::INFINITY
        };
        let [a, b, c] = normal.to_array().map(f64::from);
        tile.push(&[depth, a, b, c]);
    }
    tile
}
