//! A sky that the capture does not contain, estimated from the brightness of the ground.

use std::f64::consts::PI;

use engine::{Notes, Up};
use render::light::balance::{Balance, LEAST_OPEN, coverage, rise};
use scene::math::color::luminance;
use scene::types::{Data, Image, Linear};

use super::fused::Fused;
use super::ledger::Lights;

/// Warns if the ground is brighter than the light allows and part of the upper half was not seen.
pub(super) fn report(balance: &Balance, notes: &mut Notes) {
    if let Some(albedo) = balance.albedo_without_sky() {
        let text = format!(
            "the ground is too bright for the light that falls on it: its albedo would be {albedo:.2}. Light is missing from the {:.1} % of the upper half of the panorama that was not captured; set `ground_albedo` to add this light (grass 0.2, stone or sand 0.3, concrete 0.4)",
            100.0 * balance.share
        );
        notes.warning("sky-missing", text);
    }
}

/// Radiance that the unseen sky must have so that the ground has the albedo `albedo`. `None` if it cannot be
/// computed. Adds a note with the radiance or the reason.
pub(super) fn radiance(balance: &Balance, albedo: f64, notes: &mut Notes) -> Option<f64> {
    let percent = 100.0 * balance.share;
    let Some(ground) = balance.ground else {
        let text = "`ground_albedo` has no effect: almost nothing was captured more than 20 degrees below the horizon, so the brightness of the ground is unknown";
        notes.warning("ground-albedo-unused", text);
        return None;
    };
    if balance.share <= LEAST_OPEN {
        let text = format!(
            "`ground_albedo` has no effect: {:.1} % of the upper half of the panorama was captured, so too little is missing to estimate a sky",
            100.0 - percent
        );
        notes.warning("ground-albedo-unused", text);
        return None;
    }
    let wanted = PI * ground / albedo;
    let radiance = ((wanted - balance.seen) / balance.open).max(0.0);
    if radiance == 0.0 {
        let text = format!(
            "the captured light gives the ground an irradiance of {:.4}, and an albedo of {albedo} needs only {wanted:.4}, so the {percent:.1} % of the upper half of the panorama that was not captured stays black; with a lower `ground_albedo`, a sky is added there",
            balance.seen
        );
        notes.warning("sky-black", text);
    } else {
        let text = format!(
            "the {percent:.1} % of the upper half of the panorama that was not captured became a white sky of radiance {radiance:.4}, which gives the ground (radiance {ground:.4}) an albedo of {albedo}; the irradiance on the ground is {:.4} with this sky and {:.4} without it",
            balance.seen + radiance * balance.open,
            balance.light
        );
        notes.decision("sky-added", text);
    }
    Some(radiance)
}

/// Adds a white sky of uniform radiance behind the visible part above the horizon, in the picture and in the
/// report.
pub(super) fn add(
    radiance: f64,
    up: Up,
    alpha: &Image<Data>,
    env: &mut Image<Linear>,
    fused: &mut [Fused],
    lights: &mut Lights,
) {
    let (width, height) = (env.width, env.height);
    let mut changed = Vec::new();
    for y in (0..height).filter(|&y| rise(up, height, y) > 0.0) {
        let row = y * width..(y + 1) * width;
        let pixels = env.samples[3 * row.start..3 * row.end].as_chunks_mut::<3>().0;
        for ((at, rgb), fused) in row.clone().zip(pixels).zip(&mut fused[row]) {
            let seen = coverage(alpha.samples[at]);
            if seen < 1.0 {
                for value in rgb.iter_mut() {
                    let behind = f64::from(*value) * seen + radiance * (1.0 - seen);
                    *value = behind.min(f64::from(f32::MAX)) as f32;
                }
                fused.luminance = f64::from(luminance(*rgb));
                changed.push((at, fused.luminance));
            }
        }
    }
    lights.record_sky(changed, |at| fused[at].luminance);
}
