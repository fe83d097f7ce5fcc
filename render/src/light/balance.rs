//! Balance between the light that the ground reflects and the light that falls on it, which shows whether a panorama
//! lacks the sky.
//!
//! A surface of albedo a that reflects a radiance L receives the irradiance pi L / a. Light is missing if the
//! visible ground would have to reflect nearly all light or more, and if part of the upper hemisphere was not seen. This
//! is usual for outdoor captures: they seldom contain the sky, and the holes in its place are filled from the trees
//! around them.

use std::f64::consts::PI;

use engine::Up;
use scene::math::equirect::{axes, direction, pixel_solid_angle};

/// Largest albedo of ground, except fresh snow.
const MOST_ALBEDO: f64 = 0.9;
/// Minimum unseen share of the upper hemisphere, weighted by cosine, for a sky to count as missing.
pub const LEAST_OPEN: f64 = 0.02;
/// Sine of 20 degrees. Directions more than 20 degrees below the horizon count as ground.
const GROUND_SINE: f64 = 0.342_020_143_325_668_7;
/// Minimum alpha of the ground pixels that are measured.
const GROUND_ALPHA: f32 = 0.5;
/// Minimum share of the ground directions, weighted by cosine, that must have been seen for the ground to be
/// measured.
const LEAST_GROUND: f64 = 0.05;

/// Light that a level ground reflects and receives, as luminance. Irradiance is measured on a plane that faces up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Balance {
    /// Mean radiance of the visible ground, weighted by solid angle and by the cosine of the angle to straight
    /// down. These are the weights for a plane above the ground that faces down. `None` if too little was seen.
    pub ground: Option<f64>,
    /// Share of the directions of the ground that was seen, weighted by cosine, 0 to 1.
    pub ground_share: f64,
    /// Irradiance from the whole upper hemisphere, visible or not.
    pub light: f64,
    /// Irradiance from the visible part of the upper hemisphere, with each pixel weighted by its alpha.
    pub seen: f64,
    /// Integral of (1 - alpha) times the cosine over the upper hemisphere, in steradians.
    pub open: f64,
    /// `open` divided by the integral of the cosine over the upper hemisphere, 0 to 1.
    pub share: f64,
}

/// Coverage of a pixel whose alpha may be any number, 0 to 1.
pub fn coverage(alpha: f32) -> f64 {
    if alpha > 0.0 { f64::from(alpha.min(1.0)) } else { 0.0 }
}

/// Sine of the elevation of the centre of a row of a panorama.
pub fn rise(up: Up, height: usize, row: usize) -> f64 {
    direction(up, 0.5, (row as f64 + 0.5) / height as f64).dot(axes(up)[2])
}

impl Balance {
    /// Computes the balance of an equirectangular panorama of `width` columns, with one alpha per pixel. `reflected`
    /// is the luminance of a pixel of the ground, and `arriving` that of a pixel of the upper hemisphere.
    pub fn of(
        up: Up,
        width: usize,
        alpha: &[f32],
        reflected: impl Fn(usize) -> f64,
        arriving: impl Fn(usize) -> f64,
    ) -> Self {
        let height = alpha.len() / width.max(1);
        let (mut ground, mut ground_seen, mut ground_all) = (0.0, 0.0, 0.0);
        let (mut light, mut seen, mut open, mut all) = (0.0, 0.0, 0.0, 0.0);
        for y in 0..height {
            let rise = rise(up, height, y);
            let weight = rise.abs() * pixel_solid_angle(width, height, y);
            for at in y * width..(y + 1) * width {
                let alpha = alpha[at];
                if rise > 0.0 {
                    let shone = weight * arriving(at);
                    light += shone;
                    seen += shone * coverage(alpha);
                    open += weight * (1.0 - coverage(alpha));
                    all += weight;
                } else if rise < -GROUND_SINE {
                    ground_all += weight;
                    if alpha >= GROUND_ALPHA {
                        ground_seen += weight;
                        ground += weight * reflected(at);
                    }
                }
            }
        }
        let part = |part: f64, all: f64| if all > 0.0 { part / all } else { 0.0 };
        let is_measured = ground_seen > 0.0 && ground_seen >= LEAST_GROUND * ground_all;
        Self {
            ground: is_measured.then(|| ground / ground_seen),
            ground_share: part(ground_seen, ground_all),
            light,
            seen,
            open,
            share: part(open, all),
        }
    }

    /// Albedo that the ground would have under the light; infinite if no light reaches the ground. `None` if the
    /// ground is black or was not measured.
    fn albedo(&self) -> Option<f64> {
        self.ground.filter(|ground| *ground > 0.0).map(|ground| PI * ground / self.light)
    }

    /// Albedo that the ground would have, if it is more than ground has and part of the upper hemisphere was not seen:
    /// then light is missing.
    pub fn albedo_without_sky(&self) -> Option<f64> {
        self.albedo().filter(|albedo| *albedo > MOST_ALBEDO && self.share > LEAST_OPEN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ground that is brighter than its light allows lacks a sky only if part of the upper hemisphere was not seen. This
    /// test fails if `MOST_ALBEDO` is 2.
    #[test]
    fn ground_that_is_too_bright_for_its_light_has_an_unseen_sky() {
        const WIDTH: usize = 64;
        // Luminance and coverage above, and below the horizon.
        let of = |above: (f64, f32), below: (f64, f32)| {
            let half = WIDTH * WIDTH / 4;
            let alpha: Vec<f32> = (0..2 * half).map(|at| if at < half { above.1 } else { below.1 }).collect();
            Balance::of(Up::PlusZ, WIDTH, &alpha, |_| below.0, |_| above.0)
        };
        assert_eq!(of((0.5, 1.0), (0.9, 1.0)).albedo_without_sky(), None, "nothing is unseen");
        assert_eq!(of((0.5, 0.7), (0.3, 1.0)).albedo_without_sky(), None, "an albedo of 0.6");
        let missing = of((0.2, 0.7), (0.3, 1.0));
        assert!(
            missing.albedo_without_sky().is_some_and(|albedo| (albedo - 1.5).abs() < 0.01),
            "{missing:?}"
        );
        assert!((missing.share - 0.3).abs() < 1e-6, "{missing:?}");
        let dark = of((0.1, 0.2), (0.0, 0.0));
        assert_eq!((dark.ground, dark.ground_share), (None, 0.0));
    }
}
