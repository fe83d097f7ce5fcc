//! Depth and normal of what is in front, at the centre of a pixel and anywhere in it.

use glam::Vec3;

use super::camera_rays::CameraRays;
use super::film::TileSums;
use super::integrator::Scene;
use super::light_distribution::Cone;
use super::media::Media;
use super::objects::Objects;
use super::pair::shift;
use crate::bvh::{Hit, Ray};

/// The most places of a pixel in which objects are looked for.
pub(super) const PLACES: u32 = 16;

/// Depth of what is in front at the centres of some pixels, of the nearest object in so many `places` of them, those of their
/// first samples, and normal.
pub(super) fn trace_first_hit(
    scene: Scene<'_>,
    camera_rays: &CameraRays<'_>,
    pixels: &[(u32, u32)],
    places: u32,
) -> TileSums {
    let mut tile = TileSums::default();
    let shown = scene.objects.shown;
    let bounds = scene.objects.bvh.bounds().map(<[Vec3; 2]>::from);
    let seen = shown && camera_rays.sees(pixels, bounds);
    let planar = |t: f32, ray: &Ray| f64::from(t) * ray.direction.as_dvec3().dot(camera_rays.axes[2]);
    for &block in pixels {
        let (x, y) = camera_rays.pixel(block);
        let ray = camera_rays.through(f64::from(x) + 0.5, f64::from(y) + 0.5);
        tile.rays.camera += 1 + u64::from(shown);
        let landed = scene.camera_hit(ray);
        // Of what is blended, that of which more is seen than of what is behind.
        let front = || scene.objects.bvh.closest(ray, |hit| scene.objects.shows(hit, 0.5));
        let object = if shown { front() } else { None };
        let object = object.filter(|hit| is_before(&scene, camera_rays, ray, hit, landed));
        let (t, normal) = match (object, landed) {
            (Some(hit), _) => {
                let surface = scene.objects.surface(&hit, -ray.direction, false, 0.0, Media::default());
                (hit.t, surface.normal)
            }
            (None, Some(hit)) => (hit.t, scene.receiver.surface(&hit).normal),
            (None, None) => (f32::INFINITY, Vec3::ZERO),
        };
        let depth = if t.is_finite() { planar(t, &ray) } else { f64::INFINITY };
        let mut nearest = None::<f64>;
        let near = seen && any_within(scene.objects, camera_rays.eye, &camera_rays.cone(block, block));
        for number in 0..if near { places } else { 0 } {
            let (_, _, ray) = camera_rays.sample(block, number);
            // Cones are wider than what they hold, so much that of a small object far off they tell too little.
            if !bounds.is_some_and(|bounds| meets_box(&ray, bounds)) {
                continue;
            }
            tile.rays.camera += 1;
            if let Some(hit) = scene.objects.bvh.closest(ray, |hit| scene.objects.shows(hit, 0.0)) {
                tile.rays.camera += 1;
                let landed = scene.camera_hit(ray);
                if is_before(&scene, camera_rays, ray, &hit, landed) {
                    let found = planar(hit.t, &ray);
                    nearest = Some(nearest.map_or(found, |known| known.min(found)));
                }
            }
        }
        let [a, b, c] = normal.to_array().map(f64::from);
        tile.push(&[depth, nearest.unwrap_or(depth), a, b, c]);
    }
    tile
}

/// Whether any triangle of the objects may be seen in a cone; sometimes true where none is.
fn any_within(objects: &Objects, eye: Vec3, cone: &Cone) -> bool {
    let mut found = false;
    objects.bvh.visit(|corners| {
        let start = [Vec3::INFINITY, Vec3::NEG_INFINITY];
        let [low, high] =
            corners.iter().fold(start, |[low, high], &corner| [low.min(corner), high.max(corner)]);
        let meets = !found && cone.meets(&Cone::between([eye; 2], [low, high]));
        found |= meets && corners.len() == 3;
        meets
    });
    found
}

/// Whether a ray may meet a box, with a margin for rounding.
fn meets_box(ray: &Ray, [low, high]: [Vec3; 2]) -> bool {
    let [a, b] = [low, high].map(|corner| (corner - ray.origin) / ray.direction);
    let (enters, leaves) = (a.min(b).max_element(), a.max(b).min_element());
    // What is no number, of a ray along a side, may meet it.
    let misses = enters > leaves * (1.0 + 1e-5) || leaves < 0.0;
    !misses
}

/// Whether an object is met before the receiver.
pub(super) fn is_before(
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
