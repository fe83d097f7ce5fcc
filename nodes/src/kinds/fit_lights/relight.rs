//! Inserts the sun into an environment.

use render::light::emitters::{self, Emitter, WHITE};
use render::light::regions;
use scene::math::color::luminance;
use scene::math::equirect::{pixel_solid_angle, uv};
use scene::math::num;
use scene::types::Environment;

use super::incident::shown;
use super::sources::{split, weight};
use super::sun::Sun;

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
    let towards = |at: usize| emitters::texel(env, at).0;
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

/// Returns the environment with other hidden fluxes of its emitters. The hidden light of an emitter keeps its
/// distribution over the texels, and what the panorama shows of it stays the same. Emitters without a flux and all
/// other texels stay the same bit for bit.
pub(super) fn with_fluxes(env: &Environment, emitters: &[(&Emitter, [f64; 3])]) -> Environment {
    let mut lit = env.clone();
    for (emitter, flux) in emitters {
        let hidden = |&at: &usize| split(env, at).1 * emitters::texel(env, at).1;
        let all: f64 = emitter.texels.iter().map(hidden).sum();
        for &at in &emitter.texels {
            let ((_, solid_angle), (shown, more)) = (emitters::texel(env, at), split(env, at));
            let share = weight(more, solid_angle, all, emitter) / solid_angle;
            let texel = &mut lit.image.samples[3 * at..3 * at + 3];
            for ((value, shown), flux) in texel.iter_mut().zip(shown).zip(flux) {
                *value = (shown + flux * share).min(f64::from(f32::MAX)) as f32;
            }
        }
    }
    lit
}
