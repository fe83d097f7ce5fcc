//! Transfer curves of colour spaces: encoded values to linear light and back.

use std::sync::LazyLock;

use crate::math::num::{self, f64::log2, f64::log10};

/// A transfer curve. Encoded values are the codes of a file divided by the largest code; linear values are light,
/// with 0.18 for a grey card and 1 for a white diffuser in scene-referred curves.
///
/// All curves continue beyond the range of their specification: power curves as odd functions, logarithms by the
/// linear segment below and by the same formula above. So [`encoded`](Self::encoded) is the inverse of
/// [`linear`](Self::linear) for all finite values that f64 can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Curve {
    /// Values are proportional to light.
    Linear,
    /// IEC 61966-2-1.
    Srgb,
    /// ITU-R BT.1886 for a display without black level: a power of 2.4.
    Bt1886,
    /// ACEScct (Academy S-2016-001).
    AcesCct,
    /// ARRI LogC3 for exposure index 800 (ARRI, *Alexa LogC curve*, 2017).
    LogC3,
    /// ARRI LogC4 (ARRI, *LogC4 specification*, 2022).
    LogC4,
    /// Sony S-Log3 (*Technical summary for S-Gamut3.Cine/S-Log3 and S-Gamut3/S-Log3*).
    SLog3,
    /// Panasonic V-Log (*V-Log/V-Gamut reference manual*, 2014).
    VLog,
    /// DaVinci Intermediate (Blackmagic Design, *DaVinci Resolve 17: wide gamut intermediate*, 2021).
    DaVinci,
}

impl Curve {
    /// Linear light of an encoded value.
    #[inline]
    pub fn linear(self, encoded: f64) -> f64 {
        let x = encoded;
        match self {
            Curve::Linear => x,
            Curve::Srgb => {
                odd(x, |x| if x <= 0.04045 { x / 12.92 } else { num::pow((x + 0.055) / 1.055, 2.4) })
            }
            Curve::Bt1886 => odd(x, |x| num::pow(x, 2.4)),
            Curve::AcesCct => {
                if x > ACES_CCT_BREAK * ACES_CCT_SLOPE + ACES_CCT_OFFSET {
                    exp2(x * 17.52 - 9.72)
                } else {
                    (x - ACES_CCT_OFFSET) / ACES_CCT_SLOPE
                }
            }
            Curve::LogC3 => {
                let LogC3 { cut, a, b, c, d, e, f } = LOG_C3;
                if x > e * cut + f { (exp10((x - d) / c) - b) / a } else { (x - f) / e }
            }
            Curve::LogC4 => {
                let LogC4 { a, b, c, slope, start } = *LOG_C4;
                if x >= 0.0 { (exp2(14.0 * (x - c) / b + 6.0) - 64.0) / a } else { x * slope + start }
            }
            Curve::SLog3 => {
                let code = x * 1023.0;
                if code >= S_LOG3_BREAK {
                    exp10((code - 420.0) / 261.5) * 0.19 - 0.01
                } else {
                    (code - 95.0) * 0.011_25 / (S_LOG3_BREAK - 95.0)
                }
            }
            Curve::VLog => {
                if x >= 0.181 {
                    exp10((x - V_LOG_D) / V_LOG_C) - V_LOG_B
                } else {
                    (x - 0.125) / 5.6
                }
            }
            Curve::DaVinci => {
                if x > 0.027_406_68 {
                    exp2(x / DAVINCI_C - 7.0) - 0.0075
                } else {
                    x / DAVINCI_M
                }
            }
        }
    }

    /// Encoded value of linear light: the inverse of [`linear`](Self::linear).
    #[inline]
    pub fn encoded(self, linear: f64) -> f64 {
        let x = linear;
        match self {
            Curve::Linear => x,
            Curve::Srgb => {
                odd(x, |x| if x <= 0.003_130_8 { x * 12.92 } else { 1.055 * num::pow(x, 1.0 / 2.4) - 0.055 })
            }
            Curve::Bt1886 => odd(x, |x| num::pow(x, 1.0 / 2.4)),
            Curve::AcesCct => {
                if x > ACES_CCT_BREAK {
                    (log2(x) + 9.72) / 17.52
                } else {
                    x * ACES_CCT_SLOPE + ACES_CCT_OFFSET
                }
            }
            Curve::LogC3 => {
                let LogC3 { cut, a, b, c, d, e, f } = LOG_C3;
                if x > cut { c * log10(a * x + b) + d } else { e * x + f }
            }
            Curve::LogC4 => {
                let LogC4 { a, b, c, slope, start } = *LOG_C4;
                if x >= start { (log2(a * x + 64.0) - 6.0) / 14.0 * b + c } else { (x - start) / slope }
            }
            Curve::SLog3 => {
                let code = if x >= 0.011_25 {
                    420.0 + log10((x + 0.01) / 0.19) * 261.5
                } else {
                    x * (S_LOG3_BREAK - 95.0) / 0.011_25 + 95.0
                };
                code / 1023.0
            }
            Curve::VLog => {
                if x >= 0.01 {
                    V_LOG_C * log10(x + V_LOG_B) + V_LOG_D
                } else {
                    5.6 * x + 0.125
                }
            }
            Curve::DaVinci => {
                if x > 0.002_624_09 {
                    (log2(x + 0.0075) + 7.0) * DAVINCI_C
                } else {
                    x * DAVINCI_M
                }
            }
        }
    }
}

/// Linear value at the break of ACEScct, and slope and offset of its linear segment.
const ACES_CCT_BREAK: f64 = 0.007_812_5;
const ACES_CCT_SLOPE: f64 = 10.540_237_741_654_5;
const ACES_CCT_OFFSET: f64 = 0.072_905_534_195_835_5;

/// The constants of LogC3, named as in its specification.
struct LogC3 {
    cut: f64,
    a: f64,
    b: f64,
    c: f64,
    d: f64,
    e: f64,
    f: f64,
}
/// LogC3 for exposure index 800.
const LOG_C3: LogC3 = LogC3 {
    cut: 0.010_591,
    a: 5.555_556,
    b: 0.052_272,
    c: 0.247_190,
    d: 0.385_537,
    e: 5.367_655,
    f: 0.092_809,
};

/// The constants of LogC4, named as in its specification: `slope` is s, `start` is t.
struct LogC4 {
    a: f64,
    b: f64,
    c: f64,
    slope: f64,
    start: f64,
}
static LOG_C4: LazyLock<LogC4> = LazyLock::new(|| {
    let a = (262_144.0 - 16.0) / 117.45;
    let (b, c) = ((1023.0 - 95.0) / 1023.0, 95.0 / 1023.0);
    let slope = 7.0 * std::f64::consts::LN_2 * exp2(7.0 - 14.0 * c / b) / (a * b);
    let start = (exp2(14.0 * (-c / b) + 6.0) - 64.0) / a;
    LogC4 { a, b, c, slope, start }
});

/// Ten-bit code of S-Log3 at the end of its linear segment.
const S_LOG3_BREAK: f64 = 171.210_294_692_9;
/// The constants b, c and d of V-Log.
const V_LOG_B: f64 = 0.008_73;
const V_LOG_C: f64 = 0.241_514;
const V_LOG_D: f64 = 0.598_206;
/// The constants C and M of DaVinci Intermediate.
const DAVINCI_C: f64 = 0.073_292_48;
const DAVINCI_M: f64 = 10.444_268_55;

/// 2 to the power `x`.
fn exp2(x: f64) -> f64 {
    num::f64::exp2(x)
}

/// 10 to the power `x`.
fn exp10(x: f64) -> f64 {
    num::pow(10.0, x)
}

/// Continues a curve for values of 0 and more as an odd function.
fn odd(x: f64, curve: impl Fn(f64) -> f64) -> f64 {
    curve(x.abs()).copysign(x)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// All curves.
    pub(crate) const ALL: [Curve; 9] = [
        Curve::Linear,
        Curve::Srgb,
        Curve::Bt1886,
        Curve::AcesCct,
        Curve::LogC3,
        Curve::LogC4,
        Curve::SLog3,
        Curve::VLog,
        Curve::DaVinci,
    ];

    /// Greys decoded by OpenColorIO 2.6.0 from the codes 0, 0.1, 0.4 and 1, as 32-bit floats.
    #[test]
    fn decodes_greys_as_opencolorio_does() {
        for (curve, greys) in [
            (Curve::LogC3, [-1.729_048_6e-2, 1.339_623_6e-3, 1.965_507e-1, 5.508_003_6e1]),
            (Curve::LogC4, [-1.805_699_6e-2, 2.274_717_4e-3, 7.376_75e-1, 4.697_999_6e2]),
            (Curve::SLog3, [-1.402_369_6e-2, 1.077_610_4e-3, 1.627_640_9e-1, 3.842_094_8e1]),
            (Curve::VLog, [-2.232_131e-2, -4.464_198e-3, 1.423_889_6e-1, 4.608_553_3e1]),
            (Curve::AcesCct, [-6.916_881e-3, 2.570_570_9e-3, 1.526_182_6e-1, 2.228_608_9e2]),
        ] {
            for (code, grey) in [0.0, 0.1, 0.4, 1.0].into_iter().zip(greys) {
                let own = curve.linear(code);
                // The 32 bits there and constants of more digits move the result by up to 1e-5 of it. Its linear segment of LogC3 continues the
                // logarithm exactly; the published one has rounded constants, which is 7e-8 of light.
                let tolerance = 1e-7 + 1e-5 * f64::abs(grey);
                assert!((own - grey).abs() < tolerance, "{curve:?} {code}: {own}, not {grey}");
            }
        }
    }

    /// Published pairs: 18 % grey is code 400 of 1023 in LogC3 (0.391), 0.2784 in LogC4, 420 in S-Log3, 433 in
    /// V-Log and 0.336043 in DaVinci Intermediate.
    #[test]
    fn middle_grey_has_its_published_code() {
        let grey = |curve: Curve| curve.encoded(0.18);
        assert!((grey(Curve::LogC3) - 0.391_007).abs() < 1e-6);
        assert!((grey(Curve::LogC4) - 0.278_396).abs() < 1e-5);
        assert!((grey(Curve::SLog3) * 1023.0 - 420.0).abs() < 1e-9);
        assert!((grey(Curve::VLog) * 1023.0 - 433.0).abs() < 0.5);
        assert!((grey(Curve::DaVinci) - 0.336_043).abs() < 1e-6);
        assert!((grey(Curve::AcesCct) - 0.413_588).abs() < 1e-6);
    }

    /// Decoding inverts encoding, also for negative light, and curves rise. The constants of the specifications
    /// are rounded, so values next to the break of a curve may take the other formula on the way back: the
    /// tolerance there is the published step, at most 1e-5 of the code.
    #[test]
    fn curves_are_inverses_and_rise() {
        for curve in ALL {
            let mut before = f64::NEG_INFINITY;
            for i in -2000..=6000 {
                let light = if i < 0 {
                    f64::from(i) * 1e-4
                } else {
                    1e-4 * f64::from(i) + 1e-9 * f64::from(i) * f64::from(i) * f64::from(i)
                };
                let code = curve.encoded(light);
                let back = curve.linear(code);
                assert!((back - light).abs() <= 2e-5 * light.abs().max(0.01), "{curve:?} at {light}: {back}");
                assert!(code > before, "{curve:?} falls at {light}");
                before = code;
            }
        }
    }
}
