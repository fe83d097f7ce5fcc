//! ICC profiles (ICC.1:2022), read by `moxcms`. Profiles of sRGB are recognised, and colours of profiles with a
//! curve for each channel and a matrix are converted. The conversion is our own, in f64: that of the crate uses
//! vector instructions, which round differently on different machines.

use moxcms::{ColorProfile, DataColorSpace, ParsingOptions, ProfileText, ToneReprCurve, Xyzd};

use crate::math::color::linear_from_srgb;
use crate::math::color::primaries::{
    D65, IDENTITY, Matrix, REC709, bradford, inverse, product, product_vector,
};
use crate::math::num;

/// Maximum length of a profile in bytes. Display profiles have a few kilobytes, and printer profiles up to 3 MB.
pub const LARGEST: usize = 16 << 20;

/// Meaning of the codes of a picture according to its profile.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Meaning {
    /// The profile to convert colours with; `None` if the codes are those of sRGB, or if the profile is ignored.
    pub profile: Option<Profile>,
    /// Description of a profile that is ignored.
    pub ignored: Option<String>,
}

/// A profile of RGB or grey codes: a curve for each channel, and a matrix.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Description of the profile, cut to 64 characters; empty if it has none.
    pub name: String,
    curves: [ToneCurve; 3],
    /// From linear light of the profile to linear Rec.709.
    rec709: Matrix,
}

impl Profile {
    /// True if codes are proportional to light.
    pub fn is_linear(&self) -> bool {
        self.curves.iter().all(|curve| curve.follows(|code| code))
    }

    /// Linear light of Rec.709 for codes from 0 to 1.
    pub fn light(&self, codes: [f32; 3]) -> [f32; 3] {
        let light = [0, 1, 2].map(|i| self.curves[i].light(f64::from(codes[i])));
        product_vector(&self.rec709, light).map(|v| v as f32)
    }
}

/// Reads a profile. Its primaries and curves are compared with those of sRGB (IEC 61966-2-1) by value, since names
/// are not reliable: a profile called `Linear sRGB` may have any curve.
pub fn meaning(profile: &[u8]) -> Meaning {
    let ignored = |what: String| Meaning { profile: None, ignored: Some(what) };
    let options = ParsingOptions { max_profile_size: LARGEST, ..ParsingOptions::default() };
    match ColorProfile::new_from_slice_with_options(profile, options) {
        Ok(profile) => of_profile(&profile),
        Err(_) => ignored("an ICC profile that cannot be read".to_owned()),
    }
}

/// The meaning of codes in Adobe RGB (1998), which cameras state without a profile.
pub fn adobe_rgb() -> Meaning {
    let mut meaning = of_profile(&ColorProfile::new_adobe_rgb());
    if let Some(profile) = &mut meaning.profile {
        profile.name = "Adobe RGB (1998)".to_owned();
    }
    meaning
}

fn of_profile(profile: &ColorProfile) -> Meaning {
    let ignored = |what: String| Meaning { profile: None, ignored: Some(what) };
    let name = name(profile);
    let described =
        name.as_ref().map_or_else(|| "an ICC profile".to_owned(), |n| format!("an ICC profile (`{n}`)"));
    let (curves, srgb, rec709) = match profile.color_space {
        DataColorSpace::Gray => ([&profile.gray_trc; 3], true, IDENTITY),
        DataColorSpace::Rgb => (
            [&profile.red_trc, &profile.green_trc, &profile.blue_trc],
            srgb_primaries(profile),
            rec709_from(profile),
        ),
        _ => return ignored(described),
    };
    // With lookup tables to the connection space, the curves alone do not define the profile.
    let tables = profile.lut_a_to_b_perceptual.is_some() || profile.lut_a_to_b_colorimetric.is_some();
    let curves = curves.map(|curve| curve.as_ref().and_then(ToneCurve::of));
    let [Some(red), Some(green), Some(blue)] = curves else { return ignored(described) };
    let curves = [red, green, blue];
    if tables || !rec709.iter().flatten().all(|v| v.is_finite() && v.abs() < 1e3) {
        return ignored(described);
    }
    let display = |code: f64| f64::from(linear_from_srgb(code as f32));
    if srgb && curves.iter().all(|curve| curve.follows(display)) {
        return Meaning::default();
    }
    let rec709 = if srgb { IDENTITY } else { rec709 };
    Meaning { profile: Some(Profile { name: name.unwrap_or_default(), curves, rec709 }), ignored: None }
}

/// The matrix from linear light of a profile to linear Rec.709. The colorants of a profile are adapted to D50.
fn rec709_from(profile: &ColorProfile) -> Matrix {
    let colorants = [profile.red_colorant, profile.green_colorant, profile.blue_colorant];
    let column = |Xyzd { x, y, z }: Xyzd| [x, y, z];
    let columns = colorants.map(column);
    let xyz = std::array::from_fn(|row| std::array::from_fn(|column| columns[column][row]));
    product(&inverse(&REC709.xyz()), &product(&bradford(D50, D65), &xyz))
}

/// Chromaticity of the white of the profile connection space, whose XYZ is (0.9642, 1, 0.8249).
const D50: [f64; 2] = [0.9642 / (0.9642 + 1.0 + 0.8249), 1.0 / (0.9642 + 1.0 + 0.8249)];

/// The name of a profile, truncated to 64 characters.
fn name(profile: &ColorProfile) -> Option<String> {
    let text = match profile.description.as_ref()? {
        ProfileText::PlainString(text) => text,
        ProfileText::Localizable(texts) => &texts.first()?.value,
        ProfileText::Description(text) => &text.ascii_string,
    };
    let text: String = text.chars().filter(|c| !c.is_control()).take(64).collect();
    Some(text).filter(|text| !text.is_empty())
}

/// Maximum difference, in XYZ, between colorants that count as equal. The colorants of Display P3 differ from those
/// of sRGB by 0.08.
const SAME_COLORANT: f64 = 0.003;

/// True if the colorants, adapted to D50, are those of sRGB.
fn srgb_primaries(profile: &ColorProfile) -> bool {
    let srgb =
        [[0.436_07, 0.222_49, 0.013_92], [0.385_15, 0.716_87, 0.097_08], [0.143_07, 0.060_61, 0.714_1]];
    let own = [profile.red_colorant, profile.green_colorant, profile.blue_colorant];
    own.iter().zip(srgb).all(|(Xyzd { x, y, z }, srgb)| {
        [x, y, z].into_iter().zip(srgb).all(|(own, srgb)| (own - srgb).abs() <= SAME_COLORANT)
    })
}

/// Maximum difference, in linear light, between curves that count as equal. A pure gamma of 2.2 differs from sRGB
/// by 0.008.
const SAME_LIGHT: f64 = 0.003;

/// The curve of a channel, by sections 10.6 and 10.18 of the specification.
#[derive(Debug, Clone, PartialEq)]
enum ToneCurve {
    /// Codes are light.
    Identity,
    /// Light is the code to this power.
    Gamma(f64),
    /// Light at equally spaced codes, at least two, 0 to 1.
    Table(Vec<f64>),
    /// A function of type 1 to 4, with its parameters g, a, b, c, d, e, f; those that a type lacks are set so that
    /// all types are the last one.
    Parametric([f64; 7]),
}

impl ToneCurve {
    /// The curve of a profile; `None` if its form is unknown or its numbers are not finite.
    fn of(curve: &ToneReprCurve) -> Option<Self> {
        let curve = match curve {
            ToneReprCurve::Lut(table) => match table[..] {
                [] => ToneCurve::Identity,
                // A single entry is a gamma, in 256ths.
                [gamma] => ToneCurve::Gamma(f64::from(gamma) / 256.0),
                _ => ToneCurve::Table(table.iter().map(|v| f64::from(*v) / 65_535.0).collect()),
            },
            ToneReprCurve::Parametric(numbers) => {
                let n: Vec<f64> = numbers.iter().map(|v| f64::from(*v)).collect();
                // Types 1 and 2 are constant below the zero of `a x + b`.
                let zero = |a: f64, b: f64| if a == 0.0 { 0.0 } else { -b / a };
                match n[..] {
                    [g] => ToneCurve::Gamma(g),
                    [g, a, b] => ToneCurve::Parametric([g, a, b, 0.0, zero(a, b), 0.0, 0.0]),
                    [g, a, b, c] => ToneCurve::Parametric([g, a, b, 0.0, zero(a, b), c, c]),
                    [g, a, b, c, d] => ToneCurve::Parametric([g, a, b, c, d, 0.0, 0.0]),
                    [g, a, b, c, d, e, f] => ToneCurve::Parametric([g, a, b, c, d, e, f]),
                    _ => return None,
                }
            }
        };
        let finite = match &curve {
            ToneCurve::Identity | ToneCurve::Table(_) => true,
            ToneCurve::Gamma(gamma) => gamma.is_finite() && *gamma > 0.0,
            ToneCurve::Parametric(numbers) => {
                numbers.iter().all(|v| v.is_finite())
                    && (0..=64).all(|i| curve.light(f64::from(i) / 64.0).is_finite())
            }
        };
        finite.then_some(curve)
    }

    /// Linear light of a code from 0 to 1.
    fn light(&self, code: f64) -> f64 {
        match self {
            ToneCurve::Identity => code,
            ToneCurve::Gamma(gamma) => num::pow(code.max(0.0), *gamma),
            ToneCurve::Table(table) => {
                let at = code.clamp(0.0, 1.0) * (table.len() - 1) as f64;
                let low = (at.floor() as usize).min(table.len() - 2);
                table[low] + (table[low + 1] - table[low]) * (at - low as f64)
            }
            ToneCurve::Parametric([g, a, b, c, d, e, f]) => {
                if code >= *d {
                    num::pow((a * code + b).max(0.0), *g) + e
                } else {
                    c * code + f
                }
            }
        }
    }

    /// True if the curve equals `wanted` within [`SAME_LIGHT`].
    fn follows(&self, wanted: impl Fn(f64) -> f64) -> bool {
        (0..=64).all(|i| {
            let code = f64::from(i) / 64.0;
            (self.light(code) - wanted(code)).abs() <= SAME_LIGHT
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A profile with the colorants of `base` and one curve for all channels.
    pub(crate) fn profile(name: &str, base: &ColorProfile, curve: ToneReprCurve) -> Vec<u8> {
        let mut profile = base.clone();
        (profile.red_trc, profile.green_trc, profile.blue_trc) =
            (Some(curve.clone()), Some(curve.clone()), Some(curve));
        profile.cicp = None;
        profile.description = Some(ProfileText::PlainString(name.to_owned()));
        profile.encode().expect("is a profile")
    }

    fn srgb_curve() -> ToneReprCurve {
        ToneReprCurve::Parametric(vec![2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.040_45])
    }

    // A profile called `Linear sRGB` used to be treated as sRGB, because of its name.
    #[test]
    fn curves_and_primaries_count_and_names_do_not() {
        let (srgb, p3) = (ColorProfile::new_srgb(), ColorProfile::new_display_p3());
        let table = |f: &dyn Fn(f64) -> f64, n: usize| {
            let entry = |i| (f(i as f64 / (n - 1) as f64) * 65_535.0).round() as u16;
            ToneReprCurve::Lut((0..n).map(entry).collect())
        };
        let light = |profile: &[u8], codes: [f32; 3]| {
            let found = meaning(profile);
            assert_eq!(found.ignored, None);
            found.profile.map(|p| (p.is_linear(), p.light(codes)))
        };
        // Profiles store colorants in steps of 1.5e-5, which the matrix enlarges.
        let near = |a: [f32; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-3);
        let decoded = |code: f64| f64::from(linear_from_srgb(code as f32));
        for curve in [srgb_curve(), table(&decoded, 1024), table(&decoded, 4096)] {
            assert_eq!(meaning(&profile("whatever", &srgb, curve.clone())), Meaning::default());
            let (linear, red) = light(&profile("sRGB", &p3, curve), [1.0, 0.0, 0.0]).expect("differs");
            // The published matrix of linear P3 to linear sRGB.
            assert!(!linear && near(red, [1.224_94, -0.042_06, -0.019_64]), "{red:?}");
        }
        let linear = [vec![1.0], vec![1.0, 1.0, 0.0]].map(ToneReprCurve::Parametric);
        for curve in linear.into_iter().chain([ToneReprCurve::Lut(vec![]), table(&|code| code, 2)]) {
            let made = profile("GIMP built-in Linear sRGB", &srgb, curve.clone());
            let (linear, colour) = light(&made, [0.5, 0.25, 1.0]).expect("differs");
            assert!(linear && near(colour, [0.5, 0.25, 1.0]), "{curve:?}: {colour:?}");
            let (linear, white) = light(&profile("Linear P3", &p3, curve), [0.5; 3]).expect("differs");
            assert!(linear && near(white, [0.5; 3]), "{white:?}");
        }
        for gamma in [2.2_f32, 1.8] {
            let made = profile("sRGB of gamma", &srgb, ToneReprCurve::Parametric(vec![gamma]));
            let (linear, grey) = light(&made, [0.5; 3]).expect("differs");
            assert!(!linear && near(grey, [num::pow(0.5, f64::from(gamma)); 3]), "{grey:?}");
        }
    }

    /// Types 1 and 2 of the specification are constant below their zero.
    #[test]
    fn parametric_curves_follow_the_specification() {
        let of = |numbers: &[f32]| {
            ToneCurve::of(&ToneReprCurve::Parametric(numbers.to_vec())).expect("is a curve")
        };
        assert_eq!(of(&[2.0, 2.0, -1.0]).light(0.25), 0.0);
        assert_eq!(of(&[2.0, 2.0, -1.0]).light(1.0), 1.0);
        assert_eq!(of(&[2.0, 2.0, -1.0, 0.125]).light(0.25), 0.125);
        assert_eq!(of(&[2.0, 2.0, -1.0, 0.125]).light(1.0), 1.125);
        assert_eq!(of(&[2.0, 1.0, 0.0, 0.5, 0.5]).light(0.25), 0.125);
        assert_eq!(of(&[2.0, 1.0, 0.0, 0.5, 0.5, 0.25, 0.75]).light(1.0), 1.25);
        assert_eq!(ToneCurve::of(&ToneReprCurve::Parametric(vec![f32::NAN])), None);
        assert_eq!(ToneCurve::of(&ToneReprCurve::Parametric(vec![])), None);
    }

    #[test]
    fn no_cut_or_flip_panics() {
        let whole = profile("sRGB", &ColorProfile::new_srgb(), srgb_curve());
        for cut in 0..whole.len() {
            drop(meaning(&whole[..cut]));
            let mut hurt = whole.clone();
            hurt[cut] ^= 1 << (cut % 8);
            drop(meaning(&hurt));
        }
        assert_eq!(meaning(&[]).ignored.as_deref(), Some("an ICC profile that cannot be read"));
    }

    /// Full green of Adobe RGB is outside Rec.709, and a middle code has the light of its gamma of 563/256.
    #[test]
    fn adobe_rgb_is_known_without_a_profile() {
        let profile = adobe_rgb().profile.expect("a profile");
        let grey = profile.light([0.5; 3]);
        let expected = num::powf(0.5, 563.0 / 256.0);
        assert!(grey.iter().all(|v| (v - expected).abs() < 1e-3), "{grey:?} {expected}");
        let green = profile.light([0.0, 1.0, 0.0]);
        assert!((green[0] + 0.398).abs() < 0.01 && (green[1] - 1.0).abs() < 0.01, "{green:?}");
    }
}
