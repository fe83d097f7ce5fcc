//! The objects that the samples of a pixel show.

use super::camera_rays::CameraRays;
use super::pair::{BLENDED, shift_on};
use crate::transport::scene::objects::Objects;
use crate::transport::scene::receiver::Receiver;

/// Numbers of samples of a pixel that show each object, as pairs of the index of the object and a number above 0,
/// sorted by index. The samples are the first of those with which `trace_pair` traces the objects, and the same rule
/// decides which of several surfaces a sample shows; so all numbers together are the alpha of the objects times the
/// number of samples. Increments `rays` for each ray.
pub fn shown_objects(
    (objects, receiver): (&Objects, &Receiver),
    camera_rays: &CameraRays<'_>,
    pixel: (u32, u32),
    samples: u32,
    rays: &mut u64,
) -> Vec<(u32, u32)> {
    let mut shown: Vec<(u32, u32)> = Vec::new();
    if !camera_rays.may_show(objects, pixel) {
        return shown;
    }
    for number in 0..samples {
        let (points, _, ray) = camera_rays.sample(pixel, number);
        let Some((front, _)) = objects.front(ray, points.bits(BLENDED)[0], rays) else { continue };
        *rays += 1;
        let landed = receiver.bvh.closest(ray, |_| true);
        let reach = landed.map_or(f32::INFINITY, |hit| hit.t + shift_on(receiver, camera_rays, &hit, ray));
        if front.t - objects.slack(&front, ray.direction) > reach {
            continue;
        }
        let object = objects.part(front.triangle).0.placed as u32;
        match shown.binary_search_by_key(&object, |(object, _)| *object) {
            Ok(at) => shown[at].1 += 1,
            Err(at) => shown.insert(at, (object, 1)),
        }
    }
    shown
}
