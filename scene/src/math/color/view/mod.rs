//! View transforms: from scene-referred light to the light of a display.

mod aces;
mod agx;
mod filmic;
mod neutral;

use super::curve::Curve;
use super::primaries::{Matrix, P3_D65, REC709, product_vector};
use super::space::Space;
use aces::Aces;
use agx::AgX;

engine::choices! {
    /// View transform: how scene-referred light is shown on a display, which ends at its white.
    pub enum View {
        /// Shows light as it is. What is brighter than white is clipped.
        Standard,
        /// AgX, the default of Blender since 4.0. Bright colours turn pale gradually, and saturated light does not
        /// change its hue abruptly.
        AgX,
        /// Khronos PBR Neutral: keeps colours below 0.8 almost as they are, so products look as specified, and
        /// compresses highlights.
        PbrNeutral,
        /// The output transform of ACES 2.0 for displays with a white of 100 cd/m2.
        Aces,
        /// The filmic curve of Hable (Uncharted 2), for each channel.
        Filmic,
    }
}

/// A view transform with the exposure before it, into one display space.
#[derive(Debug, Clone)]
pub struct Display {
    look: Look,
    gain: f64,
    /// From Rec.709 to the primaries of the display; `None` if they are the same.
    matrix: Option<Matrix>,
    curve: Curve,
}

/// A view transform with its tables.
#[derive(Debug, Clone)]
enum Look {
    Standard,
    AgX(Box<AgX>),
    PbrNeutral,
    Aces(Box<Aces>),
    Filmic,
}

impl Display {
    /// The transform `view` after a gain of `2^exposure`, encoded for `display`.
    pub fn new(view: View, exposure: f64, display: Space) -> Self {
        let same = *display.primaries() == REC709;
        let matrix = (!same).then(|| REC709.to(display.primaries()));
        let look = match view {
            // Rec.2020 displays are driven within P3, as the Academy's own transforms do.
            View::Aces if display == Space::Rec2020 => Look::Aces(Box::new(Aces::new(&P3_D65))),
            View::Aces => Look::Aces(Box::new(Aces::new(display.primaries()))),
            View::Standard => Look::Standard,
            View::AgX => Look::AgX(Box::new(AgX::new())),
            View::PbrNeutral => Look::PbrNeutral,
            View::Filmic => Look::Filmic,
        };
        Self { look, gain: crate::math::num::f64::exp2(exposure), matrix, curve: display.curve() }
    }

    /// The encoded colour that shows linear light of Rec.709. In the gamut of the display, components lie between
    /// 0 and 1 unless `view` is [`View::Standard`]; other colours may have components outside.
    pub fn apply(&self, light: [f32; 3]) -> [f32; 3] {
        let light = light.map(|v| f64::from(v) * self.gain);
        let shown = match &self.look {
            Look::Aces(aces) => aces.formed(light),
            Look::AgX(agx) => agx.formed(light),
            Look::PbrNeutral => neutral::compressed(light),
            Look::Filmic => light.map(filmic::compressed),
            Look::Standard => light,
        };
        let shown = self.matrix.as_ref().map_or(shown, |matrix| product_vector(matrix, shown));
        shown.map(|v| self.curve.encoded(v) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEWS: [View; 4] = [View::AgX, View::PbrNeutral, View::Aces, View::Filmic];

    /// Greys stay grey, and brighter greys are shown brighter, from black to white.
    #[test]
    fn greys_stay_grey_and_rise() {
        for view in VIEWS {
            let display = Display::new(view, 0.0, Space::Srgb);
            assert!(display.apply([0.0; 3]).iter().all(|v| v.abs() < 1e-6), "{view:?}");
            let mut before = 0.0;
            let mut light = 0.001_f32;
            for _ in 0..200 {
                light *= 1.05;
                let [r, g, b] = display.apply([light; 3]);
                assert!((r - g).abs() < 2e-6 && (g - b).abs() < 2e-6, "{view:?} {light}: {r} {g} {b}");
                assert!(r >= before && r <= 1.0 + 1e-6, "{view:?} {light}: {r} after {before}");
                before = r;
            }
            assert!(before > 0.93, "{view:?} shows 16 as {before}");
        }
    }

    /// Negative, huge and non-finite light gives no result above white or a NaN from a number.
    #[test]
    fn any_light_gives_a_colour_of_the_display() {
        let values = [-5.0, -1e-3, 0.0, 1e-6, 0.18, 1.0, 60.0, 1e8, f32::MAX];
        for view in VIEWS {
            let display = Display::new(view, 0.0, Space::Srgb);
            for r in values {
                for g in values {
                    for b in values {
                        let shown = display.apply([r, g, b]);
                        assert!(
                            shown.iter().all(|v| v.is_finite() && *v <= 1.0 + 1e-5),
                            "{view:?} {r} {g} {b}: {shown:?}"
                        );
                    }
                }
            }
        }
    }

    /// Codes of other programs: Blender 4.5 (AgX at entries of its table; PBR Neutral, whose table it interpolates
    /// within 0.01), and OpenColorIO 2.6.0 (ACES 2.0, `SDR-100nit-REC709_2.0`).
    #[test]
    fn codes_agree_with_other_programs() {
        for (view, tolerance, light, wanted) in [
            (View::AgX, 3e-4, [0.18, 0.18, 0.18], [0.461_36, 0.461_32, 0.461_31]),
            (View::AgX, 3e-4, [21.164_264, 12.081_595, 7.155_843], [1.0, 0.982_618, 0.961_572]),
            (View::PbrNeutral, 1e-2, [1.0, 1.0, 1.0], [0.936_38, 0.936_38, 0.936_38]),
            (View::PbrNeutral, 1e-2, [0.8, 0.2, 0.05], [0.884_61, 0.443_29, 0.139_43]),
            (View::Aces, 5e-4, [0.020_255_2, 0.020_255_2, 0.020_255_2], [0.039_479, 0.039_479, 0.039_479]),
            (View::Aces, 5e-4, [18.197_5, 0.007_096_48, 0.003_066_486], [1.0, 0.754_304, 0.702_376]),
            (View::Aces, 5e-4, [3.613_427, 0.147_437, 8.005_386], [0.865_057, 0.658_992, 1.0]),
            (View::Aces, 5e-4, [-0.018_118_55, -0.032_640_03, 1.452_138_7], [0.0, 0.045_834, 0.856_336]),
        ] {
            let own = Display::new(view, 0.0, Space::Srgb).apply(light);
            let off = own.iter().zip(wanted).map(|(a, b): (&f32, f32)| (a - b).abs()).fold(0.0, f32::max);
            assert!(off < tolerance, "{view:?} {light:?}: {own:?}, not {wanted:?}");
        }
    }

    #[test]
    fn exposure_is_a_gain_before_the_curve() {
        for view in VIEWS {
            let (plain, brighter) =
                (Display::new(view, 0.0, Space::Srgb), Display::new(view, 2.0, Space::Srgb));
            assert_eq!(plain.apply([0.4, 0.8, 0.08]), brighter.apply([0.1, 0.2, 0.02]));
        }
    }

    /// A display of other primaries shows the same light: its code of a colour in the gamut of Rec.709 decodes to
    /// the light that an sRGB display shows.
    #[test]
    fn displays_show_the_same_light() {
        use super::super::space::Conversion;
        for view in VIEWS {
            let srgb = Display::new(view, 0.0, Space::Srgb).apply([0.7, 0.3, 0.1]);
            for space in [Space::DisplayP3, Space::Rec2020, Space::Rec709] {
                let shown = Display::new(view, 0.0, space).apply([0.7, 0.3, 0.1]);
                let back = Conversion::new(space, Space::Srgb).apply(shown);
                assert!(srgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 2e-6), "{srgb:?} {back:?}");
            }
        }
    }
}
