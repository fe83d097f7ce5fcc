//! Colour: the sRGB curve (IEC 61966-2-1) and luminance of the working space, whose primaries are those of Rec.709;
//! other colour spaces ([`space`]) and view transforms ([`view`]).

pub mod curve;
pub mod primaries;
pub mod space;
pub mod view;

use curve::Curve;

/// Rec.709 luminance weights, rounded to five digits. The decimal numbers sum to exactly 1.
pub const LUMINANCE: [f32; 3] = [0.21267, 0.71516, 0.07217];

/// Luminance of linear RGB. The weighted components are added in the order R, G, B.
#[inline]
pub fn luminance(rgb: [f32; 3]) -> f32 {
    LUMINANCE[0] * rgb[0] + LUMINANCE[1] * rgb[1] + LUMINANCE[2] * rgb[2]
}

/// Linear light of an sRGB-encoded value. The curve continues below 0 as an odd function and above 1 with the same
/// power, since splat colours may have such values.
#[inline]
pub fn linear_from_srgb(encoded: f32) -> f32 {
    Curve::Srgb.linear(f64::from(encoded)) as f32
}

/// sRGB encoding of linear light; the inverse of [`linear_from_srgb`].
#[inline]
pub fn srgb_from_linear(linear: f32) -> f32 {
    Curve::Srgb.encoded(f64::from(linear)) as f32
}

/// Table of the linear light of each 8-bit sRGB code.
pub fn linear_from_srgb8() -> [f32; 256] {
    std::array::from_fn(|code| linear_from_srgb(code as f32 / 255.0))
}

/// The 8-bit code nearest to a display value. Values below 0 and NaN give 0, values above 1 give 255.
#[inline]
pub fn code8(encoded: f32) -> u8 {
    (encoded.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::row;

    #[test]
    fn every_code_survives_the_round_trip() {
        let changed = |largest: u32| {
            let back = |code: u32| srgb_from_linear(linear_from_srgb(code as f32 / largest as f32));
            (0..=largest).filter(|&code| (back(code) * largest as f32 + 0.5) as u32 != code).count()
        };
        row(60, "8-bit codes that change", changed(255) as f64, 0.0);
        row(60, "16-bit codes that change", changed(65_535) as f64, 0.0);
        assert!((0..=255_u8).all(|code| code8(f32::from(code) / 255.0) == code));
    }

    /// The curve is odd, and continuous to the precision of the standard's rounded constants.
    #[test]
    fn the_curve_is_odd_and_continuous() {
        for x in [0.0, 1e-6_f32, 0.003, 0.2, 1.0, 7.5] {
            assert_eq!(srgb_from_linear(-x).to_bits(), (-srgb_from_linear(x)).to_bits());
            assert_eq!(linear_from_srgb(-x).to_bits(), (-linear_from_srgb(x)).to_bits());
        }
        // The break, rounded to f32, may lie on either side.
        let step =
            |curve: fn(f32) -> f32, at: f32| f64::from((curve(at.next_up()) - curve(at.next_down())).abs());
        row(61, "step at the break, decoding", step(linear_from_srgb, 0.04045), 1e-7);
        row(61, "step at the break, encoding", step(srgb_from_linear, 0.003_130_8), 1e-7);
        assert!(linear_from_srgb(f32::NAN).is_nan() && code8(f32::NAN) == 0 && code8(-3.0) == 0);
        assert_eq!(code8(f32::INFINITY), 255);
    }

    #[test]
    fn luminance_weights_sum_to_one() {
        assert!((luminance([1.0; 3]) - 1.0).abs() < 1e-6);
    }
}
