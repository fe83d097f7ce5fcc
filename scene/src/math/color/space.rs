//! Colour spaces by name: primaries and transfer curve, and the conversion to and from the working space.

use super::curve::Curve;
use super::primaries::{self as rgb, Matrix, Primaries, inverse, product, product_vector};

/// The light that the numbers of a space describe.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reference {
    /// Light in the scene, without an upper limit.
    Scene,
    /// Light of a display, with 1 for its white.
    Display,
}

engine::choices! {
    /// A colour space. The working space of all light is `LinearRec709`.
    pub enum Space {
        /// Linear light with the primaries of Rec.709: the working space.
        LinearRec709,
        /// Linear light with the primaries of Display P3.
        LinearP3,
        /// Linear light with the primaries of Rec.2020.
        LinearRec2020,
        /// ACEScg: linear light with the primaries AP1.
        AcesCg,
        /// ACES2065-1: linear light with the primaries AP0.
        Aces2065,
        /// ACEScct: logarithmic, with the primaries AP1.
        AcesCct,
        /// ARRI LogC3, exposure index 800, with ARRI Wide Gamut 3.
        LogC3,
        /// ARRI LogC4 with ARRI Wide Gamut 4.
        LogC4,
        /// Sony S-Log3 with S-Gamut3.
        SLog3,
        /// Sony S-Log3 with S-Gamut3.Cine.
        SLog3Cine,
        /// Panasonic V-Log with V-Gamut.
        VLog,
        /// DaVinci Intermediate with DaVinci Wide Gamut.
        DaVinci,
        /// sRGB.
        Srgb,
        /// Rec.709 as shown on a display of BT.1886.
        Rec709,
        /// Display P3: the curve of sRGB with the primaries of P3.
        DisplayP3,
        /// Rec.2020 as shown on a display of BT.1886.
        Rec2020,
    }
}

impl Space {
    /// All spaces.
    pub const ALL: [Space; 16] = [
        Space::LinearRec709,
        Space::LinearP3,
        Space::LinearRec2020,
        Space::AcesCg,
        Space::Aces2065,
        Space::AcesCct,
        Space::LogC3,
        Space::LogC4,
        Space::SLog3,
        Space::SLog3Cine,
        Space::VLog,
        Space::DaVinci,
        Space::Srgb,
        Space::Rec709,
        Space::DisplayP3,
        Space::Rec2020,
    ];

    /// The chromaticities of the space.
    pub fn primaries(self) -> &'static Primaries {
        match self {
            Space::LinearRec709 | Space::Srgb | Space::Rec709 => &rgb::REC709,
            Space::LinearP3 | Space::DisplayP3 => &rgb::P3_D65,
            Space::LinearRec2020 | Space::Rec2020 => &rgb::REC2020,
            Space::AcesCg | Space::AcesCct => &rgb::AP1,
            Space::Aces2065 => &rgb::AP0,
            Space::LogC3 => &rgb::ARRI_WIDE_GAMUT_3,
            Space::LogC4 => &rgb::ARRI_WIDE_GAMUT_4,
            Space::SLog3 => &rgb::S_GAMUT3,
            Space::SLog3Cine => &rgb::S_GAMUT3_CINE,
            Space::VLog => &rgb::V_GAMUT,
            Space::DaVinci => &rgb::DAVINCI_WIDE_GAMUT,
        }
    }

    /// The transfer curve of the space.
    pub fn curve(self) -> Curve {
        match self {
            Space::LinearRec709
            | Space::LinearP3
            | Space::LinearRec2020
            | Space::AcesCg
            | Space::Aces2065 => Curve::Linear,
            Space::AcesCct => Curve::AcesCct,
            Space::LogC3 => Curve::LogC3,
            Space::LogC4 => Curve::LogC4,
            Space::SLog3 | Space::SLog3Cine => Curve::SLog3,
            Space::VLog => Curve::VLog,
            Space::DaVinci => Curve::DaVinci,
            Space::Srgb | Space::DisplayP3 => Curve::Srgb,
            Space::Rec709 | Space::Rec2020 => Curve::Bt1886,
        }
    }

    /// Matrix from linear RGB of the space to ACES2065-1. The spaces of ARRI and Sony are defined with CAT02 between
    /// D65 and the white of ACES; all others are adapted with the Bradford transform.
    fn to_aces(self) -> Matrix {
        match self {
            Space::LogC3 | Space::LogC4 | Space::SLog3 | Space::SLog3Cine => {
                self.primaries().adapted_to(&rgb::AP0, &rgb::CAT02)
            }
            _ => self.primaries().to(&rgb::AP0),
        }
    }

    /// Whether the numbers describe the scene or a display.
    pub fn reference(self) -> Reference {
        match self {
            Space::Srgb | Space::Rec709 | Space::DisplayP3 | Space::Rec2020 => Reference::Display,
            _ => Reference::Scene,
        }
    }
}

/// Conversion of colours from one space to another: decoding, a matrix, encoding. Colours outside the gamut of the
/// target get negative components; nothing is clamped. No view transform is applied between scene and display.
#[derive(Debug, Clone)]
pub struct Conversion {
    from: Curve,
    /// `None` if the primaries are equal, so that values keep their bits.
    matrix: Option<Matrix>,
    to: Curve,
}

impl Conversion {
    /// The conversion from `from` to `to`. Where the spaces adapt white in different ways, it goes through
    /// ACES2065-1, as the ACES configurations of OpenColorIO do.
    pub fn new(from: Space, to: Space) -> Self {
        let by_cat02 = |space: Space| space.to_aces() != space.primaries().to(&rgb::AP0);
        let matrix = (from.primaries() != to.primaries()).then(|| {
            if by_cat02(from) || by_cat02(to) {
                product(&inverse(&to.to_aces()), &from.to_aces())
            } else {
                from.primaries().to(to.primaries())
            }
        });
        Self::with(from.curve(), matrix, to.curve())
    }

    /// A conversion of the given steps. Equal curves around no matrix do nothing.
    pub fn with(from: Curve, matrix: Option<Matrix>, to: Curve) -> Self {
        Self { from, matrix, to }
    }

    /// True if no colour changes.
    pub fn is_identity(&self) -> bool {
        self.matrix.is_none() && self.from == self.to
    }

    /// Converts a colour. The computation is in f64 and rounds once.
    pub fn apply(&self, colour: [f32; 3]) -> [f32; 3] {
        if self.is_identity() {
            return colour;
        }
        let linear = colour.map(|v| self.from.linear(f64::from(v)));
        let linear = self.matrix.as_ref().map_or(linear, |matrix| product_vector(matrix, linear));
        linear.map(|v| self.to.encoded(v) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Round trips through the working space return each colour within the rounding of f32, also for negative
    /// values and for colours outside the gamut. The largest error, relative to the largest component, is 2.4e-7
    /// in linear light.
    #[test]
    fn round_trips_return_the_colour() {
        for space in Space::ALL.into_iter().filter(|space| space.curve() == Curve::Linear) {
            let (there, back) =
                (Conversion::new(space, Space::LinearRec709), Conversion::new(Space::LinearRec709, space));
            for i in 0..1000_u32 {
                let part = |k: u32| ((i * k) % 997) as f32 / 100.0 - 1.0;
                let colour = [part(7), part(131), part(577)];
                let again = back.apply(there.apply(colour));
                let size = colour.iter().fold(0.0_f32, |size, v| size.max(v.abs()));
                for (a, b) in colour.iter().zip(again) {
                    assert!((a - b).abs() <= 2e-6 * size, "{space:?}: {colour:?} became {again:?}");
                }
            }
        }
    }

    #[test]
    fn equal_spaces_keep_every_bit() {
        for space in Space::ALL {
            let same = Conversion::new(space, space);
            assert!(same.is_identity());
            let odd = [f32::from_bits(0x3f12_3457), -1e-41, f32::INFINITY];
            assert_eq!(same.apply(odd).map(f32::to_bits), odd.map(f32::to_bits));
        }
    }

    /// ACES2065-1 of camera colours against OpenColorIO 2.6.0. This test fails if `to_aces` adapts all spaces with
    /// the Bradford transform: saturated colours are then off by up to 2.5 % of the largest component.
    #[test]
    fn camera_colours_agree_with_opencolorio() {
        let codes = [[0.6, 0.5, 0.3], [0.4, 0.4, 0.4]];
        for (space, wanted) in [
            (Space::LogC3, [[1.023_476_6, 0.627_517_2, 0.046_662_16], [0.196_550_7; 3]]),
            (Space::LogC4, [[5.210_346_7, 2.224_675_7, 0.229_448_5], [0.737_675; 3]]),
            (Space::SLog3, [[0.846_464_9, 0.441_902_8, 0.052_186_67], [0.162_764_1; 3]]),
            (Space::SLog3Cine, [[0.780_740_1, 0.442_711_9, 0.021_592_39], [0.162_764_1; 3]]),
            (Space::VLog, [[0.800_149, 0.398_824_2, 0.040_305_95], [0.142_389; 3]]),
        ] {
            let conversion = Conversion::new(space, Space::Aces2065);
            for (code, wanted) in codes.into_iter().zip(wanted) {
                let own = conversion.apply(code);
                let tolerance = 4e-6 * wanted[0];
                for (a, b) in own.iter().zip(wanted) {
                    assert!((a - b).abs() <= tolerance, "{space:?} {code:?}: {own:?}, not {wanted:?}");
                }
            }
        }
        let cct = Conversion::new(Space::AcesCct, Space::Aces2065).apply([0.6, 0.5, 0.3]);
        for (a, b) in cct.iter().zip([1.283_898_7, 0.523_809_1, 0.037_880_1]) {
            assert!((a - b).abs() < 4e-6 * 1.28, "{cct:?}");
        }
        let cg = Conversion::new(Space::AcesCg, Space::Aces2065).apply([0.05, 0.3, 0.8]);
        for (a, b) in cg.iter().zip([0.208_071_49_f32, 0.336_568_53, 0.802_131_83]) {
            assert!((a - b).abs() < 2e-7, "{cg:?}");
        }
    }
}
