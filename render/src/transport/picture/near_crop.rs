//! Bounds of the change that objects make under near light: see [`super::crop`].
//!
//! A point of the receiver that is visible from the point of capture has the radiance that the panorama shows in
//! its direction, at most `B`. To find the share of this radiance that objects block, one virtual light is chosen
//! at random; objects attenuate the radiance if they lie in front of this light. Objects also add the light that
//! they scatter to the point. Points that are not visible from the point of capture scatter light like any matte
//! surface. With `a` the largest albedo and `E` the maximum irradiance of the sky, no surface exceeds
//!
//! `L = B + a (E / pi + B) + a^2 (E / pi + B) + ..`
//!
//! If there is a gap between the objects and the receiver, one cone contains the directions to the objects from all
//! points of the receiver. As seen from any of these points, the objects have a projected solid angle of at most
//! `P`, they hide at most the light `T` of the sky, and the chosen virtual light lies behind them with a
//! probability of at most `d`. Only pieces of the sky can lie behind the objects, since no object lies between two
//! points of the receiver. Then the radiance of any point changes by at most `D = max(B d, a ((T + P L) / pi +
//! D'))`, where `D'` is `D` for one bounce less. The irradiance of a pixel changes by its own `T + P L`, plus `pi
//! D` for the part of the receiver that may be visible from it.

use std::f64::consts::PI;

use glam::Vec3;

use super::bounds::{LOOKS, greatest_of};
use crate::transport::path::integrator::Scene;
use crate::transport::scene::receiver::Receiver;
use crate::transport::sky::cone::Cone;
use crate::transport::sky::environment::EnvironmentLight;

/// Minimum cosine of the cones that are not subdivided further.
const NARROW: f32 = 0.9;
/// Maximum total solid angle of the cones that are searched for directions in which the receiver is visible, as a
/// multiple of the whole sphere.
const PASSES: f64 = 8.0;

/// Bounds of radiance, per channel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NearBounds {
    /// Upper bound of the radiance of any surface, with or without the objects.
    pub(crate) surfaces: [f64; 3],
    /// Upper bound of how much the objects change the radiance of any receiver point. `None` if objects may lie in
    /// any direction from the point.
    pub(crate) change: Option<[f64; 3]>,
}

impl NearBounds {
    /// Computes the bounds for a scene. `albedo` is the largest albedo of any surface, or `None` if not all
    /// surfaces are matte.
    pub(crate) fn new(scene: &Scene<'_>, albedo: Option<[f64; 3]>, eye: Vec3) -> Self {
        let (brightest, irradiance) = scene.sky.bounds();
        let shown = shown_on(scene.receiver, scene.sky, eye, brightest);
        let bounces = scene.rules.max_bounces.max(1);
        let surfaces: [f64; 3] = std::array::from_fn(|k| {
            let of = |albedo: [f64; 3]| {
                (0..bounces).fold(shown[k], |sent, _| shown[k].max(albedo[k] * (irradiance[k] / PI + sent)))
            };
            albedo.map_or(f64::INFINITY, of).min(brightest[k])
        });
        let change = apart(scene).and_then(|Apart { cone, square }| {
            // Solid angle of a ball seen at that angle, and its projected solid angle seen frontally.
            let solid = [2.0 * PI * square / (1.0 + (1.0 - square).sqrt()), PI * square];
            let chance = scene.light_points?.most_chosen(&cone, solid[0]);
            let (mut sum, mut most) = ([0.0; 3], [0.0; 3]);
            scene.sky.each_around(&cone, |_, _, solid_angle, radiance| {
                (0..3).for_each(|k| sum[k] += radiance[k] * solid_angle);
                most = greatest_of(most, radiance);
            });
            let hidden: [f64; 3] =
                std::array::from_fn(|k| surfaces[k] * solid[1] + sum[k].min(most[k] * solid[1]));
            let albedo = albedo.unwrap_or([1.0; 3]);
            Some(std::array::from_fn(|k| {
                let dimmed = shown[k] * chance;
                (0..bounces).fold(dimmed, |change, _| dimmed.max(albedo[k] * (hidden[k] / PI + change)))
            }))
        });
        Self { surfaces, change }
    }
}

/// Bounds of the directions from the receiver to objects that do not touch it.
pub(crate) struct Apart {
    /// Cone that contains the directions to the objects from all points of the receiver.
    cone: Cone,
    /// Squared sine of an angle: the angular radius of the objects' bounding sphere, as seen from the nearest point
    /// of the receiver's bounding box.
    square: f64,
}

/// Bounds of the directions to the objects, valid for all points of the receiver. `None` if an object may touch the
/// receiver.
pub(crate) fn apart(scene: &Scene<'_>) -> Option<Apart> {
    let ((low, high), objects) = (scene.receiver.bvh.bounds()?, scene.objects.bvh.bounds()?);
    let margin = Vec3::splat(scene.receiver.margin_within(low, high));
    let (low, high) = (low - margin, high + margin);
    let cone = Cone::between([low, high], objects.into());
    let (middle, radius) = ((objects.0 + objects.1) * 0.5, (objects.1 - objects.0).as_dvec3().length() * 0.5);
    let way = (middle - middle.clamp(low, high)).as_dvec3();
    let square = radius * radius / way.length_squared();
    (cone.cosine > 0.0 && square < 1.0).then_some(Apart { cone, square })
}

/// Maximum radiance of the sky in the directions in which the receiver may be visible from `eye`. Returns
/// `brightest`, the maximum over all directions, if the search would take too long.
fn shown_on(receiver: &Receiver, sky: &EnvironmentLight, eye: Vec3, brightest: [f64; 3]) -> [f64; 3] {
    let (mut most, mut left, mut passes) = ([0.0; 3], LOOKS, 0.0);
    receiver.bvh.visit(|corners| {
        let [low, high] = corners.iter().fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], corner| {
            [low.min(*corner - eye), high.max(*corner - eye)]
        });
        let cone = Cone::between([Vec3::ZERO; 2], [low, high]);
        if corners.len() == 8 && cone.cosine < NARROW && left > 0 {
            left -= 1;
            return true;
        }
        passes += 0.5 * (1.0 - f64::from(cone.cosine));
        if passes > PASSES {
            return false;
        }
        // A direction to the node is on the node's side of every plane through the point.
        let reach = 1e-5 * low.abs().max(high.abs()).max_element();
        let [above, below] = [high.cmpge(Vec3::splat(-reach)), low.cmple(Vec3::splat(reach))];
        sky.each_around(&cone, |direction, radius, _, radiance| {
            let sides = (0..3).all(|k| {
                (above.test(k) || direction[k] <= radius) && (below.test(k) || direction[k] >= -radius)
            });
            if sides {
                most = greatest_of(most, radiance);
            }
        });
        false
    });
    if passes > PASSES { brightest } else { most }
}
