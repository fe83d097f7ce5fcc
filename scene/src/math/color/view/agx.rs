//! AgX as in Blender 4: the image formation of Sobotka in the version of Zhou (`AgX Base`,
//! github.com/EaryChow/AgX). The steps are those of its generator; nothing is read from a table.
//!
//! Colours outside the gamut are moved into it, the primaries are drawn inwards, each channel passes a sigmoid of
//! its logarithm, part of the change of hue that this causes is undone, and the primaries are moved outwards again,
//! by less.

use crate::math::color::primaries::{Matrix, REC709, REC2020, inverse, product_vector};
use crate::math::num::{self, f64::log2};

/// Draws the primaries of Rec.2020 inwards: by rotations of 3, -1 and -2 degrees, and 0.4, 0.22 and 0.13 of the
/// distance to white. The rows, which are published with 9 digits or more, are made to sum to 1 exactly.
const INSET: Matrix = [
    [0.856_627_153_315_983, 0.095_121_240_538_158_8, 0.048_251_606_145_858_3],
    [0.137_318_972_929_847, 0.761_241_990_602_591, 0.101_439_036_467_562],
    [0.111_898_212_999_95, 0.076_799_418_603_190_3, 0.811_302_368_396_859],
];
/// Draws the primaries inwards by 0.4, 0.22 and 0.04 of the distance to white. Its inverse is the last step.
const OUTSET: Matrix = [
    [0.899_796_955_911_611, 0.087_199_619_202_835_1, 0.013_003_424_885_555],
    [0.111_420_988_957_48, 0.875_575_586_156_966, 0.013_003_424_885_554_8],
    [0.111_420_988_957_48, 0.087_199_619_202_834_9, 0.801_379_391_839_686],
];
/// Weights of the brightness that both guards of the gamut keep, for Rec.2020 components.
const BRIGHTNESS: [f64; 3] = [0.258_923_535_568_984_8, 0.610_498_534_606_652_5, 0.130_577_929_824_362_84];

/// The stops below and above middle grey that the sigmoid covers.
const STOPS: [f64; 2] = [-10.0, 6.5];
/// Light of middle grey.
const GREY: f64 = 0.18;
/// Power of the display for which the sigmoid is designed.
const POWER: f64 = 2.4;
/// Slope of the sigmoid at middle grey.
const SLOPE: f64 = 2.4;
/// Exponent of both ends of the sigmoid.
const EXPONENT: f64 = 1.5;
/// Share of the change of hue by the sigmoid that remains.
const HUE_CHANGE: f64 = 0.4;

/// The transform, with the constants of its steps.
#[derive(Debug, Clone)]
pub(super) struct AgX {
    sigmoid: Sigmoid,
    to_wide: Matrix,
    inset: Matrix,
    outset: Matrix,
    from_wide: Matrix,
    brightness_rec709: [f64; 3],
}

impl AgX {
    /// Computes the constants.
    pub fn new() -> Self {
        let to_wide = REC709.to(&REC2020);
        let whole = |m: Matrix| m.map(|row| row.map(|v| v / (row[0] + row[1] + row[2])));
        let brightness = |column: usize| {
            (0..3).map(|row| BRIGHTNESS[row] * to_wide[row][column]).fold(0.0, |sum, v| sum + v)
        };
        Self {
            sigmoid: Sigmoid::new(),
            to_wide,
            inset: whole(INSET),
            outset: inverse(&whole(OUTSET)),
            from_wide: REC2020.to(&REC709),
            brightness_rec709: [0, 1, 2].map(brightness),
        }
    }

    /// Light of a display, for scene light of Rec.709.
    pub fn formed(&self, light: [f64; 3]) -> [f64; 3] {
        let wide = guarded(product_vector(&self.to_wide, light), BRIGHTNESS, false);
        let drawn_in = product_vector(&self.inset, wide);
        let shaped = drawn_in.map(|v| num::pow(self.sigmoid.apply(v), POWER));
        let turned = with_hue_between(drawn_in, shaped);
        let formed = product_vector(&self.outset, turned);
        guarded(product_vector(&self.from_wide, formed), self.brightness_rec709, true)
            .map(|v| v.clamp(0.0, 1.0))
    }
}

/// Adds grey until no component is negative, and scales the colour so that its brightness does not rise. The
/// brightness of a colour with negative components is that of its complement, subtracted from the largest
/// component. With `soft`, this form of brightness fades to the plain one as colours get brighter.
fn guarded(colour: [f64; 3], weights: [f64; 3], soft: bool) -> [f64; 3] {
    let brightness = |colour: [f64; 3]| {
        let plain = dot(weights, colour);
        let largest = max(colour);
        let complement = colour.map(|v| largest - v);
        let careful = max(complement) - dot(weights, complement) + plain;
        if soft {
            let fade = if plain > 0.0 { num::pow(plain, 0.08).min(1.0) } else { 0.0 };
            careful + (plain - careful) * fade
        } else {
            careful
        }
    };
    let smallest = colour[0].min(colour[1]).min(colour[2]);
    if smallest >= 0.0 {
        return colour;
    }
    let lifted = colour.map(|v| v - smallest);
    let after = brightness(lifted);
    let ratio = if after > 0.0 { (brightness(colour) / after).clamp(0.0, 1.0) } else { 0.0 };
    lifted.map(|v| v * ratio)
}

/// The sigmoid of the logarithm of light, around middle grey.
#[derive(Debug, Clone)]
struct Sigmoid {
    pivot: [f64; 2],
    /// Scales of the halves below and above the pivot.
    scales: [f64; 2],
}

impl Sigmoid {
    fn new() -> Self {
        let [low, high] = STOPS;
        let pivot = [-low / (high - low), num::pow(GREY, 1.0 / POWER)];
        // Each half is a scaled copy of u / (1 + u^p)^(1/p), chosen so that it ends in a corner of the unit square.
        let scale = |run: f64, rise: f64| {
            let full = SLOPE * run;
            full / num::pow(num::pow(full / rise, EXPONENT) - 1.0, 1.0 / EXPONENT)
        };
        Self { pivot, scales: [scale(pivot[0], pivot[1]), scale(1.0 - pivot[0], 1.0 - pivot[1])] }
    }

    /// The value for light: 0 to 1, encoded for a display of power [`POWER`].
    fn apply(&self, light: f64) -> f64 {
        let [low, high] = STOPS;
        let x = if light > 0.0 { ((log2(light / GREY) - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 };
        let half = |scale: f64, distance: f64| {
            let u = SLOPE * distance / scale;
            scale * u / num::pow(1.0 + num::pow(u, EXPONENT), 1.0 / EXPONENT)
        };
        let [pivot_x, pivot_y] = self.pivot;
        let y = if x < pivot_x {
            pivot_y - half(self.scales[0], pivot_x - x)
        } else {
            pivot_y + half(self.scales[1], x - pivot_x)
        };
        y.clamp(0.0, 1.0)
    }
}

/// The colour `shaped` with a hue that lies between that of `before` and its own; [`HUE_CHANGE`] is the share of
/// its own.
fn with_hue_between(before: [f64; 3], shaped: [f64; 3]) -> [f64; 3] {
    let (Some(from), Some(to)) = (hue(before), hue(shaped)) else { return shaped };
    let turn = to - from;
    let turn = turn - turn.round();
    let hue = (from + HUE_CHANGE * turn).rem_euclid(1.0) * 6.0;
    let (largest, smallest) = (max(shaped), shaped[0].min(shaped[1]).min(shaped[2]));
    let range = largest - smallest;
    // Height of the component below the largest, along the edges of the colour hexagon.
    let component = |offset: f64| {
        let position = (hue + offset).rem_euclid(6.0);
        largest - range * position.min(4.0 - position).clamp(0.0, 1.0)
    };
    [component(5.0), component(3.0), component(1.0)]
}

/// Hue of a colour as a part of a whole turn, 0 to 1, as in HSV: 0 is red and 1/3 is green. `None` for grey.
fn hue(colour: [f64; 3]) -> Option<f64> {
    let [r, g, b] = colour;
    let (largest, smallest) = (max(colour), r.min(g).min(b));
    let range = largest - smallest;
    if range <= 0.0 {
        return None;
    }
    let sixths = if largest == r {
        (g - b) / range
    } else if largest == g {
        2.0 + (b - r) / range
    } else {
        4.0 + (r - g) / range
    };
    Some((sixths / 6.0).rem_euclid(1.0))
}

fn max(colour: [f64; 3]) -> f64 {
    colour[0].max(colour[1]).max(colour[2])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
