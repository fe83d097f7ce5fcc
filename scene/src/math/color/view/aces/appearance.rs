//! The colour appearance model of Hellwig and Fairchild (2022), as ACES 2.0 uses it: complete adaptation to the
//! white, an adapting luminance of 100 cd/m2, a background of 20 %, and a dim surround.

use std::sync::LazyLock;

use crate::math::color::primaries::{Matrix, Primaries, inverse, product, product_vector};
use crate::math::num;

/// Luminance of the display's white, in cd/m2.
pub(super) const PEAK: f64 = 100.0;

/// Lightness J, colourfulness M and hue h of a colour; h in degrees, 0 to 360.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Jmh {
    pub j: f64,
    pub m: f64,
    pub h: f64,
}

/// Primaries of the cone space of CAM16 in the form that ACES 2.0 gives them.
const CONES: Primaries = Primaries {
    red: [0.8336, 0.1735],
    green: [2.3854, -1.4659],
    blue: [0.087, -0.125],
    white: [0.333, 0.333],
};
/// Luminance of the adapted white and adapting luminance, in cd/m2.
const REFERENCE: f64 = 100.0;
const ADAPTING: f64 = 100.0;
/// Luminance of the background relative to white, in percent.
const BACKGROUND: f64 = 20.0;
/// Factors of the dim surround: impact on lightness, and chromatic induction.
const IMPACT: f64 = 0.59;
const INDUCTION: f64 = 0.9;
/// Achromatic response, and the opponent dimensions a and b, from cone responses.
const OPPONENT: Matrix =
    [[2.0, 1.0, 1.0 / 20.0], [1.0, -12.0 / 11.0, 1.0 / 11.0], [1.0 / 9.0, 1.0 / 9.0, -2.0 / 9.0]];
/// Scale and offset of the compression of cone responses.
const RESPONSE_SCALE: f64 = 400.0;
const RESPONSE_OFFSET: f64 = 27.13;
const RESPONSE_POWER: f64 = 0.42;

/// The model for RGB of given primaries, where 1 is the white.
#[derive(Debug, Clone)]
pub(super) struct Appearance {
    /// From RGB to adapted cone responses before compression, and back.
    to_cones: Matrix,
    from_cones: Matrix,
    /// From compressed responses to (A / A of white, a, b), and back.
    to_opponent: Matrix,
    from_opponent: Matrix,
}

impl Appearance {
    /// The model for colours of the given primaries.
    pub fn new(primaries: &Primaries) -> Self {
        let cones = product(&inverse(&CONES.xyz()), &primaries.xyz());
        let white = product_vector(&cones, [1.0; 3]);
        // After adaptation, all cones respond equally to white.
        let to_cones: Matrix = std::array::from_fn(|row| cones[row].map(|v| v * REFERENCE / white[row]));
        let white = OPPONENT[0].iter().sum::<f64>() * CONDITIONS.white;
        let colourfulness = 43.0 * INDUCTION;
        let scale = [1.0 / white, colourfulness, colourfulness];
        let to_opponent: Matrix = std::array::from_fn(|row| OPPONENT[row].map(|v| v * scale[row]));
        Self { from_cones: inverse(&to_cones), from_opponent: inverse(&to_opponent), to_cones, to_opponent }
    }

    /// The correlates of a colour. Colours without an achromatic response are black.
    pub fn jmh(&self, rgb: [f64; 3]) -> Jmh {
        let responses = product_vector(&self.to_cones, rgb).map(response);
        let [achromatic, a, b] = product_vector(&self.to_opponent, responses);
        if achromatic <= 0.0 {
            return Jmh { j: 0.0, m: 0.0, h: 0.0 };
        }
        let degrees = num::atan2(b, a).to_degrees();
        let h = if degrees < 0.0 { degrees + 360.0 } else { degrees };
        Jmh { j: 100.0 * num::pow(achromatic, exponent()), m: (a * a + b * b).sqrt(), h: h % 360.0 }
    }

    /// The colour with the given correlates.
    pub fn rgb(&self, Jmh { j, m, h }: Jmh) -> [f64; 3] {
        let (sin, cos) = num::sin_cos(h.to_radians());
        let achromatic = num::pow(j / 100.0, 1.0 / exponent());
        let responses = product_vector(&self.from_opponent, [achromatic, m * cos, m * sin]);
        product_vector(&self.from_cones, responses.map(stimulus))
    }
}

/// Constants that follow from the viewing conditions.
struct Conditions {
    /// Exponent from relative achromatic response to lightness.
    exponent: f64,
    /// Factor of luminance adaptation, divided by the reference luminance.
    adaptation: f64,
    /// Compressed response of a cone to white.
    white: f64,
}

static CONDITIONS: LazyLock<Conditions> = LazyLock::new(|| {
    let k = 1.0 / (5.0 * ADAPTING + 1.0);
    let k4 = k * k * k * k;
    let factor =
        0.2 * k4 * (5.0 * ADAPTING) + 0.1 * (1.0 - k4) * (1.0 - k4) * num::pow(5.0 * ADAPTING, 1.0 / 3.0);
    let adaptation = factor / REFERENCE;
    let exponent = IMPACT * (1.48 + (BACKGROUND / REFERENCE).sqrt());
    Conditions { exponent, adaptation, white: compressed(REFERENCE * adaptation) }
});

/// Exponent from relative achromatic response to lightness.
pub(super) fn exponent() -> f64 {
    CONDITIONS.exponent
}

/// Lightness of a grey with the luminance `y`, in cd/m2.
pub(super) fn lightness(y: f64) -> f64 {
    let relative = response(y.abs()) / CONDITIONS.white;
    (100.0 * num::pow(relative, exponent())).copysign(y)
}

/// Luminance, in cd/m2, of a grey with the lightness `j`; the inverse of [`lightness`].
pub(super) fn luminance(j: f64) -> f64 {
    let achromatic = CONDITIONS.white * num::pow(j.abs() / 100.0, 1.0 / exponent());
    stimulus(achromatic).copysign(j)
}

/// Compressed response of a cone; an odd function.
fn response(stimulus: f64) -> f64 {
    compressed(stimulus.abs() * CONDITIONS.adaptation).copysign(stimulus)
}

/// Response to an adapted stimulus of 0 or more.
fn compressed(adapted: f64) -> f64 {
    let power = num::pow(adapted, RESPONSE_POWER);
    RESPONSE_SCALE * power / (RESPONSE_OFFSET + power)
}

/// Stimulus of a cone with the given response: the inverse of [`response`]. Responses above the largest possible
/// count as just below it.
fn stimulus(response: f64) -> f64 {
    let size = response.abs().min(RESPONSE_SCALE * (1.0 - 1e-9));
    let power = RESPONSE_OFFSET * size / (RESPONSE_SCALE - size);
    (num::pow(power, 1.0 / RESPONSE_POWER) / CONDITIONS.adaptation).copysign(response)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::color::primaries::{AP1, REC709};

    #[test]
    fn correlates_lead_back_to_the_colour() {
        for primaries in [&AP1, &REC709] {
            let model = Appearance::new(primaries);
            for i in 1..500_u32 {
                let part = |k: u32| f64::from((i * k) % 97) / 96.0 + 1e-3;
                let rgb = [part(7), part(31), part(59)];
                let back = model.rgb(model.jmh(rgb));
                assert!(rgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-9), "{rgb:?} {back:?}");
            }
            let white = model.jmh([1.0; 3]);
            assert!((white.j - 100.0).abs() < 1e-9 && white.m < 1e-9);
        }
    }

    #[test]
    fn lightness_of_greys_inverts() {
        for y in [0.0, 1e-4, 1.0, 18.0, 100.0, 5000.0] {
            assert!((luminance(lightness(y)) - y).abs() <= 1e-9 * y);
        }
        let model = Appearance::new(&REC709);
        assert!((model.jmh([0.18; 3]).j - lightness(18.0)).abs() < 1e-9);
    }
}
