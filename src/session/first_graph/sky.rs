//! The light above the object: whether the capture shows it.

use std::f64::consts::PI;

use engine::{NodeError, Up};
use glam::DVec3;
use render::splat::{PanoramaCamera, Settings, panorama};
use scene::math::color::{linear_from_srgb, luminance};
use scene::math::equirect::{axes, direction, pixel_solid_angle};
use scene::types::{SplatEncoding, Splats};

use crate::session::splats::context;

/// Width of the panorama, in pixels.
const WIDTH: u32 = 128;
/// Minimum unseen share of the upper half for light to count as missing, as in `fuse-hdr`.
const LEAST_OPEN: f64 = 0.02;
/// If little of the ground is visible, so that the brightness of the light cannot be estimated from it, the light
/// counts as unknown when the unseen share of the upper half exceeds this value.
const MOSTLY_OPEN: f64 = 0.5;
/// Share of the ground directions below which little ground is visible.
const LITTLE_GROUND: f64 = 0.25;
/// Largest albedo of ground, except fresh snow, as in `fuse-hdr`.
const MOST_ALBEDO: f64 = 0.9;
/// Sine of 20 degrees: directions that are farther than this below the horizon count as ground, as in `fuse-hdr`.
const GROUND_SINE: f64 = 0.342_020_143_325_668_7;
/// Minimum share of the ground directions that must have been seen, as in `fuse-hdr`.
const LEAST_GROUND: f64 = 0.05;

/// The light at the object, as far as the splats show it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sky {
    /// The visible light is plausible.
    Seen,
    /// The visible light is too weak for the brightness of the ground. The number is the share of the upper half,
    /// weighted by the cosine to the up direction, that shows nothing.
    Missing(f64),
    /// Most of the upper half shows nothing, and little ground is visible from which its light could be estimated.
    /// The number is the same share.
    Unknown(f64),
}

impl Sky {
    /// Examines the light that the splats show at a position.
    pub fn at(splats: &Splats, eye: DVec3, up: Up, near: f64) -> Result<Self, NodeError> {
        let settings = Settings { near, sh_degree: 0, ..Settings::default() };
        let camera = PanoramaCamera { eye, up, width_px: WIDTH };
        let seen = panorama(splats, &camera, None, &settings, &context(up))?;
        let linear = |v: f32| if splats.encoding == SplatEncoding::Srgb { linear_from_srgb(v) } else { v };
        let pixel = |&[r, g, b, alpha]: &[f32; 4]| {
            let rgb = [r, g, b].map(|v| if alpha > 0.0 { linear((v / alpha).max(0.0)) } else { 0.0 });
            [f64::from(luminance(rgb)), f64::from(alpha.clamp(0.0, 1.0))]
        };
        Ok(Self::of(&seen.rgba.as_chunks::<4>().0.iter().map(pixel).collect::<Vec<_>>(), up))
    }

    /// Examines a panorama of luminance and coverage, whose width is [`WIDTH`].
    fn of(pixels: &[[f64; 2]], up: Up) -> Self {
        let (width, height) = (WIDTH as usize, WIDTH as usize / 2);
        let (mut ground, mut ground_seen, mut ground_all) = (0.0, 0.0, 0.0);
        let (mut light, mut open, mut all) = (0.0, 0.0, 0.0);
        for (y, row) in pixels.chunks(width).enumerate() {
            let rise = direction(up, 0.5, (y as f64 + 0.5) / height as f64).dot(axes(up)[2]);
            let weight = rise.abs() * pixel_solid_angle(width, height, y);
            for [luminance, alpha] in row {
                if rise > 0.0 {
                    light += weight * luminance * alpha;
                    open += weight * (1.0 - alpha);
                    all += weight;
                } else if rise < -GROUND_SINE {
                    ground_all += weight;
                    if *alpha >= 0.5 {
                        ground_seen += weight;
                        ground += weight * luminance;
                    }
                }
            }
        }
        let share = open / all;
        // Unseen directions are as bright as the visible ones on average, like the filled holes of a panorama.
        let irradiance = light / (1.0 - share).max(f64::MIN_POSITIVE);
        let is_measured = ground_seen > 0.0 && ground_seen >= LEAST_GROUND * ground_all;
        if share > LEAST_OPEN && is_measured && PI * ground / ground_seen > MOST_ALBEDO * irradiance {
            Self::Missing(share)
        } else if share > MOSTLY_OPEN && ground_seen < LITTLE_GROUND * ground_all {
            Self::Unknown(share)
        } else {
            Self::Seen
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ground_that_is_too_bright_for_its_light_has_an_unseen_sky() {
        // Luminance and coverage above, and below the horizon.
        let of = |above: [f64; 2], below: [f64; 2]| {
            let half = (WIDTH * WIDTH / 4) as usize;
            let pixels: Vec<_> = (0..2 * half).map(|i| if i < half { above } else { below }).collect();
            Sky::of(&pixels, Up::PlusZ)
        };
        assert_eq!(of([0.5, 1.0], [0.9, 1.0]), Sky::Seen, "nothing is unseen");
        assert_eq!(of([0.5, 0.7], [0.3, 1.0]), Sky::Seen, "an albedo of 0.6");
        let Sky::Missing(share) = of([0.2, 0.7], [0.3, 1.0]) else { panic!("an albedo of 1.5") };
        assert!((share - 0.3).abs() < 1e-9, "{share}");
        let Sky::Unknown(share) = of([0.1, 0.2], [0.0, 0.0]) else { panic!("no ground and little light") };
        assert!((share - 0.8).abs() < 1e-9, "{share}");
        assert_eq!(of([0.1, 0.9], [0.0, 0.0]), Sky::Seen);
    }
}
