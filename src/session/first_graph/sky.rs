//! The light above the object: whether the capture shows it.

use engine::{NodeError, Up};
use glam::DVec3;
use render::light::balance::Balance;
use render::light::holes;
use render::light::panorama::linear_row;
use render::splat::{PanoramaCamera, Settings, panorama};
use scene::math::color::luminance;
use scene::types::{SplatEncoding, Splats};

use crate::session::splats::context;

/// Width of the panorama, in pixels.
const WIDTH: u32 = 128;
/// Alpha below which pixels are filled from their surroundings, as in `stitch`.
const HOLE_ALPHA: f32 = 0.25;
/// If little of the ground is visible, so that the brightness of the light cannot be estimated from it, the light
/// counts as unknown when the unseen share of the upper half exceeds this value.
const MOSTLY_OPEN: f64 = 0.5;
/// Share of the ground directions below which little ground is visible.
const LITTLE_GROUND: f64 = 0.25;

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
        let cx = context(up);
        let seen = panorama(splats, &camera, None, &settings, &cx)?;
        let linear = linear_row(seen.rgba.as_chunks::<4>().0, splats.encoding == SplatEncoding::Srgb);
        let filled = holes::fill(&linear, WIDTH as usize, HOLE_ALPHA, &cx)?;
        let alpha: Vec<f32> = linear.iter().map(|pixel| pixel[3]).collect();
        Ok(Self::of(up, &filled, &alpha))
    }

    /// Examines a panorama without holes, and its coverage before they were filled.
    fn of(up: Up, filled: &[[f32; 3]], alpha: &[f32]) -> Self {
        let light = |at: usize| f64::from(luminance(filled[at]));
        let balance = Balance::of(up, WIDTH as usize, alpha, light, light);
        if balance.albedo_without_sky().is_some() {
            Self::Missing(balance.share)
        } else if balance.share > MOSTLY_OPEN && balance.ground_share < LITTLE_GROUND {
            Self::Unknown(balance.share)
        } else {
            Self::Seen
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_seen_missing_or_unknown() {
        // Luminance and coverage above, and below the horizon.
        let of = |above: (f32, f32), below: (f32, f32)| {
            let half = (WIDTH * WIDTH / 4) as usize;
            let each = |i: usize| if i < half { above } else { below };
            let (filled, alpha): (Vec<_>, Vec<_>) =
                (0..2 * half).map(each).map(|(light, alpha)| ([light; 3], alpha)).unzip();
            Sky::of(Up::PlusZ, &filled, &alpha)
        };
        assert_eq!(of((0.5, 0.7), (0.3, 1.0)), Sky::Seen, "an albedo of 0.6");
        let Sky::Missing(share) = of((0.2, 0.7), (0.3, 1.0)) else { panic!("an albedo of 1.5") };
        assert!((share - 0.3).abs() < 1e-6, "{share}");
        let Sky::Unknown(share) = of((0.1, 0.2), (0.0, 0.0)) else { panic!("no ground and little light") };
        assert!((share - 0.8).abs() < 1e-6, "{share}");
        assert_eq!(of((0.1, 0.9), (0.0, 0.0)), Sky::Seen);
    }
}
