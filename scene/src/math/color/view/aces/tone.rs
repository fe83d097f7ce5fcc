//! The tone curve of ACES 2.0.

use super::appearance::{PEAK, lightness, luminance};
use crate::math::num;

/// Contrast.
const CONTRAST: f64 = 1.15;
/// Light of middle grey in the scene, and its luminance on the display in cd/m2.
const GREY: f64 = 0.18;
const SHOWN_GREY: f64 = 10.013;
/// Compensation of flare in the shadows.
const FLARE: f64 = 0.04;
/// Scene light that reaches the white of the display.
const WHITE: f64 = 128.0;
/// Maximum scene light; brighter light is clipped. It is eight times the light that reaches white.
pub(super) const BRIGHTEST: f64 = 8.0 * WHITE;

/// The curve, with the constants that follow from those above.
#[derive(Debug, Clone)]
pub(super) struct ToneCurve {
    /// Scale of the light, in cd/m2, and scale of the result.
    light: f64,
    gain: f64,
}

impl ToneCurve {
    /// The curve for a display with a white of [`PEAK`].
    pub fn new() -> Self {
        // The larger root of x^2 / (x + FLARE) = y.
        let before_flare = |y: f64| 0.5 * (y + (y * (y + 4.0 * FLARE)).sqrt());
        let white = before_flare(1.0);
        let hit = WHITE / white;
        let scale = white / num::pow(hit / (hit + 1.0), CONTRAST);
        let root = num::pow(before_flare(SHOWN_GREY / PEAK) / scale, 1.0 / CONTRAST);
        let grey = white * root / (1.0 - root);
        let stretch = GREY / grey;
        let gain = white / num::pow(hit / (hit + stretch), CONTRAST);
        Self { light: stretch * white * PEAK, gain }
    }

    /// Lightness on the display for a lightness of the scene.
    pub fn lightness(&self, j: f64) -> f64 {
        let y = luminance(j);
        let curve = self.gain * num::pow(y / (y + self.light), CONTRAST);
        lightness((curve * curve / (curve + FLARE)).max(0.0) * PEAK)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Luminances of OpenColorIO 2.6.0. The constants of the specification map middle grey to 10 cd/m2.
    #[test]
    fn grey_and_white_have_their_luminances() {
        let curve = ToneCurve::new();
        let shown = |light: f64| luminance(curve.lightness(lightness(100.0 * light)));
        assert!((shown(GREY) - 9.999_93).abs() < 1e-4);
        assert!((shown(1.0) - 45.756_59).abs() < 1e-4);
        assert!((shown(WHITE) - PEAK).abs() < 1e-9);
        assert_eq!(shown(0.0), 0.0);
    }
}
