//! Estimates a sky that the capture does not contain, by comparing the light that the ground reflects with
//! the light that falls on it.
//!
//! A surface of albedo a that reflects a radiance L receives the irradiance pi L / a. Light is missing if the
//! visible ground would have to reflect nearly all light or more, and if part of the upper half was not seen. This
//! is usual for outdoor captures: they seldom contain the sky, and the holes in its place are filled from the trees
//! around them.

use std::f64::consts::PI;

use engine::{Notes, Up};
use render::light::linear::LinearPixels;
use scene::math::color::luminance;
use scene::math::equirect::{axes, direction, pixel_solid_angle};
use scene::types::{Data, Image, Linear};

use super::fused::Fused;
use super::ledger::{Lights, luminance_of};

/// Largest albedo of ground, except fresh snow.
const MOST_ALBEDO: f64 = 0.9;
/// Minimum unseen share of the upper half, weighted by cosine, for a sky to count as missing.
const LEAST_OPEN: f64 = 0.02;
/// Sine of 20 degrees. Directions more than 20 degrees below the horizon count as ground.
const GROUND_SINE: f64 = 0.342_020_143_325_668_7;
/// Minimum alpha of the ground pixels that are measured.
const GROUND_ALPHA: f32 = 0.5;
/// Minimum share of the ground directions, weighted by cosine, that must have been seen for the ground to be
/// measured.
const LEAST_GROUND: f64 = 0.05;

/// Light that a level ground reflects and receives, as luminance. Irradiance is measured on a plane that faces up,
/// as in the report.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Balance {
    /// Mean radiance of the visible ground, weighted by solid angle and by the cosine of the angle to straight
    /// down. These are the weights for a plane above the ground that faces down. `None` if too little was seen.
    ground: Option<f64>,
    /// Irradiance from the upper half.
    light: f64,
    /// Irradiance from the visible part of the upper half, with each pixel weighted by its alpha.
    seen: f64,
    /// Integral of (1 - alpha) times the cosine over the upper half, in steradians.
    open: f64,
    /// `open` divided by the integral of the cosine over the upper half, 0 to 1.
    share: f64,
}

/// Coverage of a pixel, 0 to 1.
fn seen(alpha: f32) -> f64 {
    if alpha > 0.0 { f64::from(alpha.min(1.0)) } else { 0.0 }
}

/// Sine of the elevation of the centre of a row.
fn rise(up: Up, height: usize, y: usize) -> f64 {
    direction(up, 0.5, (y as f64 + 0.5) / height as f64).dot(axes(up)[2])
}

impl Balance {
    /// Computes the balance of a photographed panorama and the light recovered from it. The light of the
    /// ground is taken from the photograph, because clipped pixels on the ground are glints and lamps, whose
    /// recovered light does not depend on the light that falls on the ground.
    pub(super) fn of(up: Up, photograph: &LinearPixels, alpha: &Image<Data>, env: &Image<Linear>) -> Self {
        let (width, height) = (env.width, env.height);
        let (mut ground, mut ground_seen, mut ground_all) = (0.0, 0.0, 0.0);
        let (mut light, mut kept, mut open, mut all) = (0.0, 0.0, 0.0, 0.0);
        for y in 0..height {
            let rise = rise(up, height, y);
            let weight = rise.abs() * pixel_solid_angle(width, height, y);
            for (x, at) in (y * width..(y + 1) * width).enumerate() {
                let alpha = alpha.samples[at];
                if rise > 0.0 {
                    let shone = weight * f64::from(luminance(env.rgb(x, y)));
                    light += shone;
                    kept += shone * seen(alpha);
                    open += weight * (1.0 - seen(alpha));
                    all += weight;
                } else if rise < -GROUND_SINE {
                    ground_all += weight;
                    if alpha >= GROUND_ALPHA {
                        ground_seen += weight;
                        ground += weight * luminance_of(photograph, at);
                    }
                }
            }
        }
        let judged = ground_seen > 0.0 && ground_seen >= LEAST_GROUND * ground_all;
        let share = if all > 0.0 { open / all } else { 0.0 };
        Self { ground: judged.then(|| ground / ground_seen), light, seen: kept, open, share }
    }

    /// Albedo that the ground would have under the recovered light; infinite if no light reaches the ground. `None`
    /// if the ground is black or was not measured.
    fn albedo(&self) -> Option<f64> {
        self.ground.filter(|ground| *ground > 0.0).map(|ground| PI * ground / self.light)
    }

    /// Warns if the ground is brighter than the light allows and part of the upper half was not seen.
    pub(super) fn report(&self, notes: &mut Notes) {
        let Some(albedo) = self.albedo().filter(|albedo| *albedo > MOST_ALBEDO) else { return };
        if self.share > LEAST_OPEN {
            let text = format!(
                "the ground is too bright for the light that falls on it: its albedo would be {albedo:.2}. Light is missing from the {:.1} % of the upper half of the panorama that was not captured; set `ground_albedo` to add this light (grass 0.2, stone or sand 0.3, concrete 0.4)",
                100.0 * self.share
            );
            notes.warning("sky-missing", text);
        }
    }

    /// Radiance that the unseen sky must have so that the ground has the albedo `albedo`. `None` if it cannot be
    /// computed. Adds a note with the radiance or the reason.
    pub(super) fn sky(&self, albedo: f64, notes: &mut Notes) -> Option<f64> {
        let percent = 100.0 * self.share;
        let Some(ground) = self.ground else {
            let text = "`ground_albedo` has no effect: almost nothing was captured more than 20 degrees below the horizon, so the brightness of the ground is unknown";
            notes.warning("ground-albedo-unused", text);
            return None;
        };
        if self.share <= LEAST_OPEN {
            let text = format!(
                "`ground_albedo` has no effect: {:.1} % of the upper half of the panorama was captured, so too little is missing to estimate a sky",
                100.0 - percent
            );
            notes.warning("ground-albedo-unused", text);
            return None;
        }
        let wanted = PI * ground / albedo;
        let radiance = ((wanted - self.seen) / self.open).max(0.0);
        if radiance == 0.0 {
            let text = format!(
                "the captured light gives the ground an irradiance of {:.4}, and an albedo of {albedo} needs only {wanted:.4}, so the {percent:.1} % of the upper half of the panorama that was not captured stays black; with a lower `ground_albedo`, a sky is added there",
                self.seen
            );
            notes.warning("sky-black", text);
        } else {
            let text = format!(
                "the {percent:.1} % of the upper half of the panorama that was not captured became a white sky of radiance {radiance:.4}, which gives the ground (radiance {ground:.4}) an albedo of {albedo}; the irradiance on the ground is {:.4} with this sky and {:.4} without it",
                self.seen + radiance * self.open,
                self.light
            );
            notes.decision("sky-added", text);
        }
        Some(radiance)
    }
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
            let seen = seen(alpha.samples[at]);
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
