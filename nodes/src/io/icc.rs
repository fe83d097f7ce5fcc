//! ICC profiles (ICC.1:2022), read by `moxcms`. Profiles of sRGB and of linear light are recognised;
//! others are not converted.

use moxcms::{ColorProfile, DataColorSpace, ParsingOptions, ProfileText, ToneReprCurve, Xyzd};

use crate::math::color::linear_from_srgb;
use crate::math::num;

/// Maximum length of a profile in bytes. Display profiles have a few kilobytes, and printer profiles up to 3 MB.
pub const LARGEST: usize = 16 << 20;

/// Meaning of the codes of a picture according to its colour profile.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Meaning {
    /// True if codes are proportional to light.
    pub linear: bool,
    /// Description of what is ignored: the whole profile, or its primaries. `None` if nothing is ignored.
    pub ignored: Option<String>,
}

/// Reads a profile. Its primaries and curve are compared with those of sRGB (IEC 61966-2-1) by value, since names
/// are not reliable: a profile called `Linear sRGB` may have any curve.
pub fn meaning(profile: &[u8]) -> Meaning {
    let options = ParsingOptions { max_profile_size: LARGEST, ..ParsingOptions::default() };
    let Ok(profile) = ColorProfile::new_from_slice_with_options(profile, options) else {
        return Meaning { linear: false, ignored: Some("an ICC profile that cannot be read".to_owned()) };
    };
    let name =
        name(&profile).map_or_else(|| "an ICC profile".to_owned(), |n| format!("an ICC profile (`{n}`)"));
    let (curves, primaries) = match profile.color_space {
        DataColorSpace::Gray => (vec![&profile.gray_trc], true),
        DataColorSpace::Rgb => {
            (vec![&profile.red_trc, &profile.green_trc, &profile.blue_trc], srgb_primaries(&profile))
        }
        _ => return Meaning { linear: false, ignored: Some(name) },
    };
    // With lookup tables to the connection space, the curves alone do not define the profile.
    let tables = profile.lut_a_to_b_perceptual.is_some() || profile.lut_a_to_b_colorimetric.is_some();
    let all = |wanted: &dyn Fn(f64) -> f64| {
        !tables && curves.iter().all(|curve| curve.as_ref().is_some_and(|curve| follows(curve, wanted)))
    };
    let linear = all(&|code| code);
    match (linear || all(&|code| f64::from(linear_from_srgb(code as f32))), primaries) {
        (true, true) => Meaning { linear, ignored: None },
        (true, false) if linear => Meaning {
            linear,
            ignored: Some(format!("the primaries of {name}, which differ from those of sRGB")),
        },
        _ => Meaning { linear: false, ignored: Some(name) },
    }
}

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

/// True if a curve equals `wanted` within [`SAME_LIGHT`].
fn follows(curve: &ToneReprCurve, wanted: impl Fn(f64) -> f64) -> bool {
    (0..=64).all(|i| {
        let code = f64::from(i) / 64.0;
        light(curve, code).is_some_and(|light| (light - wanted(code)).abs() <= SAME_LIGHT)
    })
}

/// Linear light of a code from 0 to 1, as defined in sections 10.6 and 10.18 of the ICC specification; `None` if
/// the form of the curve is unknown.
fn light(curve: &ToneReprCurve, code: f64) -> Option<f64> {
    let value = match curve {
        ToneReprCurve::Lut(table) => match table[..] {
            [] => code,
            // A single entry is a gamma, in 256ths.
            [gamma] => num::pow(code, f64::from(gamma) / 256.0),
            _ => {
                let at = code * (table.len() - 1) as f64;
                let low = (at.floor() as usize).min(table.len() - 2);
                let [a, b] = [table[low], table[low + 1]].map(f64::from);
                (a + (b - a) * (at - low as f64)) / 65_535.0
            }
        },
        ToneReprCurve::Parametric(numbers) => {
            let n: Vec<f64> = numbers.iter().map(|v| f64::from(*v)).collect();
            let power = |base: f64, g: f64| num::pow(base.max(0.0), g);
            match n[..] {
                [g] => power(code, g),
                [g, a, b] => {
                    if a * code + b >= 0.0 {
                        power(a * code + b, g)
                    } else {
                        0.0
                    }
                }
                [g, a, b, c] => {
                    if a * code + b >= 0.0 {
                        power(a * code + b, g) + c
                    } else {
                        c
                    }
                }
                [g, a, b, c, d] => {
                    if code >= d {
                        power(a * code + b, g)
                    } else {
                        c * code
                    }
                }
                [g, a, b, c, d, e, f] => {
                    if code >= d {
                        power(a * code + b, g) + e
                    } else {
                        c * code + f
                    }
                }
                _ => return None,
            }
        }
    };
    value.is_finite().then_some(value)
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
        let decoded = |code: f64| f64::from(linear_from_srgb(code as f32));
        for curve in [srgb_curve(), table(&decoded, 1024), table(&decoded, 4096)] {
            assert_eq!(meaning(&profile("whatever", &srgb, curve.clone())), Meaning::default());
            let ignored = Some("an ICC profile (`sRGB`)".to_owned());
            assert_eq!(meaning(&profile("sRGB", &p3, curve)), Meaning { linear: false, ignored });
        }
        let linear = [vec![1.0], vec![1.0, 1.0, 0.0]].map(ToneReprCurve::Parametric);
        for curve in linear.into_iter().chain([ToneReprCurve::Lut(vec![]), table(&|code| code, 2)]) {
            let made = profile("GIMP built-in Linear sRGB", &srgb, curve.clone());
            assert_eq!(meaning(&made), Meaning { linear: true, ignored: None }, "{curve:?}");
            let other = meaning(&profile("Linear P3", &p3, curve));
            assert!(other.linear && other.ignored.is_some_and(|text| text.contains("primaries")));
        }
        for gamma in [2.2, 1.8] {
            let made = profile("sRGB of gamma", &srgb, ToneReprCurve::Parametric(vec![gamma]));
            assert_eq!(meaning(&made).ignored.as_deref(), Some("an ICC profile (`sRGB of gamma`)"));
        }
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
}
