//! Depth and normal of what is in front.

use glam::Vec3;

use super::film::TileSums;
use super::lens::Lens;
use super::media::Media;
use super::pair::shift;
use super::walk::World;
use crate::sampling::{hash, stream};

/// Depth and normal of what is in front at the centres of some pixels.
pub(super) fn trace_front(world: World<'_>, lens: &Lens<'_>, pixels: &[(u32, u32)]) -> TileSums {
    let mut tile = TileSums::default();
    for &block in pixels {
        let (x, y) = lens.pixel(block);
        let ray = lens.through(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let key = hash(stream(lens.seed, x, y), 0);
        tile.rays.camera += 2;
        let object = world.objects.bvh.closest(ray, |hit| world.objects.accepts(hit, key, true));
        let landed = world.landing(ray);
        let out = -ray.direction;
        let (t, normal) = match (object, landed) {
            (Some(hit), landed) if landed.is_none_or(|l| hit.t <= l.t + shift(&world, lens, &l, ray)) => {
                (hit.t, world.objects.surface(&hit, out, false, 0.0, Media::default()).normal)
            }
            (_, Some(hit)) => (hit.t, world.receiver.surface(&hit).normal),
            _ => (f32::INFINITY, Vec3::ZERO),
        };
        let depth = if t.is_finite() {
            f64::from(t) * ray.direction.as_dvec3().dot(lens.axes[2])
        } else {
            f64::INFINITY
        };
        let [a, b, c] = normal.to_array().map(f64::from);
        tile.push(&[depth, a, b, c]);
    }
    tile
}
