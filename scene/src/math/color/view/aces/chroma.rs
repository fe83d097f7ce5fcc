//! Compression of colourfulness within the gamut.

use std::sync::LazyLock;

use super::appearance::{Jmh, PEAK, exponent};
use super::gamut::Limits;
use crate::math::num;

/// Strengths of the expansion of dull colours, and of the compression.
const EXPANSION: f64 = 1.3;
const COMPRESSION: f64 = 2.4;
/// Softness of the expansion next to black, which would amplify noise.
const NOISE: f64 = 0.5 / PEAK;

/// The colourfulness of a colour whose lightness has become `toned`: scaled with the lightness so that its
/// chromaticity stays, then increased in shadows and middle tones and decreased in highlights.
pub(super) fn compressed(seen: Jmh, toned: f64, limits: &Limits) -> f64 {
    if seen.m == 0.0 || seen.j <= 0.0 || toned <= 0.0 {
        return 0.0;
    }
    let gamma = 1.0 / exponent();
    let relative = toned / limits.brightest;
    let below_white = (1.0 - relative).max(0.0);
    let norm = norm(seen.h);
    let limit = num::pow(relative, gamma) * limits.reach / norm;
    let scaled = seen.m * num::pow(toned / seen.j, gamma) / norm;
    let expanded = limit
        - toe(limit - scaled, limit - 0.001, below_white * EXPANSION, (relative * relative + NOISE).sqrt());
    toe(expanded, limit, relative * COMPRESSION, below_white) * norm
}

/// A curve through 0 and `limit` that is flat near 0; `flat` and `smooth` set the size and the shape of that part.
/// Values above `limit` stay.
fn toe(x: f64, limit: f64, flat: f64, smooth: f64) -> f64 {
    if x > limit {
        return x;
    }
    let smooth = smooth.max(0.001);
    let offset = (flat * flat + smooth * smooth).sqrt();
    let slope = (limit + offset) / (limit + smooth);
    let b = slope * x - offset;
    0.5 * (b + (b * b + 4.0 * smooth * slope * x).sqrt())
}

/// Scale of the fit below for the luminance of the display.
static SCALE: LazyLock<f64> = LazyLock::new(|| num::pow(0.033_79 * PEAK, 0.305_96) - 0.451_35);

/// Colourfulness at which colours of a hue count as fully saturated: a fit of the specification to the gamut.
fn norm(hue: f64) -> f64 {
    let (sin, cos) = num::sin_cos(hue.to_radians());
    let (cos2, sin2) = (cos * cos - sin * sin, 2.0 * sin * cos);
    let (cos3, sin3) = (cos * (4.0 * cos * cos - 3.0), sin * (3.0 - 4.0 * sin * sin));
    let cosines = 11.340_72 * cos + 16.468_99 * cos2 + 7.883_80 * cos3;
    let sines = 14.664_41 * sin - 6.372_24 * sin2 + 9.193_64 * sin3;
    (cosines + sines + 77.128_96) * *SCALE
}
