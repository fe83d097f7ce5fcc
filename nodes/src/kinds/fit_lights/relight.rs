//! Inserts the sun into an environment.

use glam::DVec3;

use super::incident::{WHITE, shown};
use super::sun::Sun;
use crate::light::regions;
use crate::math::color::luminance;
use crate::math::equirect::{direction, pixel_solid_angle, uv};
use crate::math::num;
use crate::types::Environment;

/// Angular radius of the sun, in degrees.
const RADIUS_DEG: f64 = 0.27;

/// Returns the environment with the sun. The clipped region around the sun keeps the fitted glow in place of the
/// light that was predicted for it, and the irradiance of the sun is distributed over the texels of its disc (at
/// least one texel). All other texels stay the same bit for bit.
pub(super) fn with_sun(env: &Environment, sun: &Sun) -> Environment {
    let mut lit = env.clone();
    let (width, height) = (env.image.width, env.image.height);
    let mask: Vec<bool> =
        env.image.samples.chunks_exact(3).map(|c| luminance([c[0], c[1], c[2]]) >= WHITE).collect();
    let labels = regions::label(&mask, width);
    let towards = |at: usize| texel_direction(env, at);
    let nearest = (0..mask.len()).filter(|&at| mask[at]).max_by(|&a, &b| {
        towards(a).dot(sun.direction).total_cmp(&towards(b).dot(sun.direction)).then(b.cmp(&a))
    });
    if let Some(region) = nearest.and_then(|at| labels.of[at]) {
        for at in (0..mask.len()).filter(|&at| labels.of[at] == Some(region)) {
            let (base, _) = shown(env, towards(at));
            let glow = base * sun.glow as f32;
            // Never brighter than what was predicted for the texel.
            let texel = &mut lit.image.samples[3 * at..3 * at + 3];
            texel.iter_mut().zip(glow.to_array()).for_each(|(value, glow)| *value = value.min(glow));
        }
    }
    let cosine = num::f64::cos(RADIUS_DEG.to_radians());
    let mut disc: Vec<usize> =
        (0..width * height).filter(|&at| towards(at).dot(sun.direction) >= cosine).collect();
    if disc.is_empty() {
        let (u, v) = uv(env.up, sun.direction);
        let at = |t: f64, n: usize| ((t * n as f64) as usize).min(n - 1);
        disc.push(at(v, height) * width + at(u, width));
    }
    let solid_angle: f64 = disc.iter().map(|at| pixel_solid_angle(width, height, at / width)).sum();
    for at in disc {
        let texel = &mut lit.image.samples[3 * at..3 * at + 3];
        for (value, irradiance) in texel.iter_mut().zip(sun.irradiance) {
            *value = (f64::from(*value) + irradiance / solid_angle).min(f64::from(f32::MAX)) as f32;
        }
    }
    lit
}

fn texel_direction(env: &Environment, at: usize) -> DVec3 {
    let (width, height) = (env.image.width, env.image.height);
    let [u, v] = [(at % width) as f64 + 0.5, (at / width) as f64 + 0.5];
    direction(env.up, u / width as f64, v / height as f64)
}
