//! Error due to light that is counted twice, if the mesh reflects light that the panorama already shows.

use glam::{DVec3, Vec3};
use scene::math::color::luminance;
use scene::math::num;

use super::integrator::{Integrator, Pass, Scene};
use super::path::Vertex;
use super::visibility::Rules;
use crate::geometry::sampling::Points;
use crate::transport::ground::probe::Probe;
use crate::transport::scene::objects::Objects;
use crate::transport::scene::receiver::Receiver;
use crate::transport::sky::environment::EnvironmentLight;

/// Ratio of two sums over the surface points that are visible from `from`: the light that the receiver adds by
/// reflection, divided by the light without this reflection.
pub fn counted_twice(
    receiver: &Receiver,
    sky: &EnvironmentLight,
    origin: DVec3,
    from: Vec3,
    rules: &Rules,
) -> f64 {
    let Ok(objects) = Objects::new(None, &[], origin) else { return 0.0 };
    let light = |bounce_solid| {
        let rules = Rules { bounce_solid, near: None, ..*rules };
        let scene = Scene { receiver, objects: &objects, sky, rules: &rules, light_points: None };
        let seen = Probe::rays(from).zip(0..).filter_map(|(ray, i)| {
            let hit = scene.receiver.bvh.closest(ray, |_| true)?;
            let mut integrator = Integrator::new(scene, i, Pass::new(Points::new(1, i), false));
            Some(luminance(integrator.radiance(Vertex::Receiver(hit), ray).to_array()))
        });
        num::ordered_sum(seen)
    };
    let once = light(false);
    if once > 0.0 { light(true) / once - 1.0 } else { 0.0 }
}
