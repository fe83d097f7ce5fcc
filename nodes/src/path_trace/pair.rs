//! What a part traces for each of its pixels: the receiver alone, then what the objects change and show.

use glam::Vec3;

use super::film::{Sums, TileSums};
use super::lens::Lens;
use super::walk::{Vertex, Walk, World};
use super::{PAIR, R0};
use crate::bvh::{Hit, Ray};
use crate::color::luminance;

/// Adds a sample, unless it is not finite.
pub(super) fn add(sums: &mut [f64], light: Vec3, broken: &mut u64) -> bool {
    if !light.is_finite() {
        *broken += 1;
        return false;
    }
    let rgb = light.to_array();
    for (sum, v) in sums.iter_mut().zip(rgb) {
        *sum += f64::from(v);
    }
    true
}

pub(super) fn squared_luminance(light: Vec3) -> f64 {
    let y = f64::from(luminance(light.to_array()));
    y * y
}

/// What a ray of the camera meets of the receiver.
pub(super) fn receiver_hit(world: &World<'_>, ray: Ray) -> Option<Hit> {
    if world.rules.printed { None } else { world.receiver.bvh.closest(ray, |_| true) }
}

/// The receiver without the objects over some pixels.
pub(super) fn trace_r0(
    world: World<'_>,
    lens: &Lens<'_>,
    pixels: &[(u32, u32)],
    range: (u32, u32),
) -> TileSums {
    let mut tile = TileSums::default();
    for &pixel in pixels {
        let mut sums = [0.0; R0];
        for sample in range.0..range.1 {
            let (points, key, ray) = lens.sample(pixel, sample);
            let mut walk = Walk::new(world, points, key, false);
            let light = match receiver_hit(&world, ray) {
                Some(hit) => walk.radiance::<false>(Vertex::Receiver(hit), ray.direction),
                None => world.sky.seen(ray.direction),
            };
            tile.rays += walk.rays + 1;
            if add(&mut sums, light, &mut tile.broken) {
                sums[3] += squared_luminance(light);
            }
        }
        tile.push(&sums);
    }
    tile
}

/// The receiver with the objects, and the objects, over some pixels. `r0` are the sums of the same samples
/// without objects: a sample none of whose rays meets an object is in them already, bit for bit, so only
/// the others are traced, with and without the objects, for what these change.
pub(super) fn trace_pair(
    world: World<'_>,
    lens: &Lens<'_>,
    pixels: &[(u32, u32)],
    range: (u32, u32),
    r0: &Sums,
) -> TileSums {
    let mut tile = TileSums::default();
    let objects = world.objects;
    for &pixel in pixels {
        let mut sums = [0.0; PAIR];
        let at = (pixel.1 as usize * lens.camera.width_px as usize + pixel.0 as usize) * R0;
        let known: [f64; R0] = std::array::from_fn(|k| f64::from(r0.sums[at + k]));
        let (mut with, mut without) = ([0.0; R0], [0.0; R0]);
        let mut touched = 0;
        let samples = if objects.is_empty() { range.0..range.0 } else { range.0..range.1 };
        for sample in samples {
            let (points, key, ray) = lens.sample(pixel, sample);
            tile.rays += 2;
            let front = objects.bvh.closest(ray, |hit| objects.accepts(hit, key, true));
            let landed = receiver_hit(&world, ray).map(|hit| (hit, shift(&world, lens, &hit, ray)));
            if let Some(front) = front
                && landed.is_none_or(|(hit, shift)| front.t <= hit.t + shift)
            {
                let mut walk = Walk::new(world, points, key, true);
                walk.spread = lens.spread;
                let light = walk.radiance::<false>(Vertex::Object(front), ray.direction);
                tile.rays += walk.rays;
                if add(&mut sums[4..], light, &mut tile.broken) {
                    sums[7] += 1.0;
                    sums[8] += squared_luminance(light);
                }
            }
            let Some((hit, shift)) = landed else { continue };
            let lift = ray.direction * shift;
            let mut probe = Walk::new(world, points, key, true);
            probe.lift = lift;
            probe.radiance::<true>(Vertex::Receiver(hit), ray.direction);
            tile.rays += probe.rays;
            if !probe.touched {
                continue;
            }
            touched += 1;
            for (there, sums) in [(true, &mut with), (false, &mut without)] {
                let mut walk = Walk::new(world, points, key, there);
                walk.lift = lift;
                let light = walk.radiance::<false>(Vertex::Receiver(hit), ray.direction);
                tile.rays += walk.rays;
                let mut counted = 0;
                if add(sums, light, &mut counted) {
                    sums[3] += squared_luminance(light);
                }
                // Without the objects it was counted before.
                tile.broken += if there { counted } else { 0 };
            }
        }
        // Where every sample is touched nothing of the sums without objects is left, nor of their rounding.
        let all = touched == range.1 - range.0;
        for k in 0..R0 {
            sums[k] = if all { with[k] } else { (known[k] + (with[k] - without[k])).max(0.0) };
        }
        tile.untouched += u64::from(touched == 0);
        tile.push(&sums);
    }
    tile
}

/// How far the camera's hit of the receiver moves along its ray to lie where objects stand.
pub(super) fn shift(world: &World<'_>, lens: &Lens<'_>, hit: &Hit, ray: Ray) -> f32 {
    let position = ray.origin + ray.direction * hit.t;
    lens.ground.shift(position, world.receiver.normal(hit.triangle), ray.direction)
}
